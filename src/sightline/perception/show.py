"""Picture of frames with predictions, from a predictor or from result files."""

from collections.abc import Sequence
from pathlib import Path

from sightline.data.datasets.sample_dataset import SampleDataset
from sightline.data.datasets.sample_files import dataset_title
from sightline.data.formats.image_file import write_rgb
from sightline.data.layouts.kitti_trees import Velodyne
from sightline.data.open import open_dataset
from sightline.geometry.user_warning import warn_user
from sightline.inference.predictor import Predictor, lacking_parts
from sightline.perception.results import ResultFolder, open_results, read_perception
from sightline.perception.shown_results import count_drawn, doubts_about_shown
from sightline.structures.lidar_turn import LidarTurn, undo_turn
from sightline.structures.predictions import Perception
from sightline.structures.sample import CameraLidarSample
from sightline.tasks import Task
from sightline.visualization.frame_row import draw_rows
from sightline.visualization.sheet import frame_sheet


class PredictorSource:
    """Source of predictions from a predictor; empty for samples that lack a required sensor."""

    def __init__(self, task: Task, predictor: Predictor) -> None:
        self.depth_name = predictor.name
        self.has_scores = task.name != "depth-completion"
        self._task, self._predictor = task, predictor

    def __call__(self, sample: CameraLidarSample) -> Perception:
        """Run the predictor."""
        if lacking_parts(self._predictor, sample):
            return Perception()
        return self._task.perception(self._predictor(sample))


class ResultSource:
    """Source of predictions from result files."""

    def __init__(self, folders: Sequence[Path]) -> None:
        """Open the folders."""
        self._folders = tuple(folders)
        self._opened = open_results(self._folders)
        self.counts: tuple[str, ...] = ()
        """Numbers of drawn objects, where some of the drawn frames' are left out."""

    def check_data(self, title: str) -> None:
        """Warn of results from data of another title than this; see `dataset_title`."""
        foreign = [each for each in self._opened if each.data not in ("", title)]
        if foreign:
            warn_user(
                f"{foreign[0].folder} was made from {foreign[0].data}, not from {title}; check "
                "that frames with the same name are the same",
            )

    def examine(
        self, dataset: SampleDataset, perceptions: Sequence[Perception], min_score: float
    ) -> None:
        """Count the objects to draw, and warn of results in another convention.

        Args:
            dataset: The drawn frames.
            perceptions: Their results.
            min_score: Score threshold of drawn objects.
        """
        self.counts = tuple(count_drawn(perceptions, min_score))
        for folder, doubt in doubts_about_shown(self._opened, dataset):
            warn_user(f"{folder}: {doubt}")

    @property
    def depth_name(self) -> str:
        """Name of the depth maps' method or weights, if known."""
        return next((each.made_by for each in self._opened if _is_depth(each)), "")

    @property
    def has_scores(self) -> bool:
        """Check if results other than depth maps are drawn."""
        return not all(_is_depth(each) for each in self._opened)

    def __call__(self, sample: CameraLidarSample) -> Perception:
        """Read the files, and warn of folders without one of the sample.

        Raises:
            ValueError: The sample has no file, or a file is damaged.
        """
        lacking = [
            each.folder for each in self._opened if not each.path(sample.sample_id).is_file()
        ]
        if len(lacking) == len(self._opened):
            raise ValueError(
                f"{', '.join(map(str, self._folders))} has no result of frame {sample.sample_id}; "
                "name another frame or another folder"
            )
        for folder in dict.fromkeys(lacking):
            warn_user(
                f"{folder} has no result of frame {sample.sample_id}, so its picture lacks it",
            )
        return read_perception(self._opened, sample)


def write_frames_picture(
    data: Path,
    frames: Sequence[str],
    out: Path,
    *,
    source: PredictorSource | ResultSource,
    min_score: float,
    velodyne: Velodyne | None = None,
) -> Path:
    """Draw one frame with all its predictions, or several side by side, to a PNG or JPEG file.

    Args:
        data: Folder of the data set; see `open_dataset`.
        frames: Names of the frames.
        out: The picture file.
        source: Source of the predictions to draw beside the data's labels.
        min_score: Score threshold of drawn detections.
        velodyne: The sweeps' folder in an object tree. None: velodyne, or else velodyne_reduced.

    Returns:
        `out`.

    Raises:
        ValueError: The data or the results lack a frame, a file is faulty, or `out` cannot be
            written.
    """
    dataset = open_dataset(
        data,
        sample_list=tuple(frames),
        velodyne=velodyne,
        parts=("image", "points", "objects", "depth"),
        needs=(),
    )
    if isinstance(source, ResultSource):
        source.check_data(dataset_title(dataset, data))
    samples = [dataset[index] for index in range(len(dataset))]
    perceptions = [source(sample) for sample in samples]
    if isinstance(source, ResultSource):
        source.examine(dataset, perceptions, min_score)
    perceptions = [each.filter_by_score(min_score) for each in perceptions]
    samples = [
        undo_turn(sample, each.undone_turn or LidarTurn())
        for sample, each in zip(samples, perceptions, strict=True)
    ]
    if len(samples) > 1:
        picture = draw_rows(list(zip(samples, perceptions, strict=True)))
    else:
        picture = frame_sheet(
            samples[0],
            perceptions[0].depth,
            dense_name=source.depth_name,
            detections2d=perceptions[0].detections2d,
            detections3d=perceptions[0].detections3d,
            objects=perceptions[0].objects,
            further=perceptions[0].further,
        )
    write_rgb(out, picture)
    return out


def _is_depth(result: ResultFolder) -> bool:
    return result.name == "depth"
