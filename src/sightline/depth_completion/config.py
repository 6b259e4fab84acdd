"""Settings of the depth completion networks. The defaults are our reading of Yu and Kee 2021."""

import math
from dataclasses import dataclass, field
from typing import Literal

from sightline.depth_completion.method_names import Filling
from sightline.files.settings import INFERENCE_ONLY
from sightline.geometry.choices import check_choices

TAPS = 9
"""Directions of a Shift-Convolution: the pixel itself and its eight neighbours."""
UNET_OUTPUT_STRIDE = 4
"""Factor by which the maps are smaller on which a U-Net predicts."""

# A file of weights may come from anywhere; these settings cost time or memory but add no weights.
_MIN_SCALE_M, _MAX_SCALE_M = 1e-3, 1e6
_MIN_FOCAL_PX, _MAX_FOCAL_PX = 50.0, 5000.0
_MAX_SHIFT_PX = 1024
_MAX_SCALES = 8
_MAX_CHANNELS, _MAX_BLOCKS = 4096, 64
_MAX_PROPAGATION_STEPS = 64
_MAX_WINDOW_PX = 1024
_MAX_WINDOWS = 8


def _check_at_least(name: str, value: int, minimum: int) -> None:
    if value < minimum:
        raise ValueError(f"{name} must be at least {minimum}, got {value}")


def _check_at_most(name: str, value: int, largest: int) -> None:
    if value > largest:
        raise ValueError(f"{name} must be at most {largest}, got {value}")


@dataclass(frozen=True, kw_only=True)
class ShiftConvConfig:
    """Shift-Convolution branch: spreads the sparse depth to a filled map, the E-Point."""

    channels: int = 36
    """Channels of each layer: a multiple of 9, the directions of a shift."""
    layers: int = 8
    """Number of consecutive Shift-Convolutions; depth moves by one shift in each."""
    shifts_px: tuple[int, ...] = (1,)
    """Shift of each layer [px]; repeated from the start if there are more layers."""
    stride: Literal[1, 2, 4] = 1
    """Side of the pixel blocks that are first folded into channels: cheaper, longer reach."""

    def __post_init__(self) -> None:
        """Check the choices and the numbers."""
        check_choices(self, "shift_conv.")
        if self.channels < TAPS or self.channels % TAPS:
            raise ValueError(f"shift_conv.channels must be a multiple of 9, got {self.channels}")
        _check_at_least("shift_conv.layers", self.layers, 1)
        if not self.shifts_px or min(self.shifts_px) < 1:
            raise ValueError(
                f"shift_conv.shifts_px must hold one shift or more of at least 1 pixel, "
                f"got {self.shifts_px}"
            )
        _check_at_most("shift_conv.shifts_px", max(self.shifts_px), _MAX_SHIFT_PX)


@dataclass(frozen=True, kw_only=True)
class TrunkConfig:
    """Trunk of parallel scales, each half as large as the one before: the paper's light HRNet."""

    channels: tuple[int, ...] = (32, 64, 128, 256)
    """Channels of each scale, the largest map first."""
    modules: int = 3
    """Number of modules: residual blocks at every scale, then an exchange between scales."""
    blocks: int = 2
    """Residual blocks per module and scale."""
    lowest_blocks: int = 1
    """Residual blocks per module at the smallest scale: the paper halves them there."""
    reduction: int = 1
    """Factor by which residual blocks reduce their channels."""
    exchange: Literal["all", "neighbours"] = "all"
    """Scales that feed into a scale: all, or only the next larger and the next smaller one."""
    head_kernel_px: Literal[1, 3] = 3
    """Kernel size of the convolution over all scales together: 1 is nine times cheaper."""

    def __post_init__(self) -> None:
        """Check the choices and the numbers."""
        check_choices(self, "trunk.")
        for name in ("modules", "blocks", "lowest_blocks", "reduction"):
            _check_at_least(f"trunk.{name}", getattr(self, name), 1)
        if not self.channels or min(self.channels) < 1:
            raise ValueError(
                f"trunk.channels must hold one positive number per scale, got {self.channels}"
            )
        _check_at_most("the number of trunk.channels", len(self.channels), _MAX_SCALES)
        if any(count % self.reduction for count in self.channels):
            raise ValueError(
                f"trunk.channels must be multiples of trunk.reduction {self.reduction}, "
                f"got {self.channels}"
            )

    @property
    def stride(self) -> int:
        """Reduction factor of the smallest scale; input sides must be multiples of it."""
        return int(2 ** (len(self.channels) - 1))


