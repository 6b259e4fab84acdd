"""Weights files whose settings hold absurd numbers: refused in one line, or they answer."""

import math
import warnings
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import sightline
from sightline.augmentation.scene_changes import resize
from sightline.files.settings import config_to_dict, parse_settings
from sightline.files.weights import Weights, read_weights, write_weights
from sightline.files.weights_header import shipped_names
from sightline.simulation.packaged import PACKAGED_FRAMES
from sightline.structures.predictions import DepthMap
from sightline.tasks import find_task
from tests.detection3d.frames import TINY, write_network

LONGEST = 500  # characters of a message, the folder of the tests left out

Place = tuple[str | int, ...]


@cache
def sample():
    """An embedded frame, its picture made small."""
    return resize(sightline.open_dataset(PACKAGED_FRAMES)[0], 94, 310)


@pytest.fixture(scope="module")
def of_points(tmp_path_factory) -> Path:
    """Weights of a 3D detector of the other design, of which none are shipped."""
    path = tmp_path_factory.mktemp("points") / "points.safetensors"
    write_network(path, TINY)
    return path


def places_of_numbers(node: object, place: Place = ()) -> list[Place]:
    """What leads to each number in nested settings."""
    if isinstance(node, dict | list):
        inner = node.items() if isinstance(node, dict) else enumerate(node)
        return [found for key, each in inner for found in places_of_numbers(each, (*place, key))]
    return [place] if isinstance(node, int | float) and not isinstance(node, bool) else []


def changed(node: Any, place: Place, value: object) -> Any:
    if not place:
        return value
    copied = node.copy()
    copied[place[0]] = changed(node[place[0]], place[1:], value)
    return copied


def whole_settings(weights: Weights) -> dict[str, object]:
    """With those that the file is too old to name."""
    return config_to_dict(parse_settings(find_task(weights.task).config_type(), weights.config))


def refusal(path: Path, weights: Weights, config: dict[str, object]) -> str:
    """What is said of weights with such settings: a line that names the file, or empty.

    Then they answer.
    """
    write_weights(
        path, weights.tensors, task=weights.task, config=config, provenance=weights.provenance
    )
    try:
        predictor = sightline.load(path, engine="torch")
    except ValueError as error:
        said = str(error).replace(str(path.parent), "")
        assert path.name in said
        assert said.isprintable()
        assert len(said) < LONGEST
        return said
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that nothing lies where the network looks
        answer = predictor(sample())
    if isinstance(answer, DepthMap):
        assert answer.depth_m.isfinite().all()
    else:
        found = getattr(answer, "detections", answer)
        assert found.boxes.tensor.isfinite().all()
        assert found.scores.isfinite().all()
    return ""


absurd = st.sampled_from([math.nan, math.inf, -1, 0, 1, 1e-9, 1e-300, 10**6, 1e9, 10**9, 1e300])
share = st.floats(0, 1, exclude_max=True)


@pytest.mark.parametrize("name", [*shipped_names(), "points"])
@given(changes=st.lists(st.tuples(share, absurd), min_size=1, max_size=2))
@settings(max_examples=15)
def test_weights_with_absurd_numbers_answer_or_are_refused_in_a_line_that_names_them(
    tmp_path_factory, of_points, name, changes
):
    weights = read_weights(of_points if name == "points" else name)
    config = whole_settings(weights)
    places = places_of_numbers(config)
    for chosen, value in changes:
        config = changed(config, places[int(chosen * len(places))], value)
    refusal(tmp_path_factory.mktemp("absurd") / "odd.safetensors", weights, config)


@pytest.mark.parametrize(
    ("name", "setting", "value", "said"),
    [
        ("detection3d-fast-cpu", "regions.num_points", 10**6, "num_points must be from 1 to 16384"),
        ("detection3d-fast-cpu", "regions.margin_m.0", 1e9, "margin_m must be from 0 to 100"),
        ("detection3d-fast-cpu", "pillars.grid.x_m.1", 1e9, "x_m must rise and lie within 100000"),
        ("detection3d-fast-cpu", "pillars.grid.x_m.1", 99942.4, "the grid has 499712 x 400 cells"),
        ("detection3d-fast-cpu", "pillars.grid.cell_m", 1e-9, "cells of 16 numbers, expected up"),
        ("detection3d-fast-cpu", "pillars.classes.0.mean_size_m.0", 1e30, "Car must be from 0.01"),
        ("detection3d-fast-cpu", "input.highest_m.0", 1e30, "input must be within 100000"),
        ("detection3d-fast-cpu", "centers.max_cells", 10**6, "max_cells times max_boxes must be"),
        ("detection3d-fast-cpu", "centers.max_boxes", 10**5, "max_cells times max_boxes must be"),
        ("points", "pooling.num_points", 10**6, "num_points must be from 1 to 16384"),
        ("points", "proposals.num_candidates", 10**9, "num_proposals times num_candidates must"),
        ("points", "points.backbone.levels.0.num_centers", 10**6, "num_centers must be from 1 to"),
        ("points", "points.backbone.levels.0.scales.0.num_neighbours", 10**6, "make a layer of"),
        ("points", "points.backbone.levels.0.scales.0.radius_m", 1e9, "positive and up to 1000"),
        ("points", "points.coding.bin_m", 1e-309, "2 * scope_m must be a multiple of bin_m"),
        ("depth-fast-cpu", "depth_scale_m", 1e30, "depth_scale_m must be from 0.001 to 1e+06"),
        ("detection2d-fast-cpu", "input.size", [8192, 8192], "size must have up to 8388608 pixels"),
    ],
)
def test_a_size_that_would_take_all_memory_is_refused_by_its_setting(
    tmp_path, of_points, name, setting, value, said
):
    weights = read_weights(of_points if name == "points" else name)
    place = tuple(int(key) if key.isdigit() else key for key in setting.split("."))
    config = changed(whole_settings(weights), place, value)
    assert said in refusal(tmp_path / "odd.safetensors", weights, config)


@pytest.mark.parametrize("name", [*shipped_names(), "points"])
def test_as_they_are_the_same_weights_answer(tmp_path, of_points, name):
    weights = read_weights(of_points if name == "points" else name)
    assert refusal(tmp_path / "odd.safetensors", weights, whole_settings(weights)) == ""
