"""Depth completion of samples, sweeps or sparse maps by a named method or a trained network."""

import hashlib
from dataclasses import astuple, dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, Literal, cast, get_args

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, Float32
from torch import Tensor

from sightline.data.layouts.kitti_trees import Part
from sightline.depth_completion.config import DepthCompletionConfig, by_direction
from sightline.depth_completion.corrections import correction_thresholds, drop_small_corrections
from sightline.depth_completion.export_graph import export_graph
from sightline.depth_completion.given_inputs import (
    COORDINATES,
    Points,
    RGBImage,
    SparseMap,
    checked_points,
    given_planes,
    rgb_planes,
    sparse_depth_of,
    sparse_plane,
)
from sightline.depth_completion.method_names import Method
from sightline.depth_completion.methods import complete_depth, starting_depth
from sightline.depth_completion.mirrored_prediction import predict_with_mirror
from sightline.depth_completion.model import DepthCompletionNet
from sightline.depth_completion.network_task import IMAGE_WEIGHTS, NETWORK_TASK
from sightline.depth_completion.postprocess import to_depth_map
from sightline.depth_completion.sparse_map import find_holes, inside_hull
from sightline.depth_completion.street_depth import street_depth, to_focal_length
from sightline.export.names import EngineChoice, EngineName
from sightline.export.process_engine import ProcessEngine
from sightline.files.weights_header import find_weights
from sightline.geometry.calibration import Calibration
from sightline.geometry.projection import sparse_depth_map
from sightline.geometry.wrong_types import named_arguments
from sightline.inference.network import LoadedNetwork
from sightline.inference.network_predictor import NetworkPredictor
from sightline.inference.sample_predictor import SamplePredictor
from sightline.structures.arrays import warn_of_view
from sightline.structures.predictions import DepthMap
from sightline.structures.sample import CameraLidarSample


@dataclass(frozen=True, slots=True)
class DepthCompleter(SamplePredictor[DepthMap]):
    """Predictor of depth by a method without training."""

    method: Method

    def __post_init__(self) -> None:
        """Check the method's name."""
        if self.method not in get_args(Method):
            raise ValueError(
                f"there is no method {self.method} of depth completion; name one of "
                f"{', '.join(get_args(Method))}"
            )

    parts: ClassVar[tuple[Part, ...]] = ("points",)
    """Used parts of a sample."""
    needs: ClassVar[tuple[Part, ...]] = ("points",)
    """Required parts of a sample."""
    gives: ClassVar[tuple[str, ...]] = ("depth",)
    """Outputs of the task that it predicts."""
    made_by: ClassVar[dict[str, str]] = {}

    @property
    def name(self) -> str:
        """Name of the method."""
        return self.method

    @named_arguments
    def predict(self, sample: CameraLidarSample) -> DepthMap:
        """Project the sweep and complete its depth at the image's full size.

        Raises:
            ValueError: The sample has no sweep, or one with non-finite points.
        """
        return complete_depth(sparse_depth_of(sample, needs_sweep=True), self.method)


