"""Choices and switches of arguments and settings."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import pytest

from sightline.corruptions.drawing import CorruptionSampler
from sightline.corruptions.pixel_box import BoxDrawing
from sightline.evaluation.calibration import CalibrationSettings
from sightline.geometry.choices import check_choice, check_choices, choices_in
from sightline.robustness.bench import BenchSettings
from sightline.training.optimizer import OptimizerConfig
from sightline.training.sources import SourceConfig


@dataclass(frozen=True)
class _Settings:
    stride: Literal[1, 2, 4] = 2
    mode: Literal["fast", "exact"] | None = None
    smooth: bool = False
    around: bool | None = None
    name: str | bool = "free"
    width: int = 3


def test_choices_are_read_from_literals_switches_and_their_unions_with_none():
    assert choices_in(_Settings) == {
        "stride": (1, 2, 4),
        "mode": ("fast", "exact", None),
        "smooth": (True, False),
        "around": (True, False, None),
    }


@pytest.mark.parametrize(
    "fields",
    [
        {"stride": np.int64(4)},
        {"mode": np.str_("exact")},
        {"smooth": np.True_},
        {"smooth": 1},
        {"around": 0},
        {"name": "no", "width": "wide"},
    ],
)
def test_equal_values_of_other_types_are_choices(fields):
    check_choices(_Settings(**fields))


@pytest.mark.parametrize(
    ("fields", "error", "message"),
    [
        ({"stride": 3}, ValueError, "a.stride must be one of 1, 2, 4, got 3"),
        ({"stride": "2"}, TypeError, "a.stride is of type str, expected 1 or 2 or 4"),
        (
            {"mode": "exat"},
            ValueError,
            "a.mode must be one of fast, exact, None, got 'exat'; perhaps exact is meant",
        ),
        ({"mode": True}, TypeError, "a.mode is of type bool, expected 'fast' or 'exact' or None"),
        ({"mode": ["fast"]}, TypeError, "a.mode is of type list, expected 'fast' or 'exact'"),
        ({"smooth": "no"}, TypeError, "a.smooth is of type str, expected True or False"),
        ({"smooth": None}, TypeError, "a.smooth is of type NoneType, expected True or False"),
        ({"smooth": 2}, TypeError, "a.smooth is of type int, expected True or False"),
        ({"around": "auto"}, TypeError, "a.around is of type str, expected True or False or None"),
        ({"around": np.zeros(3)}, TypeError, "a.around is of type numpy.ndarray, expected True"),
    ],
)
def test_other_values_are_refused_with_the_choices(fields, error, message):
    with pytest.raises(error) as caught:
        check_choices(_Settings(**fields), "a.")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_long_wrong_choice_is_shortened():
    with pytest.raises(ValueError, match=r"^mode must be one of fast, got 'x{1,30}\.\.\.x+'$"):
        check_choice("mode", "x" * 10_000, ("fast",))


@pytest.mark.parametrize(
    ("make", "fields"),
    [
        (OptimizerConfig, {"name": "adm"}),
        (OptimizerConfig, {"schedule": "cosin"}),
        (SourceConfig, {"path": Path("drive"), "velodyne": "velodyn"}),
        (CalibrationSettings, {"metric": "bevv"}),
        (BenchSettings, {"driver": "ry"}),
        (BoxDrawing, {"placement": "objects"}),
        (CorruptionSampler, {"suite": "dgfn7", "per": "imge"}),
    ],
)
def test_settings_made_in_python_refuse_misspelt_choices(make, fields):
    with pytest.raises(
        (ValueError, TypeError), match=f"{list(fields)[-1]}.*(must be one of|Literal)"
    ):
        make(**fields)
