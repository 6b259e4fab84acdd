"""Settings of the depth completion networks. The defaults are Yu and Kee's as we read it."""

import math
from dataclasses import dataclass, field
from typing import Literal, get_args, get_origin, get_type_hints

from sightline.data.settings import IN_USE_ALONE
from sightline.depth_completion.method_names import FillingEdition

TAPS = 9
"""Directions of a Shift-Convolution: the pixel itself and its eight neighbours."""

# A file of weights may come from anywhere; these settings cost time or memory but add no weights.
_SMALLEST_SCALE_M, _LARGEST_SCALE_M = 1e-3, 1e6
_LONGEST_SHIFT_PX = 1024
_MOST_SCALES = 8
_MOST_PROPAGATION_STEPS = 64
_WIDEST_WINDOW_PX = 1024
_MOST_WINDOWS = 8


def _check_at_least(name: str, value: int, smallest: int) -> None:
    if value < smallest:
        raise ValueError(f"{name} must be at least {smallest}, got {value}")


def _check_at_most(name: str, value: int, largest: int) -> None:
    if value > largest:
        raise ValueError(f"{name} must be at most {largest}, got {value}")


def _check_choices(settings: object, prefix: str = "") -> None:
    """Refuses what is none of a setting's choices; a config from a file was checked there."""
    for name, kind in get_type_hints(type(settings)).items():
        if get_origin(kind) is Literal and getattr(settings, name) not in get_args(kind):
            choices = ", ".join(map(str, get_args(kind)))
            raise ValueError(
                f"{prefix}{name} must be one of {choices}, got {getattr(settings, name)!r}"
            )


@dataclass(frozen=True, kw_only=True)
class ShiftConvConfig:
    """Shift-Convolution branch: spreads the sparse depth to a filled map, the E-Point."""

    channels: int = 36
    """Channels of each layer: a multiple of 9, the directions of a shift."""
    layers: int = 8
    """Number of Shift-Convolutions in a row: depth travels by one shift in each."""
    shifts_px: tuple[int, ...] = (1,)
    """How far each layer shifts, in pixels; repeated from the start when it runs out."""
    stride: Literal[1, 2, 4] = 1
    """Blocks of so many pixels squared are folded into channels first: cheaper, longer reach."""

    def __post_init__(self) -> None:
        """Checks the choices and the numbers."""
        _check_choices(self, "shift_conv.")
        if self.channels < TAPS or self.channels % TAPS:
            raise ValueError(f"shift_conv.channels must be a multiple of 9, got {self.channels}")
        _check_at_least("shift_conv.layers", self.layers, 1)
        if not self.shifts_px or min(self.shifts_px) < 1:
            raise ValueError(
                f"shift_conv.shifts_px must hold one shift or more of at least 1 pixel, "
                f"got {self.shifts_px}"
            )
        _check_at_most("shift_conv.shifts_px", max(self.shifts_px), _LONGEST_SHIFT_PX)


@dataclass(frozen=True, kw_only=True)
class TrunkConfig:
    """Light HRNet: several scales side by side, each half as large as the one before."""

    channels: tuple[int, ...] = (32, 64, 128, 256)
    """Channels of each scale, the largest map first."""
    modules: int = 3
    """Rounds of residual blocks at every scale, each ending in an exchange between scales."""
    blocks: int = 2
    """Residual blocks per module and scale."""
    lowest_blocks: int = 1
    """Residual blocks per module at the smallest scale: the paper halves them there."""
    reduction: int = 1
    """Residual blocks narrow their channels by this factor."""
    exchange: Literal["all", "neighbours"] = "all"
    """Which scales feed into a scale: all, or only the next larger and the next smaller one."""
    head_kernel_px: Literal[1, 3] = 3
    """Kernel of the one convolution that reads all scales together: 1 is nine times cheaper."""

    def __post_init__(self) -> None:
        """Checks the choices and the numbers."""
        _check_choices(self, "trunk.")
        for name in ("modules", "blocks", "lowest_blocks", "reduction"):
            _check_at_least(f"trunk.{name}", getattr(self, name), 1)
        if not self.channels or min(self.channels) < 1:
            raise ValueError(
                f"trunk.channels must hold one positive number a scale, got {self.channels}"
            )
        _check_at_most("the number of trunk.channels", len(self.channels), _MOST_SCALES)
        if any(count % self.reduction for count in self.channels):
            raise ValueError(
                f"trunk.channels must be multiples of trunk.reduction {self.reduction}, "
                f"got {self.channels}"
            )

    @property
    def stride(self) -> int:
        """How much smaller the smallest scale is: its input's sides must be multiples of it."""
        return int(2 ** (len(self.channels) - 1))