class DepthPredictor(NetworkPredictor[DepthCompletionNet, DepthMap]):
    """Predictor of depth by a trained network.

    Examples:
        >>> import sightline
        >>> from sightline.simulation.packaged import PACKAGED_FRAMES
        >>> sample = sightline.open_dataset(PACKAGED_FRAMES)[0]
        >>> predictor = sightline.DepthPredictor.load("depth-fast-cpu")
        >>> dense = predictor(sample)  # or, without a sample and without a camera:
        >>> blind = predictor.complete_points(sample.points, sample.calibration, sample.image_size)
        >>> dense.depth_m.shape == blind.depth_m.shape == sample.image_size
        True

    Takes images of any size and sweeps of any number of beams. If the camera is missing (no image,
    or a black one), depth comes from the sweep alone. Where the LiDAR saw nothing, or is missing,
    depth is guessed from the image by `image_weights` (`DepthMap.guessed`). Can be pickled, and
    called in a forked process.
    """

    parts: ClassVar[tuple[Part, ...]] = ("image", "points")
    """Used parts of a sample."""
    needs: ClassVar[tuple[Part, ...]] = ()
    """Required parts of a sample: any of them."""
    image_weights: str | Path | None
    """Weights of the network that guesses depth from the image where the LiDAR saw nothing
    (`find_holes`); None: no guesses."""

    network_task = NETWORK_TASK

    def _start(
        self,
        loaded: LoadedNetwork[DepthCompletionNet],
        engine: EngineChoice,
        device: str,
        threads: int | None,
    ) -> EngineName:
        self._network = loaded.network
        self._options: dict[str, Any] = {"engine": engine, "device": device, "threads": threads}
        self._for_image: DepthPredictor | None = None
        self.image_weights = None if self._is_guessing else IMAGE_WEIGHTS
        self._run = ProcessEngine(export_graph(loaded), name=engine, device=device, threads=threads)
        return self._run.name

    @property
    def made_by(self) -> dict[str, str]:
        """Entries of a manifest besides the name."""
        entries = super().made_by
        if self.image_weights is not None:
            content = find_weights(self.image_weights).read_bytes()
            entries["image_weights_sha256"] = hashlib.sha256(content).hexdigest()
        return entries

    @property
    def estimates_uncertainty(self) -> bool:
        """Whether the depth maps contain the expected error."""
        return self._network.config.uncertainty

    @property
    def _is_guessing(self) -> bool:
        """Whether this network predicts depth from the image, so that it needs no returns."""
        return self._network.config.filling == "street"

    def _image_predictor(self) -> "DepthPredictor":
        """Load the network for what the LiDAR did not see, once."""
        if self._for_image is None:
            assert self.image_weights is not None, "checked by the caller"
            self._for_image = DepthPredictor.load(self.image_weights, **self._options)
        return self._for_image

    @property
    def gives(self) -> tuple[str, ...]:
        """Outputs of the task that it predicts."""
        return ("depth", "uncertainty") if self.estimates_uncertainty else ("depth",)

    @property
    def has_shift_conv(self) -> bool:
        """Whether the network has the paper's Shift-Convolution branch."""
        return self._network.config.shift_conv is not None

    @named_arguments
    def predict(self, sample: CameraLidarSample) -> DepthMap:
        """Complete a sample at its image's full size; without returns, guess from the image.

        Raises:
            ValueError: The sample has neither sweep nor image, or a sweep with non-finite points.
        """
        if self._is_guessing:
            return self._guess(sample)
        sparse, image = sparse_depth_of(sample), sample.image
        if self.image_weights is None or image is None or not bool(image.any()):
            return self._complete(sparse, rgb_planes(image, sample.image_size))
        holes = find_holes(sparse.numpy())
        if holes.all():
            return self._image_predictor().predict(sample)
        completed = self._complete(sparse, rgb_planes(image, sample.image_size))
        if not holes.any():
            return completed
        return _filled(completed, self._image_predictor().predict(sample), torch.from_numpy(holes))

    def complete_points(
        self,
        points: Points,
        calibration: Calibration,
        image_size: tuple[int, int],
        image: RGBImage | None = None,
    ) -> DepthMap:
        """Complete a sweep in the camera's image.

        Args:
            points: x, y, z first [m], LiDAR frame.
            calibration: Calibration of the camera and the LiDAR.
            image_size: Height, width [px].
            image: Image as in `complete`.

        Raises:
            ValueError: The points lack coordinates, or as `complete` does.
        """
        checked = checked_points(points)
        sparse = sparse_depth_map(checked, calibration, image_size)
        cloud = torch.nn.functional.pad(checked[:, :COORDINATES].float(), (0, 1))
        warn_of_view(cloud, calibration, image_size, camera="image_from_camera")
        if image is None:
            return self.complete(sparse)
        rgb = given_planes(image, (sparse.shape[0], sparse.shape[1]))
        sample = CameraLidarSample(
            sample_id="the given points",
            calibration=calibration,
            image_size=(sparse.shape[0], sparse.shape[1]),
            image=(rgb * 255).round().to(torch.uint8),
            points=cloud,
        )
        return self.predict(sample)

    def complete(self, sparse_depth_m: SparseMap, image: RGBImage | None = None) -> DepthMap:
        """Complete a sparse depth map.

        Args:
            sparse_depth_m: Metres along the optical axis, 0 = no measurement.
            image: RGB image of 8 bits and the same size; None: the camera is missing.

        Returns:
            A map of the same size, on the CPU.

        Raises:
            ValueError: The map contains invalid depths, or the image has another size or type.
        """
        # All but the network in numpy, which uses one thread: PyTorch's others would keep waiting
        # for work on the cores that an engine of another library needs.
        sparse = sparse_plane(sparse_depth_m)
        return self._complete(sparse, given_planes(image, (sparse.shape[0], sparse.shape[1])))

    def _complete(
        self, sparse: Float32[Tensor, "height width"], rgb: Float32[Tensor, "3 height width"]
    ) -> DepthMap:
        settings = self._network.config
        if settings.filling == "street":
            raise ValueError(
                f"{self.name} needs the camera's calibration; call it with a sample, or use "
                "complete_points"
            )
        if not sparse.numpy().any():
            return self._empty_map(sparse)
        filled = (
            starting_depth(sparse, settings.filling) if self._network.takes_filled_depth else None
        )
        if filled is not None:
            is_supported = filled.valid
        else:
            is_supported = torch.from_numpy(inside_hull(sparse.numpy() > 0))
        outputs = self._outputs(rgb, sparse, None if filled is None else filled.depth_m)
        depth_m = outputs["depth_m"]
        if filled is not None:
            depth_m = _without_small_corrections(depth_m, filled.depth_m, sparse, settings)
            if settings.keep_measured:
                is_kept = (sparse > 0) & (filled.depth_m == sparse)
                depth_m = torch.where(is_kept, sparse, depth_m)
        return to_depth_map(
            depth_m,
            outputs.get("uncertainty_m"),
            is_supported=is_supported,
            smoothing=settings.smoothing,
        )

    def _outputs(
        self,
        rgb: Float32[Tensor, "3 height width"],
        sparse: Float32[Tensor, "height width"],
        filled: Float32[Tensor, "height width"] | None,
    ) -> dict[str, Float[Tensor, "height width"]]:
        """Run the network on one frame's inputs."""
        stride = self._network.stride
        inputs = {
            "image": _padded(rgb, stride, "edge"),
            "sparse_depth_m": _padded(sparse[None], stride, "constant"),  # no invented returns
        }
        if filled is not None:
            inputs["filled_depth_m"] = _padded(filled[None], stride, "edge")
        is_mirrored = self._network.config.flip_test
        outputs = predict_with_mirror(self._run, inputs) if is_mirrored else self._run(inputs)
        top, width = -sparse.shape[0] % stride, sparse.shape[1]
        return {name: planes[0, 0, top:, :width] for name, planes in outputs.items()}

    def _guess(self, sample: CameraLidarSample) -> DepthMap:
        """Predict by a network that starts from a plain street."""
        view = to_focal_length(sample, self._network.config.focal_px)
        sparse, returns = sparse_depth_of(view), sparse_depth_of(sample)
        rgb = rgb_planes(view.image, view.image_size)
        if not rgb.numpy().any() and not sparse.numpy().any():
            return self._empty_map(returns)
        outputs = self._outputs(rgb, sparse, street_depth(view))
        depth_m, *errors = (
            _resized(outputs[name], sample.image_size)
            for name in ("depth_m", "uncertainty_m")
            if name in outputs
        )
        guess = to_depth_map(
            depth_m,
            errors[0] if errors else None,
            is_supported=starting_depth(returns, "second").valid,
            smoothing=self._network.config.smoothing,
        )
        holes = find_holes(returns.numpy())
        if not holes.any():
            return guess
        is_guess = torch.from_numpy(holes)
        return replace(guess, valid=guess.valid & ~is_guess, guessed=is_guess)

    def _empty_map(self, sparse: Float32[Tensor, "height width"]) -> DepthMap:
        return DepthMap(
            depth_m=torch.zeros_like(sparse),
            valid=torch.zeros_like(sparse, dtype=torch.bool),
            uncertainty_m=(
                torch.full_like(sparse, torch.inf) if self.estimates_uncertainty else None
            ),
        )