@dataclass(frozen=True, kw_only=True)
class UNetConfig:
    """U-Net from the inputs down to small maps and back to a quarter of the resolution."""

    channels: tuple[int, int, int, int, int] = (16, 24, 48, 96, 160)
    """Channels on the way down, of the maps of strides 2, 4, 8, 16 and 32."""
    blocks: tuple[int, int, int, int] = (1, 1, 2, 2)
    """Residual blocks on the way down, at strides 4, 8, 16 and 32."""
    up_channels: tuple[int, int, int, int] = (48, 64, 96, 128)
    """Channels on the way up, of the maps of strides 4, 8, 16 and 32."""

    def __post_init__(self) -> None:
        """Check the numbers."""
        for name in ("channels", "up_channels"):
            _check_at_least(f"unet.{name}", min(getattr(self, name)), 1)
            _check_at_most(f"unet.{name}", max(getattr(self, name)), _MAX_CHANNELS)
        _check_at_least("unet.blocks", min(self.blocks), 0)
        _check_at_most("unet.blocks", max(self.blocks), _MAX_BLOCKS)

    @property
    def stride(self) -> int:
        """Reduction factor of the smallest map; input sides must be multiples of it."""
        return 32


@dataclass(frozen=True, kw_only=True)
class PlaneSmoothing:
    """Smoothing of a completed map; see `smooth_planes`."""

    windows_px: tuple[int, ...] = (12, 24)
    """Reach of each pass's window to every side of its pixel [px]."""
    noise_m: float = 0.02
    """Standard deviation of the measurements [m]: the HDL-64E data sheet's upper bound."""

    def __post_init__(self) -> None:
        """Check the numbers."""
        if not self.windows_px or min(self.windows_px) < 1:
            raise ValueError(
                "smoothing.windows_px must hold one window or more of at least 1 pixel, got "
                f"{self.windows_px}"
            )
        _check_at_most("smoothing.windows_px", max(self.windows_px), _MAX_WINDOW_PX)
        _check_at_most("the number of smoothing.windows_px", len(self.windows_px), _MAX_WINDOWS)
        if not 0 <= self.noise_m < math.inf:
            raise ValueError(f"smoothing.noise_m must be at least 0 and finite, got {self.noise_m}")


@dataclass(frozen=True, kw_only=True)
class SignedThreshold:
    """Thresholds of the corrections for the two directions in which they move a pixel."""

    nearer: float
    """Threshold of corrections towards the camera (the logarithm of a factor)."""
    farther: float
    """Threshold of corrections away from the camera."""