@dataclass(frozen=True, kw_only=True)
class PlaneSmoothing:
    """How a finished map is smoothed; see `smooth_planes`."""

    windows_px: tuple[int, ...] = (12, 24)
    """How far the window of each pass goes to all sides of its pixel."""
    noise_m: float = 0.02
    """Standard deviation of the measurements [m]: at most this by the HDL-64E's data sheet."""

    def __post_init__(self) -> None:
        """Checks the numbers."""
        if not self.windows_px or min(self.windows_px) < 1:
            raise ValueError(
                "smoothing.windows_px must hold one window or more of at least 1 pixel, got "
                f"{self.windows_px}"
            )
        _check_at_most("smoothing.windows_px", max(self.windows_px), _WIDEST_WINDOW_PX)
        _check_at_most("the number of smoothing.windows_px", len(self.windows_px), _MOST_WINDOWS)
        if not 0 <= self.noise_m < math.inf:
            raise ValueError(f"smoothing.noise_m must be at least 0 and finite, got {self.noise_m}")


@dataclass(frozen=True, kw_only=True)
class ByDirection:
    """How large corrections must be to count, by where they move a pixel."""

    nearer: float
    """Those that bring it nearer to the camera (the logarithm of a factor)."""
    farther: float
    """Those that take it farther away."""


