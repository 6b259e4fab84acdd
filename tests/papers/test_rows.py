"""Networks are the papers' own by their settings, and by these alone."""

from dataclasses import replace

import pytest
import yaml

from sightline.data.open import open_dataset
from sightline.depth_completion.config import DepthCompletionConfig
from sightline.depth_completion.network_task import NETWORK_TASK as DEPTH
from sightline.detection2d.config import PAPER, DgfnConfig
from sightline.detection2d.network_task import NETWORK_TASK as IN_IMAGE
from sightline.detection3d.config import Detection3DConfig
from sightline.detection3d.network_task import NETWORK_TASK as IN_SPACE
from sightline.files.settings import parse_settings
from sightline.inference.network import load_network
from sightline.papers.gated_fusion_cases import INTERPRETATIONS
from sightline.papers.rows import describe, find_departures, open_labelled
from sightline.papers.two_stage import COURSE
from sightline.simulation.packaged import PACKAGED_FRAMES
from sightline.tasks import PACKAGE_RECIPES
from tests.data.trees import write_selection


def recipe_network(name):
    plain = yaml.safe_load((PACKAGE_RECIPES / f"{name}.yaml").read_text())
    return plain["model"]["init_args"]["network"]


def test_the_recipes_of_the_papers_build_the_papers_networks():
    for name, kind, paper in (
        ("detection2d-dgfn-kitti", type(PAPER), PAPER),
        ("detection3d-baseline-kitti", Detection3DConfig, COURSE),
        ("depth-shiftconv-kitti", DepthCompletionConfig, DepthCompletionConfig()),
    ):
        settings = parse_settings(kind, recipe_network(name))
        assert find_departures(settings, paper) == ()


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        (PAPER, ()),
        (replace(PAPER, fusion="late"), ()),
        (replace(PAPER, input=replace(PAPER.input, height_offset_m=0.0)), ()),
        (replace(PAPER, width=0.25), ("width 0.25",)),
        (replace(PAPER, dgfn=DgfnConfig(batch_norm=True)), ("dgfn.batch_norm True",)),
        (replace(PAPER, input=replace(PAPER.input, size=None)), ("without input.size",)),
    ],
)
def test_readings_of_a_paper_make_no_other_network_but_widths_and_inputs_do(settings, expected):
    assert find_departures(settings, PAPER, besides=INTERPRETATIONS) == expected


@pytest.mark.parametrize(
    ("task", "weights", "paper", "first"),
    [
        (IN_IMAGE, "detection2d-fast-cpu", PAPER, "with compact"),
        (IN_SPACE, "detection3d-fast-cpu", COURSE, "with regions"),
        (DEPTH, "depth-fast-cpu", DepthCompletionConfig(), "without shift_conv"),
    ],
)
def test_shipped_networks_are_told_with_their_size_and_steps(task, weights, paper, first):
    loaded = load_network(task, weights)
    network = describe(loaded, "compact", find_departures(loaded.network.config, paper))
    assert not network.is_papers
    assert first in network.departures
    assert network.title.startswith(f"{weights}: compact, 0.")
    assert " M weights, " in network.title
    assert "steps" in network.title
    assert network.difference.endswith(f"and {len(network.departures) - 4} more")


def test_data_without_boxes_are_refused(tmp_path):
    write_selection(tmp_path)
    with pytest.raises(ValueError, match="is no object tree of KITTI's with labels"):
        open_labelled(tmp_path, None, None)
    assert open_labelled(PACKAGED_FRAMES, None, None).sample_ids == (
        open_dataset(PACKAGED_FRAMES).sample_ids
    )