def _filled(completed: DepthMap, guess: DepthMap, holes: Bool[Tensor, "height width"]) -> DepthMap:
    """Replace a completed map in its holes by a guess from the image."""
    uncertainty_m = completed.uncertainty_m
    if uncertainty_m is not None and guess.uncertainty_m is not None:
        uncertainty_m = torch.where(holes, guess.uncertainty_m, uncertainty_m)
    return DepthMap(
        depth_m=torch.where(holes, guess.depth_m, completed.depth_m),
        valid=completed.valid & ~holes,
        uncertainty_m=uncertainty_m,
        guessed=holes,
    )


def _without_small_corrections(
    depth_m: Float[Tensor, "height width"],
    filled_m: Float32[Tensor, "height width"],
    sparse_m: Float32[Tensor, "height width"],
    settings: DepthCompletionConfig,
) -> Float[Tensor, "height width"]:
    """Undo the corrections below the thresholds of the settings."""
    default = settings.least_correction
    above = by_direction(settings.least_correction_above, default=default)
    beside = by_direction(settings.least_correction_beside, default=default)
    if not max(default, *astuple(above), *astuple(beside)):
        return depth_m
    thresholds = correction_thresholds(
        sparse_m.numpy() > 0, default=default, above=above, beside=beside
    )
    predicted_m = depth_m.float().numpy(force=True)
    return torch.from_numpy(drop_small_corrections(predicted_m, filled_m.numpy(), thresholds))


