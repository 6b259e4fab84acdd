"""Fit of the joined scores to two detectors, on labelled frames with sound and faulty sensors."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from importlib.metadata import version
from typing import Final

from sightline.augmentation.sample_changes import sweep_of, thin_rings
from sightline.corruptions.suites import find_suite
from sightline.data.datasets.sample_dataset import SampleDataset
from sightline.detection2d.predictor import DetectionPredictor
from sightline.detection3d.predictor import Detection3DPredictor
from sightline.jobs.progress import track
from sightline.joining.calibrating import calibrate_models
from sightline.joining.fitting import FitFrame, fit_models
from sightline.joining.models import JoinModels, read_models
from sightline.joining.refining import refiner_of
from sightline.structures.predictions import Detections2D, Detections3D
from sightline.structures.sample import CameraLidarSample

Change = Callable[[CameraLidarSample, int], CameraLidarSample]
"""Fault of a sample, which may depend on its position in the list."""

_Found = tuple[Detections2D, Detections3D | None]
_CORE: Final = find_suite("core")
_RINGS: Final = 64
_THIN: Final = (16, 8, 32, 16, 8, 16)  # beams, in turns


def clean(sample: CameraLidarSample, position: int) -> CameraLidarSample:
    """Change nothing."""
    del position
    return sample


def without_camera(sample: CameraLidarSample, position: int) -> CameraLidarSample:
    """Remove the image."""
    del position
    return replace(sample, image=None)


def without_lidar(sample: CameraLidarSample, position: int) -> CameraLidarSample:
    """Remove the sweep."""
    del position
    return replace(sample, points=None)


def thin_sweep(sample: CameraLidarSample, position: int) -> CameraLidarSample:
    """Keep a half, a quarter or an eighth of the rings, in turns, also of the first one.

    A LiDAR without rings keeps so many of its points.
    """
    keep_every = _RINGS // _THIN[position % len(_THIN)]
    first = 7 * position % keep_every
    try:
        return thin_rings(sample, keep_every, first)
    except ValueError:
        return replace(sample, points=sweep_of(sample)[first::keep_every])


def core_fault(kind: str, severity: int) -> Change:
    """Make a change to one of suite `core`."""
    (case,) = _CORE.select([f"{kind}-{severity}"])

    def corrupt(sample: CameraLidarSample, position: int) -> CameraLidarSample:
        del position
        return case.corrupt(sample).sample

    return corrupt


def any_fault(sample: CameraLidarSample, position: int) -> CameraLidarSample:
    """Apply one of suite `core`, kinds and severities in turns; none that the sensors cannot have.

    A LiDAR without rings cannot lose some of them.
    """
    kind = _CORE.kinds[3 * position % len(_CORE.kinds)]
    try:
        return core_fault(kind, 1 + position // 2 % 5)(sample, position)
    except ValueError:
        return sample


FIT_CASES: Final[Mapping[str, Change]] = {
    "clean": clean,
    "thin": thin_sweep,
    "lidar_blank": without_lidar,
    "camera_blank": without_camera,
    "fault": any_fault,
}
"""States of the sensors in which the models are fitted; each frame is in all."""


def fit_pair(
    dataset: Sequence[CameraLidarSample] | SampleDataset,
    detector2d: DetectionPredictor,
    detector3d: Detection3DPredictor,
    *,
    data: str,
    frames: int,
) -> JoinModels:
    """Fit the models of joined scores for two detectors, and calibrate them; deterministic.

    Both detectors run on each frame in all `FIT_CASES`. Classes and kinds of boxes of which none
    fits a label keep the shipped models, with a warning.

    Args:
        dataset: Frames with labels, which the detectors were not trained on; simulated ones do.
        detector2d: Detector in the image.
        detector3d: Detector in the sweep.
        data: Name of the data for the models' file.
        frames: Largest number of frames to use, evenly spread over the data.

    Raises:
        ValueError: A frame has no labels or no sweep, or no box fits a label.
    """
    if frames < 1:
        raise ValueError(f"frames must be at least 1, got {frames}")
    count = min(frames, len(dataset))
    chosen = [place * len(dataset) // count for place in range(count)]
    found: list[dict[str, _Found]] = []
    names = []
    for place, index in enumerate(track(chosen, description="detecting", total=count)):
        sample = dataset[index]
        found.append(_detect(sample, place, detector2d, detector3d))
        names.append(sample.sample_id)

    def fit_frames() -> Iterator[FitFrame]:
        for case, change in FIT_CASES.items():
            for place, index in enumerate(chosen):  # read again: all would fill the memory
                in_image, in_sweep = found[place][case]
                sample = change(dataset[index], place)
                yield FitFrame(sample=sample, found2d=in_image, found3d=in_sweep)

    provenance = {
        "weights": {"detection2d": detector2d.name, "detection3d": detector3d.name},
        "sha256": {"detection2d": detector2d.sha256, "detection3d": detector3d.sha256},
        "data": data,
        "frames": ",".join(names),
        "states": list(FIT_CASES),
        "engine": detector3d.engine,
        "sightline": version("sightline"),
    }
    shipped = read_models()
    models = fit_models(fit_frames(), provenance, shipped)
    return calibrate_models(models, fit_frames(), refiner_of(detector3d), shipped)


def _detect(
    sample: CameraLidarSample,
    place: int,
    detector2d: DetectionPredictor,
    detector3d: Detection3DPredictor,
) -> dict[str, _Found]:
    """Run both detectors on a sample in each state, on an unchanged sweep once."""
    found: dict[str, _Found] = {}
    for case, change in FIT_CASES.items():
        changed = change(sample, place)
        in_sweep: Detections3D | None = None
        if found and changed.points is sample.points:
            in_sweep = found["clean"][1]
        elif changed.points is not None:
            in_sweep = detector3d(changed)
        found[case] = detector2d(changed).detections, in_sweep
    return found