@dataclass(frozen=True, kw_only=True)
class DepthCompletionConfig:
    """A depth completion network."""

    depth_scale_m: float = 85.0
    """Depth [m] that is 1 inside the network."""
    shift_conv: ShiftConvConfig | None = ShiftConvConfig()
    """The E-Point branch. None: the same network fed by image and points only."""
    trunk: TrunkConfig = TrunkConfig()
    """What sees image and depth together."""
    stem_channels: int = 32
    """Channels of the convolution that each input goes through before the trunk."""
    stem_fusion: Literal["sum", "concatenate", "joint"] = "sum"
    """How the inputs meet before the trunk; joint: one convolution reads them all."""
    trunk_stride: Literal[1, 2, 4] = 1
    """The trunk works on maps smaller by this factor: blocks of pixels are folded into channels
    before it, and unfolded after it."""
    refinement_channels: int = 0
    """Channels of two last convolutions, which see the inputs once more beside what the trunk
    found. 0: the trunk gives the depth itself, as in the paper."""
    refinement_stride: Literal[1, 2, 4] = 1
    """Those two work on maps smaller by this factor, folded like the trunk's; 1: at full
    resolution, which is slow even with few channels."""
    refinement_hidden_channels: int = 0
    """Channels between those two; 0: `refinement_channels`."""
    filled_input: bool = False
    """Takes a classical completion as a further input."""
    filling: FillingEdition = "first"
    """Edition of the adaptive completion that this input is."""
    surroundings_px: int = 0
    """Reach of the window around each pixel whose nearest and farthest measurement the network is
    told, relative to the classical completion; 0: it is told depths alone."""
    residual: bool = False
    """Predicts a correction of the classical completion, and starts as that completion."""
    correction: Literal["metres", "log", "between"] = "metres"
    """Kind of the correction: added metres; a bounded factor on the completed depth; or a share of
    the way to the nearest or farthest measurement around, then a factor close to 1."""
    dead_zone: float = 0.0
    """Corrections smaller than this (the logarithm of a factor) are dropped and larger ones reduced
    by it, so that what the classical completion knows to the centimetre stays as it is."""
    validity_channel: bool = False
    """Tells the network by a channel of its own where the sparse map holds a measurement."""
    presence_channel: bool = False
    """Tells the network by a channel of its own whether there is a camera image."""
    uncertainty: bool = False
    """Predicts the expected absolute error too."""
    propagation_steps: int = 0
    """Steps in which each pixel's depth is mixed with its neighbours' at the end; 0 = none."""
    least_correction: float = field(default=0.0, metadata=IN_USE_ALONE)
    """Predictors undo what the network, its propagation included, changes of the completion by less
    than this (the logarithm of a factor), and leave it from twice this on; see
    `drop_small_corrections`."""
    least_correction_above: float | ByDirection | None = field(default=None, metadata=IN_USE_ALONE)
    """The same far above what is measured in a pixel's columns; see `least_corrections`. None: as
    everywhere."""
    least_correction_beside: float | ByDirection | None = field(default=None, metadata=IN_USE_ALONE)
    """The same within a pixel or two of a measurement. None: as everywhere."""
    keep_measured: bool = field(default=False, metadata=IN_USE_ALONE)
    """Predictors put back the measurements that the classical completion keeps."""
    flip_test: bool = field(default=False, metadata=IN_USE_ALONE)
    """Predictors run the network on the frame's mirror image, too; see `answer_with_mirror`."""
    smoothing: PlaneSmoothing | None = field(default=None, metadata=IN_USE_ALONE)
    """Of the finished map, by predictors."""

    def __post_init__(self) -> None:
        """Checks the choices, the numbers, and what belongs together."""
        _check_choices(self)
        if not _SMALLEST_SCALE_M <= self.depth_scale_m <= _LARGEST_SCALE_M:
            raise ValueError(
                f"depth_scale_m must be from {_SMALLEST_SCALE_M:g} to {_LARGEST_SCALE_M:g}, got "
                f"{self.depth_scale_m}"
            )
        _check_at_least("stem_channels", self.stem_channels, 1)
        _check_at_least("refinement_channels", self.refinement_channels, 0)
        _check_at_least("refinement_hidden_channels", self.refinement_hidden_channels, 0)
        _check_at_least("surroundings_px", self.surroundings_px, 0)
        _check_at_most("surroundings_px", self.surroundings_px, _WIDEST_WINDOW_PX)
        _check_at_least("propagation_steps", self.propagation_steps, 0)
        _check_at_most("propagation_steps", self.propagation_steps, _MOST_PROPAGATION_STEPS)
        if self.trunk_stride % self.refinement_stride:
            raise ValueError(
                f"refinement_stride must be at most trunk_stride {self.trunk_stride}, "
                f"got {self.refinement_stride}"
            )
        if self.refinement_stride > 1 and not self.refinement_channels:
            raise ValueError("refinement_stride is of the refinement: set refinement_channels too")
        self._check_what_needs_the_completion()
        for name in ("dead_zone", "least_correction"):
            self._check_of_factor(name, getattr(self, name))
        for name in ("least_correction_above", "least_correction_beside"):
            values = by_direction(getattr(self, name), default=0.0)
            self._check_of_factor(name, values.nearer)
            self._check_of_factor(name, values.farther)

    def _check_what_needs_the_completion(self) -> None:
        if self.residual and not self.filled_input:
            raise ValueError("residual corrects the classical completion: set filled_input too")
        if self.correction != "metres" and not self.residual:
            raise ValueError(
                f"correction {self.correction} is of the classical completion: set residual"
            )
        if self.correction == "between" and not self.surroundings_px:
            raise ValueError("correction between needs measurements around: set surroundings_px")
        if self.surroundings_px and (not self.filled_input or self.shift_conv):
            raise ValueError(
                "surroundings_px tells depths relative to the classical completion: set "
                "filled_input, and shift_conv to null"
            )
        if self.keep_measured and not self.filled_input:
            raise ValueError("keep_measured is of the classical completion: set filled_input too")

    def _check_of_factor(self, name: str, value: float) -> None:
        if not 0 <= value < 1:
            raise ValueError(f"{name} must be from 0 to below 1, got {value}")
        if value and self.correction == "metres":
            raise ValueError(f"{name} is of a factor's logarithm: set correction log too")

    @property
    def stride(self) -> int:
        """Height and width of the network's input must be multiples of it."""
        shift_stride = self.shift_conv.stride if self.shift_conv else 1
        return max(self.trunk_stride * self.trunk.stride, shift_stride)  # both are powers of two


def by_direction(value: float | ByDirection | None, *, default: float) -> ByDirection:
    """One number for both directions, or the two as they are; None: the default for both."""
    if isinstance(value, ByDirection):
        return value
    both = default if value is None else value
    return ByDirection(nearer=both, farther=both)
