"""The recipes say the published numbers, which are the settings' defaults."""

import pytest
import yaml

from sightline.data.settings import parse_settings
from sightline.detection3d.config import RefinementConfig
from sightline.detection3d.detector_config import Detection3DConfig
from sightline.tasks import PACKAGE_RECIPES


def network_of(recipe):
    settings = yaml.safe_load((PACKAGE_RECIPES / f"{recipe}.yaml").read_text())
    return parse_settings(Detection3DConfig, settings["model"]["init_args"]["network"])


@pytest.mark.parametrize(
    ("recipe", "refinement"),
    [("detection3d-rpn-kitti", None), ("detection3d-baseline-kitti", RefinementConfig())],
)
def test_the_recipes_for_kitti_are_of_the_published_sizes(recipe, refinement):
    assert network_of(recipe) == Detection3DConfig(refinement=refinement)
