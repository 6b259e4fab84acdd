"""What is read of a run's logs: TensorBoard's event files, CSV tables and pictures."""

import numpy as np
import pytest
from torch.utils.tensorboard import SummaryWriter

from sightline.data.formats.image_file import write_rgb
from sightline.files.problem import FileError
from sightline.training.run_log import read_run_log

RED, BLUE = (
    np.broadcast_to(np.uint8(each), (6, 8, 3)).copy() for each in ((250, 0, 0), (0, 0, 250))
)


def write_events(folder, entries, *, pictures=()):
    """Event file with entries (name, step, value, seconds)."""
    with SummaryWriter(str(folder)) as writer:
        for name, step, value, seconds in entries:
            writer.add_scalar(name, value, step, walltime=seconds)
        for step, picture in pictures:
            writer.add_image("validation/0", picture, step, dataformats="HWC", walltime=step)


def test_a_resumed_run_replaces_the_steps_that_it_repeats_and_no_others(tmp_path):
    first = [("loss", step, 1.0, step) for step in (1, 2, 3, 4)]
    resumed = [("loss", step, 2.0, 10 + step) for step in (3, 5)]
    write_events(tmp_path / "run", [*first, *resumed, ("other", 7, 0.5, 1)])
    log = read_run_log(tmp_path / "run")
    assert log.series["loss"].steps.tolist() == [1, 2, 3, 4, 5]
    assert log.series["loss"].values.tolist() == [1.0, 1.0, 2.0, 1.0, 2.0]
    assert log.series["other"].steps.tolist() == [7]
    assert log.pictures == {}


def test_pictures_of_events_and_of_files_are_decoded_by_step(tmp_path):
    write_events(tmp_path / "events", [], pictures=[(2, RED), (1, BLUE)])
    (tmp_path / "files").mkdir()
    (tmp_path / "files" / "metrics.csv").write_text("step,loss\n")
    for step, picture in ((1, BLUE), (2, RED)):
        path = tmp_path / "files" / "pictures" / "validation" / "0" / f"{step:07}.png"
        write_rgb(path, picture)
    pictures = read_run_log(tmp_path / "files").pictures["validation/0"]
    assert [each.step for each in pictures] == [1, 2]
    assert np.array_equal(pictures[0].read(), BLUE)
    pictures = read_run_log(tmp_path / "events").pictures["validation/0"]
    assert [each.step for each in pictures] == [1, 2]
    assert np.array_equal(pictures[1].read(), RED)


def test_a_csv_table_gives_its_columns_without_empty_or_infinite_cells(tmp_path):
    (tmp_path / "version_0").mkdir()
    (tmp_path / "version_0" / "metrics.csv").write_text("epoch,step,loss\n0,1,\n0,2,0.5\n1,3,inf\n")
    log = read_run_log(tmp_path)
    assert log.series["loss"].steps.tolist() == [2]
    assert log.series["loss"].values.tolist() == [0.5]
    assert log.series["epoch"].values.tolist() == [0.0, 0.0, 1.0]


def test_folders_without_logs_and_damaged_ones_are_refused_in_one_sentence(tmp_path):
    with pytest.raises(ValueError, match="is no folder; name the run folder"):
        read_run_log(tmp_path / "none")
    with pytest.raises(ValueError, match=r"holds no events.out.tfevents.\* and no metrics.csv"):
        read_run_log(tmp_path)
    (tmp_path / "metrics.csv").write_text("loss\n0.5\n")
    with pytest.raises(FileError, match="is no table of a CSV logger with a column step"):
        read_run_log(tmp_path)
    (tmp_path / "metrics.csv").write_text(f"step,loss\n{10**19},0.5\n")
    with pytest.raises(FileError, match="is no table of a CSV logger with a column step"):
        read_run_log(tmp_path)


def test_a_damaged_picture_is_refused_by_its_folder(tmp_path):
    write_events(tmp_path, [], pictures=[(1, RED)])
    (picture,) = read_run_log(tmp_path).pictures["validation/0"]
    damaged = type(picture)(step=1, content=picture.content[:40], source=tmp_path)
    with pytest.raises(FileError):
        damaged.read()