@dataclass(frozen=True, kw_only=True)
class DepthCompletionConfig:
    """Settings of a depth completion network."""

    depth_scale_m: float = 85.0
    """Depth [m] of the value 1 inside the network."""
    shift_conv: ShiftConvConfig | None = ShiftConvConfig()
    """The E-Point branch. None: the same network with image and points as its only inputs."""
    trunk: TrunkConfig = TrunkConfig()
    """The trunk over image and depth together."""
    unet: UNetConfig | None = None
    """U-Net over all inputs, in place of stems, trunk and refinement. None: those."""
    stem_channels: int = 32
    """Channels of each input's convolution before the trunk."""
    stem_fusion: Literal["sum", "concatenate", "joint"] = "sum"
    """Fusion of the inputs before the trunk; joint: one convolution over all inputs."""
    trunk_stride: Literal[1, 2, 4] = 1
    """Factor by which the trunk's maps are smaller: blocks of pixels are folded into channels
    before the trunk and unfolded after it."""
    refinement_channels: int = 0
    """Channels of two last convolutions over the inputs and the trunk's output. 0: the trunk
    predicts the depth itself, as in the paper."""
    refinement_stride: Literal[1, 2, 4] = 1
    """Factor by which the maps of the refinement are smaller, folded like the trunk's. 1: full
    resolution, which is slow even with few channels."""
    refinement_hidden_channels: int = 0
    """Channels between the two refinement convolutions; 0: `refinement_channels`."""
    filled_input: bool = False
    """Whether a classical completion is a further input."""
    filling: Filling = "first"
    """Completion in this input."""
    focal_px: float | None = None
    """Focal length to which images are resized before the network [px], and depth back after it;
    None: the image's own."""
    surroundings_px: int = 0
    """Reach of the window around each pixel whose nearest and farthest measurements are inputs,
    relative to the classical completion; 0: depths are the only input."""
    residual: bool = False
    """Whether the network predicts a correction of the classical completion; untrained, it returns
    the completion unchanged."""
    correction: Literal["metres", "log", "between"] = "metres"
    """Kind of the correction: added metres; a bounded factor on the completed depth; or a share of
    the way to the nearest or farthest measurement around, then a factor close to 1."""
    dead_zone: float = 0.0
    """Soft threshold of corrections (the logarithm of a factor): smaller ones are dropped, larger
    ones reduced by it. This keeps depths that the completion has right to the centimetre."""
    validity_channel: bool = False
    """Whether an extra input channel marks the pixels with a measurement."""
    presence_channel: bool = False
    """Whether an extra input channel marks the presence of a camera image."""
    uncertainty: bool = False
    """Whether the network also predicts the expected absolute error."""
    propagation_steps: int = 0
    """Number of final steps that mix each pixel's depth with its neighbours'; 0 = none."""
    least_correction: float = field(default=0.0, metadata=INFERENCE_ONLY)
    """Threshold (the logarithm of a factor) below which predictors undo the network's corrections
    of the completion, propagation included; from twice this on they are kept. See
    `drop_small_corrections`."""
    least_correction_above: float | SignedThreshold | None = field(
        default=None, metadata=INFERENCE_ONLY
    )
    """Threshold far above the measurements in a pixel's columns; see `correction_thresholds`. None:
    `least_correction`."""
    least_correction_beside: float | SignedThreshold | None = field(
        default=None, metadata=INFERENCE_ONLY
    )
    """Threshold within a pixel or two of a measurement. None: `least_correction`."""
    keep_measured: bool = field(default=False, metadata=INFERENCE_ONLY)
    """Whether predictors restore the measurements that the classical completion keeps."""
    flip_test: bool = field(default=False, metadata=INFERENCE_ONLY)
    """Whether predictors also run the network on the mirrored frame; see `predict_with_mirror`."""
    smoothing: PlaneSmoothing | None = field(default=None, metadata=INFERENCE_ONLY)
    """Smoothing of the completed map by predictors."""

    def __post_init__(self) -> None:
        """Check the choices, the numbers and their combinations."""
        check_choices(self)
        if not _MIN_SCALE_M <= self.depth_scale_m <= _MAX_SCALE_M:
            raise ValueError(
                f"depth_scale_m must be from {_MIN_SCALE_M:g} to {_MAX_SCALE_M:g}, got "
                f"{self.depth_scale_m}"
            )
        if self.focal_px is not None and not _MIN_FOCAL_PX <= self.focal_px <= _MAX_FOCAL_PX:
            raise ValueError(
                f"focal_px must be from {_MIN_FOCAL_PX:g} to {_MAX_FOCAL_PX:g}, got {self.focal_px}"
            )
        _check_at_least("stem_channels", self.stem_channels, 1)
        _check_at_least("refinement_channels", self.refinement_channels, 0)
        _check_at_least("refinement_hidden_channels", self.refinement_hidden_channels, 0)
        _check_at_least("surroundings_px", self.surroundings_px, 0)
        _check_at_most("surroundings_px", self.surroundings_px, _MAX_WINDOW_PX)
        _check_at_least("propagation_steps", self.propagation_steps, 0)
        _check_at_most("propagation_steps", self.propagation_steps, _MAX_PROPAGATION_STEPS)
        if self.trunk_stride % self.refinement_stride:
            raise ValueError(
                f"refinement_stride must be at most trunk_stride {self.trunk_stride}, "
                f"got {self.refinement_stride}"
            )
        if self.refinement_stride > 1 and not self.refinement_channels:
            raise ValueError("refinement_stride needs refinement_channels: set both")
        if self.unet is not None and self.refinement_channels:
            raise ValueError("a unet has no refinement: set refinement_channels to 0")
        self._check_completion_settings()
        for name in ("dead_zone", "least_correction"):
            self._check_log_threshold(name, getattr(self, name))
        for name in ("least_correction_above", "least_correction_beside"):
            values = by_direction(getattr(self, name), default=0.0)
            self._check_log_threshold(name, values.nearer)
            self._check_log_threshold(name, values.farther)

    def _check_completion_settings(self) -> None:
        if self.residual and not self.filled_input:
            raise ValueError("residual corrects the classical completion: set filled_input too")
        if self.correction != "metres" and not self.residual:
            raise ValueError(
                f"correction {self.correction} needs the classical completion: set residual"
            )
        if self.correction == "between" and not self.surroundings_px:
            raise ValueError(
                "correction between needs the measurements around: set surroundings_px"
            )
        if self.surroundings_px and (not self.filled_input or self.shift_conv):
            raise ValueError(
                "surroundings_px needs the classical completion: set filled_input to true and "
                "shift_conv to null"
            )
        if self.keep_measured and not self.filled_input:
            raise ValueError("keep_measured needs the classical completion: set filled_input too")
        if self.filling == "street" and not self.filled_input:
            raise ValueError("the filling street is an input: set filled_input too")
        if self.filling == "street" and (self.keep_measured or self.surroundings_px):
            raise ValueError(
                "the filling street holds no measurements: set keep_measured to false and "
                "surroundings_px to 0"
            )

    def _check_log_threshold(self, name: str, value: float) -> None:
        if not 0 <= value < 1:
            raise ValueError(f"{name} must be from 0 to below 1, got {value}")
        if value and self.correction == "metres":
            raise ValueError(f"{name} is the logarithm of a factor: set correction to log")

    @property
    def stride(self) -> int:
        """Number that must divide height and width of the network's input."""
        shift_stride = self.shift_conv.stride if self.shift_conv else 1
        own = self.unet.stride if self.unet else self.trunk_stride * self.trunk.stride
        return max(own, shift_stride)  # both are powers of two


def by_direction(value: float | SignedThreshold | None, *, default: float) -> SignedThreshold:
    """Expand one number to both directions; None: the default for both."""
    if isinstance(value, SignedThreshold):
        return value
    both = default if value is None else value
    return SignedThreshold(nearer=both, farther=both)
