"""What the recipes say: published numbers, what ships by default, and parts that fit together."""

from dataclasses import replace

import jsonargparse
import pytest
import yaml

from sightline.detection3d.config import Detection3DConfig
from sightline.detection3d.examples import Detection3DExampleConfig
from sightline.detection3d.pillars.region_config import RegionConfig
from sightline.detection3d.points.config import RefinementConfig
from sightline.files.settings import parse_settings
from sightline.tasks import PACKAGE_RECIPES
from sightline.training.command import run_training
from tests.detection3d.frames import PUBLISHED

RECIPES = sorted(path.stem for path in PACKAGE_RECIPES.glob("detection3d-*.yaml"))


def read(recipe):
    return yaml.safe_load((PACKAGE_RECIPES / f"{recipe}.yaml").read_text())


def network_of(recipe):
    return parse_settings(Detection3DConfig, read(recipe)["model"]["init_args"]["network"])


@pytest.mark.parametrize(
    ("recipe", "refinement"),
    [("detection3d-rpn-kitti", None), ("detection3d-baseline-kitti", RefinementConfig())],
)
def test_the_recipes_for_kitti_are_of_the_published_sizes(recipe, refinement):
    assert network_of(recipe) == replace(PUBLISHED, refinement=refinement)


@pytest.mark.parametrize("recipe", RECIPES)
def test_only_the_network_says_what_it_is_shown(recipe):
    preparation = read(recipe)["data"]["init_args"]["preparation"]["init_args"]
    settings = parse_settings(Detection3DExampleConfig, preparation["settings"])
    assert (settings.input, settings.class_names) == (None, None)


def test_the_default_network_is_the_design_that_ships():
    network = network_of("detection3d-best")
    regions = replace(network.regions, passes=RegionConfig().passes, mean_with_first=())
    in_use = {"flip_test": False, "axes": None}
    assert replace(network, regions=regions, **in_use) == Detection3DConfig()


def test_the_compact_recipes_differ_in_size_passes_and_what_is_for_use_alone():
    best, fast = read("detection3d-best"), read("detection3d-fast-cpu")
    for name in ("flip_test", "axes"):
        assert best["model"]["init_args"]["network"].pop(name)
    for recipe in (best, fast):
        network = recipe["model"]["init_args"]["network"]
        network.pop("pillars", None)
        assert network["regions"].pop("passes")
    assert best == fast


def test_a_network_left_to_its_defaults_is_told_so_that_it_can_be_read_again():
    parser = jsonargparse.ArgumentParser(exit_on_error=False)
    parser.add_argument("--network", type=Detection3DConfig)
    parsed = parser.parse_object({"network": {}})
    again = parser.parse_string(parser.dump(parsed))
    assert parser.instantiate(again).network == Detection3DConfig()


@pytest.mark.parametrize(
    "flags", [["--model.init_args.network.regions", "null"], ["--model.network.regions=null"]]
)
def test_a_part_within_a_part_can_be_left_out_by_a_flag(flags, capsys):
    inner = "--data.init_args.preparation.init_args.settings.changes.objects"
    arguments = ["--config", "detection3d-best", *flags, inner, "null", "--print_config"]
    with pytest.raises(SystemExit) as end:
        run_training("fit", arguments, PACKAGE_RECIPES)
    assert end.value.code in (None, 0)
    printed = yaml.safe_load(capsys.readouterr().out)
    assert printed["model"]["init_args"]["network"]["regions"] is None
    assert printed["model"]["init_args"]["network"]["pillars"] is not None
    preparation = printed["data"]["init_args"]["preparation"]["init_args"]
    assert preparation["settings"]["changes"]["objects"] is None
    assert preparation["settings"]["changes"]["stretch"] == [0.1, 0.04, 0.04]