Completer = DepthCompleter | DepthPredictor


def choose_completer(
    *,
    method: str | None = None,
    weights: str | Path | None = None,
    engine: EngineChoice = "torch",
    device: str = "cpu",
    threads: int | None = None,
) -> Completer:
    """Create a completer from a method's name or weights; by default from the default weights.

    Raises:
        ValueError: Both are named, there is no such method, the weights are a method's name, or as
            `DepthPredictor.load` does.
    """
    if str(weights) in get_args(Method) and not Path(str(weights)).exists():
        raise ValueError(
            f"{weights} is a method without a network, and has no weights; name it as the method, "
            f"--method {weights}"
        )
    if method is None:
        return DepthPredictor.load(
            NETWORK_TASK.default_weights if weights is None else weights,
            engine=engine,
            device=device,
            threads=threads,
        )
    if weights is not None:
        raise ValueError(
            f"depth is completed by a method or by weights, got method {method} and weights "
            f"{weights}; name one of them"
        )
    return DepthCompleter(cast("Method", method))


def _resized(
    plane: Float[Tensor, "height width"], size: tuple[int, int]
) -> Float32[Tensor, "new_height new_width"]:
    """Resize linearly to height and width."""
    array = plane.float().numpy(force=True)
    return torch.from_numpy(cv2.resize(array, size[::-1], interpolation=cv2.INTER_LINEAR))


def _padded(
    planes: Float32[Tensor, "channels height width"],
    stride: int,
    mode: Literal["constant", "edge"],
) -> Float32[Tensor, "1 channels padded_height padded_width"]:
    """Make a batch of one, padded at the top and right to multiples of the stride.

    The bottom is not padded: networks are trained on crops that end at the image's bottom, on the
    ground near the car, where depth changes most between rows. In the sky nothing is measured.
    """
    height, width = planes.shape[-2:]
    margins = ((0, 0), (-height % stride, 0), (0, -width % stride))
    return torch.from_numpy(np.pad(planes.numpy(), margins, mode=mode)[None])
