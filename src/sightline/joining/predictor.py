"""Predictor of joined objects: calibration, both detectors, then the join."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from sightline.data.datasets.sample_dataset import SampleDataset
from sightline.data.layouts.kitti_trees import Part
from sightline.detection2d.predictor import DetectionPredictor
from sightline.detection3d.predictor import Detection3DPredictor
from sightline.export.names import EngineChoice
from sightline.geometry.wrong_types import named_arguments
from sightline.inference.sample_predictor import SamplePredictor
from sightline.joining.alignment import Alignment, AlignmentConfig
from sightline.joining.alignment_by_boxes import turn_by_boxes
from sightline.joining.config import JoinConfig
from sightline.joining.join import join_detections
from sightline.joining.models import JOINED, JoinModels, fitted_models, read_models
from sightline.joining.recording import measure_recording
from sightline.joining.refining import refiner_of
from sightline.structures.lidar_turn import undo_turn
from sightline.structures.predictions import Detections2D, Detections3D, Perception
from sightline.structures.sample import CameraLidarSample


class JoinedPredictor(SamplePredictor[Perception]):
    """Predictor of the objects of a frame by both sensors, or by the one that is left.

    Examples:
        >>> import dataclasses, sightline
        >>> from sightline.simulation.packaged import PACKAGED_FRAMES
        >>> sample = sightline.open_dataset(PACKAGED_FRAMES)[0]
        >>> joined = sightline.load("joined")
        >>> joined(sample).objects.origins[0]
        'measured'
        >>> joined(dataclasses.replace(sample, points=None)).objects.origins[0]  # no LiDAR
        'lifted'

    Predictions also hold the detections that were joined. Nothing is remembered from one sample to
    the next; a rotation of the LiDAR in its mount is undone after `aligned` measured it. May be
    pickled, and called in a forked process.
    """

    name = JOINED
    parts: tuple[Part, ...] = ("image", "points")
    needs: tuple[Part, ...] = ()
    gives: tuple[str, ...] = ("results",)

    @named_arguments
    def __init__(
        self,
        detector2d: DetectionPredictor,
        detector3d: Detection3DPredictor,
        models: JoinModels,
        config: JoinConfig | None = None,
        alignment: Alignment | None = None,
    ) -> None:
        """Take both detectors and the models fitted for them; `load` takes those that ship.

        Args:
            detector2d: Detector in the image.
            detector3d: Detector in the sweep.
            models: Models fitted with the weights of both.
            config: Stages of joining. None: all.
            alignment: State of the LiDAR's mount. None: the calibration is right.

        Raises:
            ValueError: The models were fitted for other weights.
        """
        models.check_fit((detector2d.name, detector2d.sha256), (detector3d.name, detector3d.sha256))
        self.detector2d, self.detector3d = detector2d, detector3d
        self.models, self.config = models, config or JoinConfig()
        self.alignment = alignment or Alignment()

    @named_arguments
    def aligned(
        self,
        samples: Sequence[CameraLidarSample] | SampleDataset,
        config: AlignmentConfig | None = None,
    ) -> "JoinedPredictor":
        """Make a predictor that undoes the LiDAR's rotation found in frames of one recording.

        The rotation is measured by edges, less the bias that it has on sound data; an angle is
        undone if it is surely more than its noise, so sound recordings are left as they are. If the
        frames do not agree, each is aligned by its own boxes. If edges tell nothing, detections do
        whether the sweeps are late: then boxes in the image are the image detector's alone.

        Args:
            samples: Frames of the recording, of which up to 15 are read, evenly spread: a list or
                a data set. If fewer than five show edges, no rotation is undone.
            config: Biases and limits. None: those for KITTI's rig.
        """
        alignment = measure_recording(samples, self._detect, config or AlignmentConfig())
        return JoinedPredictor(
            self.detector2d, self.detector3d, self.models, self.config, alignment
        )

    @classmethod
    @named_arguments
    def load(
        cls,
        *,
        detection2d: str | Path | None = None,
        detection3d: str | Path | None = None,
        models: str | Path | None = None,
        engine: EngineChoice = "torch",
        device: str = "cpu",
        threads: int | None = None,
    ) -> "JoinedPredictor":
        """Load both detectors, and the models that were fitted for them.

        Args:
            detection2d: Weights of the image detector: a name or file. None: the default ones.
            detection3d: Weights of the sweep detector. None: the default ones.
            models: File of models for these weights, from `sightline fit-joined`. None: those
                included in the package.
            engine: See `load_network`.
            device: See `load_network`.
            threads: See `load_network`.

        Raises:
            ValueError: See `load_network` and the constructor.
        """
        default = read_models()
        weights = default.provenance["weights"]
        options: dict[str, Any] = {"engine": engine, "device": device, "threads": threads}
        in_image = DetectionPredictor.load(detection2d or weights["detection2d"], **options)
        in_sweep = Detection3DPredictor.load(detection3d or weights["detection3d"], **options)
        if models is not None:
            return cls(in_image, in_sweep, read_models(Path(models)))
        return cls(in_image, in_sweep, fitted_models(in_image.sha256, in_sweep.sha256) or default)

    @property
    def made_by(self) -> dict[str, str]:
        """Entries of a manifest besides the name."""
        return {
            "detection2d_sha256": self.detector2d.sha256,
            "detection3d_sha256": self.detector3d.sha256,
            "engine": self.detector3d.engine,
        }

    @named_arguments
    def predict(self, sample: CameraLidarSample) -> Perception:
        """Detect in a sample.

        Raises:
            ValueError: The sample has neither image nor sweep, or has points that are not finite.
        """
        turn = self.alignment.turn
        sample = undo_turn(sample, turn)
        found2d, found3d = self._detect(sample)
        if self.alignment.by_boxes:
            turn = turn_by_boxes(sample, found2d, found3d)
            sample = undo_turn(sample, turn)
        config = replace(self.config, sweep_in_image=not self.alignment.late)
        refine = refiner_of(self.detector3d)
        objects = join_detections(sample, found2d, found3d, self.models, config, refine)
        return Perception(
            objects=objects,
            detections2d=found2d,
            detections3d=found3d,
            undone_turn=turn or None,
        )

    def _detect(self, sample: CameraLidarSample) -> tuple[Detections2D, Detections3D | None]:
        found2d: Detections2D = self.detector2d(sample).detections
        return found2d, None if sample.points is None else self.detector3d(sample)
