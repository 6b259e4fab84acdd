"""Work of `perceive` on one frame, with the folders and claims of its result files."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

from sightline.data.datasets.sample_dataset import SampleDataset
from sightline.data.datasets.sample_files import (
    dataset_title,
    has_file,
    sample_times,
    sweeps_folder,
)
from sightline.files.atomic import atomic_write_text
from sightline.inference.predict import (
    Places,
    around_entry,
    output_claims,
    output_places,
    predicted_samples,
    read_sample,
    write_prediction,
)
from sightline.inference.predictor import Predictor
from sightline.jobs.output_dirs import Claim
from sightline.joining.files import write_objects
from sightline.joining.models import JOINED
from sightline.perception.kept_lines import (
    LINES_FOLDER,
    LINES_NAME,
    TIMINGS_FOLDER,
    read_lines,
)
from sightline.perception.lines import frame_line, retime_line, timing_line
from sightline.perception.perceiver import MultiTaskPredictor
from sightline.perception.results import ALIGNMENT, JOB_NAME
from sightline.structures.lidar_turn import LidarTurn, undo_turn
from sightline.structures.sample import SENSOR_FIELDS
from sightline.tasks import find_task

JOINED_FOLDERS: Final = {JOINED: False, f"{JOINED}-3d": True}
"""Folders in the output folder of joined objects as result files, and whether the scores are those
of the 3D boxes."""


@dataclass(frozen=True, slots=True)
class FrameWork:
    """Work item: runs all tasks on a frame and writes its files; the line comes last."""

    dataset: SampleDataset
    index: int
    name: str
    perceiver: MultiTaskPredictor
    places: Mapping[str, Places]
    out: Path
    around: bool | None
    keeps_time: bool = True
    """Write the time of each prediction, too."""

    def __str__(self) -> str:
        """Name in errors."""
        return f"sample {self.name}"

    def run(self) -> str:
        """Write the files; returns remarks on them."""
        sample = read_sample(self.dataset, self.index, around=self.around)
        predictions = self.perceiver.predict_by_task(sample)
        sample = undo_turn(sample, predictions.undone_turn or LidarTurn())
        remarks = [
            write_prediction(
                self.places[task], sample, prediction, self.perceiver.predictors[task].parts
            )
            for task, prediction in predictions.by_task.items()
        ]
        if predictions.objects is not None:
            for folder, in_space in JOINED_FOLDERS.items():
                path = self.out / folder / f"{self.name}.txt"
                path.parent.mkdir(exist_ok=True)
                write_objects(path, sample, predictions.objects, in_space=in_space)
        if self.keeps_time:
            self._write_line(TIMINGS_FOLDER, timing_line(sample, predictions))
        made_by = {name: each.name for name, each in self.perceiver.predictors.items()}
        self._write_line(LINES_FOLDER, frame_line(sample, predictions, made_by))
        return "; ".join(filter(None, remarks))

    def _write_line(self, folder: str, line: str) -> None:
        atomic_write_text(self.out / folder / f"{self.name}.json", f"{line}\n")


def further_outputs(task_name: str, predictor: Predictor) -> tuple[str, ...]:
    """Names of a task's outputs after its first that the predictor gives."""
    outputs = find_task(task_name).outputs[1:]
    return tuple(output.name for output in outputs if output.name in predictor.gives)


def result_places(
    perceiver: MultiTaskPredictor, out: Path, *, all_outputs: bool
) -> dict[str, Places]:
    """Folders by task: one named after the task for its first output, one per further output."""
    places = {}
    for name, predictor in perceiver.predictors.items():
        task = find_task(name)
        further = further_outputs(name, predictor) if all_outputs else ()
        also = {output: out / f"{name}-{output}" for output in further}
        places[name] = output_places(task, predictor, out / name, also)
    return places


def result_claims(
    perceiver: MultiTaskPredictor,
    places: Mapping[str, Places],
    data: Path,
    dataset: SampleDataset,
    out: Path,
    *,
    around: bool | None,
) -> list[Claim]:
    """Create the claims on the whole folder, and on each task's folder as `predict` does."""
    made_by = {
        name: {"method": predictor.name, **predictor.made_by}
        for name, predictor in perceiver.predictors.items()
    }
    title, velodyne = dataset_title(dataset, data), sweeps_folder(dataset)
    aligned = {ALIGNMENT: perceiver.alignment.to_json()} if perceiver.alignment else {}
    settings = {
        "job": JOB_NAME,
        "folders": [folder.name for task in places.values() for _, folder in task],
        "data": title,
        "velodyne": velodyne,
        "sightline": version("sightline"),
        **around_entry(around=around),
        **aligned,
        **made_by,
        **perceiver.models_entry,
    }
    claims = [Claim(folder=out, settings=settings, results=(f"{LINES_FOLDER}/*.json", LINES_NAME))]
    for name, predictor in perceiver.predictors.items():
        task, chosen = find_task(name), around_entry(around=around) | aligned
        claims += output_claims(task, predictor, places[name], title, velodyne, chosen=chosen)
    models = perceiver.join_models
    if models is not None:
        joined = {key: settings[key] for key in ("job", "data", "velodyne", "sightline")}
        claims += [
            Claim(
                folder=out / folder,
                settings={**joined, "models": models.identity, **aligned},
                results=("*.txt",),
            )
            for folder in JOINED_FOLDERS
        ]
    return claims


def done_frames(
    dataset: SampleDataset,
    perceiver: MultiTaskPredictor,
    places: Mapping[str, Places],
    folder: Path,
) -> set[str]:
    """Frames with a line of these tasks and all files of the tasks that predicted.

    A missing sensor in a line is accepted only if the data still has no file of the sensor. Times
    that were added or changed since are written into the lines.
    """
    present = {task: predicted_samples(task_places) for task, task_places in places.items()}
    lines = read_lines(folder)
    times = sample_times(dataset)
    done = set()
    for index, name in enumerate(dataset.sample_ids):
        if name not in lines:
            continue
        line = lines[name][1]
        has_files = all(name in present.get(task, ()) for task in predicting_tasks(line))
        if line["objects"] is not None:
            paths = (folder.parent / each / f"{name}.txt" for each in JOINED_FOLDERS)
            has_files &= all(path.is_file() for path in paths)
        if has_files and _is_current(line, dataset, index, perceiver):
            done.add(name)
            if times is not None:
                retime_line(folder / f"{name}.json", line, times[index])
    return done


def _is_current(
    line: Mapping[str, Any], dataset: SampleDataset, index: int, perceiver: MultiTaskPredictor
) -> bool:
    """Test if the line of a frame is of the given predictors and of all sensors in the data."""
    tasks = line["tasks"]
    has_same_predictors = all(
        task in tasks and tasks[task]["by"] == predictor.name
        for task, predictor in perceiver.predictors.items()
    )
    lacking = {part for entry in tasks.values() for part in entry.get("lacks", ())}
    missing = {field for sensor, field in SENSOR_FIELDS.items() if not line["sensors"][sensor]}
    lacking |= missing & set(perceiver.parts)
    still_lacks = not any(has_file(dataset, index, part) for part in lacking)
    return has_same_predictors and still_lacks


def predicting_tasks(line: Mapping[str, Any]) -> Collection[str]:
    """Names of the tasks that predicted for the frame of a line."""
    return [name for name, entry in line["tasks"].items() if "lacks" not in entry]
