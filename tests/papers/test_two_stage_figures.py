"""Choice and layout of the course's figures."""

import numpy as np
import pytest
import torch

from sightline.data.formats.image_file import read_rgb, write_rgb
from sightline.data.open import open_dataset
from sightline.detection3d.stages import Proposed
from sightline.papers.two_stage_figures import (
    SCENES,
    TRAINING,
    DrawnFigures,
    _choose,
    draw_inputs,
    draw_training,
)
from sightline.simulation.packaged import PACKAGED_FRAMES
from sightline.visualization.colors import CURVE_COLORS

COLORS = {4: (250, 0, 0), 10: (0, 250, 0), 13: (0, 0, 250), 20: (250, 250, 0)}


def pixels_of(picture, color):
    return int((np.abs(picture.astype(int) - color).max(axis=2) <= 12).sum())


@pytest.fixture
def run(tmp_path):
    """Run folder with two curves, and pictures of one scene in a colour for each step."""
    folder = tmp_path / "run"
    folder.mkdir()
    rows = ["step,training/total,validation/loose/Car/3d/moderate_R11"]
    rows += [f"{step},{10 - step / 4:g},{4 * step if step in COLORS else ''}" for step in range(21)]
    (folder / "metrics.csv").write_text("\n".join(rows) + "\n")
    for step, color in COLORS.items():
        path = folder / "pictures" / "validation" / "0" / f"{step:07}.png"
        write_rgb(path, np.broadcast_to(np.uint8(color), (60, 80, 3)).copy())
    return folder


def test_a_scene_is_drawn_at_the_beginning_the_middle_and_the_end(run, tmp_path):
    drawn = draw_training(tmp_path / "figures", run)
    scene = tmp_path / "figures" / SCENES.format(number=0)
    assert drawn.paths == (tmp_path / "figures" / TRAINING, scene)
    assert drawn.missing == ()
    picture = read_rgb(scene)
    third = picture.shape[1] // 3
    parts = [picture[:, start : start + third] for start in (0, third, 2 * third)]
    for part, step in zip(parts, (4, 13, 20), strict=True):  # 13 is nearest to 12
        assert pixels_of(part, COLORS[step]) > 0.5 * part[..., 0].size
    assert pixels_of(picture, COLORS[10]) == 0
    curves = read_rgb(tmp_path / "figures" / TRAINING)
    assert all(pixels_of(half, CURVE_COLORS[0]) > 100 for half in np.array_split(curves, 2, axis=1))


def test_what_a_run_has_not_logged_is_said(run, tmp_path):
    (run / "metrics.csv").write_text("step,training/total\n1,2.0\n")
    for path in run.rglob("*.png"):
        path.unlink()
    drawn = draw_training(tmp_path / "figures", run)
    assert drawn.missing == (
        f"precision curves: {run} has logged no validation",
        f"scenes of the training: {run} has logged no pictures of a validation",
    )
    assert draw_training(tmp_path / "other", None) == DrawnFigures(
        missing=("curves and scenes of the training, without --run",)
    )
    assert not (tmp_path / "other").exists()


def test_without_a_network_there_is_no_input_to_draw(tmp_path):
    frames = open_dataset(PACKAGED_FRAMES)
    drawn = draw_inputs(tmp_path / "figures", None, frames, frames[0])
    assert drawn == DrawnFigures(missing=("regions and proposals, without weights",))


@pytest.mark.parametrize(
    ("band_m", "expected"),
    [((0.0, 15.0), 1), ((15.0, 30.0), 2), ((30.0, 80.0), 2), ((80.0, 90.0), 2)],
)
def test_the_surest_proposal_with_points_is_chosen_in_a_band_unless_its_score_is_low(
    band_m, expected
):
    boxes = torch.tensor([[5.0], [10.0], [20.0], [40.0]]) * torch.eye(7)[0]
    scores = torch.tensor([0.95, 0.8, 0.9, 0.4])
    proposed = Proposed(boxes, torch.zeros(4, dtype=torch.int64), scores)
    assert _choose(proposed, [0, 10, 10, 10], band_m) == expected
    assert _choose(proposed, [0, 0, 0, 0], band_m) is None
