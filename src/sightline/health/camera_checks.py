"""Image quality checks, from the pixels alone."""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float32, UInt8

BLOCK_PX = 24
"""Side length of the blocks of image regions."""

_BLACK = 12.0  # grey levels; a block whose mean and deviation are below these is covered
_FLAT = 1.5
_WHITE = 250
_SPECKLE = 40  # difference from its neighbours in grey levels
_EVEN_SHARE = 0.1  # share of the blocks that are most uniform: their variation is noise
_LOWER = 0.45  # share of the height below which there is no sky
_JPEG_PX = 8
_LIFTED = 158  # grey levels; with stray light, no level is below and many are above
_LIFTED_RANGE = 40  # minimum range of grey levels there: the sky has less
_CELL_PX = 5  # side of the cells of stray light
_REACH_CELLS = 16  # neighbourhood of a cell to either side
_STILL = 0.3  # grey levels of rounding; a sensor's noise is more, unless saturated
_STILL_PX = 12  # side of the blocks of this check
_SATURATED = (20.0, 235.0)
_MUDDY = 0.35  # same limit in spots of dirt
_MUDDY_PX = 8  # side of the blocks, two by two of them: spots are small
_SHADED = (20.0, 120.0)  # grey levels: dirt on a lens emits no light, and black is `covered`
_MIN_SIDE_PX = 4  # minimum side for a check of detail
_TINY = 1e-3
_REACH = np.ones((2 * _REACH_CELLS + 1, 2 * _REACH_CELLS + 1), np.uint8)


class CameraChecks(NamedTuple):
    """Checks of an image; a larger number is a worse image."""

    dark: float
    """255 - the grey level [0, 255] exceeded by a tenth of the pixels."""
    bright: float
    """Grey level of the 5 % quantile of pixels: haze, stray light, exposure."""
    faint: float
    """255 - the difference between the 5 % and 95 % quantiles."""
    white: float
    """Share of saturated pixels in the lower part, where there is no sky."""
    covered: float
    """Share of blocks that are black and without texture."""
    textureless: float
    """Share of blocks in the lower part with a standard deviation below 1.5 grey levels."""
    lifted: float
    """Share of the image whose neighbourhood has no dark pixel, but more contrast than a sky:
    blinding light."""
    still: float
    """Share of small unsaturated blocks without the sensor's noise: the view is covered."""
    muddy: float
    """Share of smaller, dim blocks without the sensor's noise: spots on the lens."""
    blurred: float
    """Log2 of the gradient's growth from full to half size, in the direction that loses more: blur
    removes the finest detail first."""
    noisy: float
    """Log2 of the noise [grey levels]: Immerkaer 1996, "Fast noise variance estimation", in the
    most uniform tenth of the blocks."""
    speckled: float
    """Share of the pixels that differ from the median of their 3x3 neighbours by 40 levels."""
    blocky: float
    """Log2 of the ratio of the gradients across the borders of JPEG's blocks and within them."""


MIN_SPREADS = CameraChecks(
    dark=20.0,
    bright=10.0,
    faint=20.0,
    white=0.05,
    covered=0.02,
    textureless=0.03,
    lifted=0.01,
    still=0.002,
    muddy=0.0005,
    blurred=0.1,
    noisy=0.7,
    speckled=0.01,
    blocky=0.05,
)
"""Minimum spreads for limits that also serve other sensors: variation of each check between sound
cameras of other makes."""
JPEG_MIN_SPREADS = MIN_SPREADS._replace(still=0.2, muddy=0.15, blurred=0.15, noisy=1.2, blocky=0.2)
"""Minimum spreads for JPEG images of quality 75 to 95: compression removes the noise that `still`
and `muddy` test, more in real images than in simulated ones."""


def check_camera(image: UInt8[np.ndarray, "height width 3"]) -> CameraChecks:
    """Check an RGB image; about 10 ms on one core for KITTI's size."""
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    levels = np.cumsum(np.bincount(grey.ravel(), minlength=256)) / grey.size
    low, high, bright = (float(np.searchsorted(levels, share)) for share in (0.05, 0.95, 0.9))
    lower = grey[int(_LOWER * grey.shape[0]) :]
    mean, deviation = block_statistics(grey)
    first = int(_LOWER * mean.shape[0])
    residual = _noise_residual(grey)
    noise = _block_means(residual, BLOCK_PX)
    median = cv2.medianBlur(grey, 3)
    return CameraChecks(
        dark=255 - bright,
        bright=low,
        faint=255 - (high - low),
        white=float((lower >= _WHITE).mean()),
        covered=float(_covered(mean, deviation).mean()),
        textureless=float((deviation[first:] < _FLAT).mean()),
        lifted=float(_lifted_cells(grey).mean()),
        still=float(_is_still(grey, residual, _STILL_PX, _STILL, _SATURATED).mean()),
        muddy=_muddy_share(grey, residual),
        blurred=_lost_detail(grey),
        noisy=float(np.log2(np.quantile(noise, _EVEN_SHARE) + _TINY)),
        speckled=float((cv2.absdiff(grey, median) > _SPECKLE).mean()),
        blocky=_blockiness(grey),
    )


def blank_blocks(grey: UInt8[np.ndarray, "height width"]) -> Bool[np.ndarray, "rows columns"]:
    """Mark blocks without content: black ones without texture, and blinded ones."""
    mean, deviation = block_statistics(grey)
    lifted = cv2.dilate(_lifted_cells(grey).astype(np.uint8), _REACH).astype(np.float32)
    blocks = cv2.resize(lifted, mean.shape[::-1], interpolation=cv2.INTER_AREA)
    blank: Bool[np.ndarray, "rows columns"] = _covered(mean, deviation) | (blocks > 0.5)
    return blank


def _covered(
    mean: Float32[np.ndarray, "rows columns"], deviation: Float32[np.ndarray, "rows columns"]
) -> Bool[np.ndarray, "rows columns"]:
    return (mean < _BLACK) & (deviation < _FLAT)


def block_statistics(
    grey: UInt8[np.ndarray, "height width"],
) -> tuple[Float32[np.ndarray, "rows columns"], Float32[np.ndarray, "rows columns"]]:
    """Compute mean and standard deviation of the grey levels of blocks of about `BLOCK_PX`."""
    values = grey.astype(np.float32)
    mean = _block_means(values, BLOCK_PX)
    square = _block_means(values * values, BLOCK_PX)
    return mean, np.sqrt(np.maximum(square - mean * mean, 0))


def _lost_detail(grey: UInt8[np.ndarray, "height width"]) -> float:
    if min(grey.shape) < _MIN_SIDE_PX:
        return 0.0
    half = cv2.resize(grey, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    growth = []
    for axis in (0, 1):
        fine, coarse = (_mean_step(each, axis) for each in (grey, half))
        growth.append(np.log2((coarse + _TINY) / (fine + _TINY)))
    return float(max(growth))


def _mean_step(grey: UInt8[np.ndarray, "height width"], axis: int) -> float:
    first, second = (grey[1:], grey[:-1]) if axis == 0 else (grey[:, 1:], grey[:, :-1])
    return float(cv2.absdiff(first, second).mean()) if first.size else 0.0


def _noise_residual(
    grey: UInt8[np.ndarray, "height width"],
) -> Float32[np.ndarray, "height width"]:
    """Compute the residual of Immerkaer 1996, eq. 6: its mean is the noise [grey levels]."""
    kernel = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
    residual = np.abs(cv2.filter2D(grey, cv2.CV_32F, kernel))
    return residual * np.float32(np.sqrt(np.pi / 2) / 6)


def _block_means(
    values: Float32[np.ndarray, "height width"], block_px: int
) -> Float32[np.ndarray, "rows columns"]:
    height, width = values.shape
    size = max(round(width / block_px), 1), max(round(height / block_px), 1)
    means: Float32[np.ndarray, "rows columns"]
    means = cv2.resize(values, size, interpolation=cv2.INTER_AREA)
    return means


def _muddy_share(
    grey: UInt8[np.ndarray, "height width"], residual: Float32[np.ndarray, "height width"]
) -> float:
    still = _is_still(grey, residual, _MUDDY_PX, _MUDDY, _SHADED)
    return float(cv2.erode(still.astype(np.uint8), np.ones((2, 2), np.uint8)).mean())


def _is_still(
    grey: UInt8[np.ndarray, "height width"],
    residual: Float32[np.ndarray, "height width"],
    block_px: int,
    min_noise: float,
    levels: tuple[float, float],
) -> Bool[np.ndarray, "rows columns"]:
    """Mark blocks with less noise and a mean between the levels."""
    mean = _block_means(grey.astype(np.float32), block_px)
    noise = _block_means(residual, block_px)
    still: Bool[np.ndarray, "rows columns"]
    still = (noise < min_noise) & (mean > levels[0]) & (mean < levels[1])
    return still


def _lifted_cells(
    grey: UInt8[np.ndarray, "height width"],
) -> Bool[np.ndarray, "rows columns"]:
    cell = np.ones((_CELL_PX, _CELL_PX), np.uint8)
    middles = np.s_[_CELL_PX // 2 :: _CELL_PX, _CELL_PX // 2 :: _CELL_PX]
    if not grey[middles].size:
        return np.zeros((1, 1), np.bool_)
    darkest = cv2.erode(cv2.erode(grey, cell)[middles], _REACH)
    brightest = cv2.dilate(cv2.dilate(grey, cell)[middles], _REACH)
    lifted: Bool[np.ndarray, "rows columns"]
    lifted = (darkest >= _LIFTED) & (cv2.subtract(brightest, darkest) > _LIFTED_RANGE)
    return lifted


def _blockiness(grey: UInt8[np.ndarray, "height width"]) -> float:
    if min(grey.shape) <= _JPEG_PX:
        return 0.0
    steps = cv2.absdiff(grey[:, 1:], grey[:, :-1]).mean(axis=0)
    rows = cv2.absdiff(grey[1:], grey[:-1]).mean(axis=1)
    ratios = []
    for each in (steps, rows):
        border = each[_JPEG_PX - 1 :: _JPEG_PX].mean()
        inside = np.delete(each, np.s_[_JPEG_PX - 1 :: _JPEG_PX]).mean()
        ratios.append((border + _TINY) / (inside + _TINY))
    return float(np.log2(np.mean(ratios)))


def bad_image_regions(
    image: UInt8[np.ndarray, "height width 3"],
) -> Bool[np.ndarray, "rows columns"]:
    """Mark blocks, about `BLOCK_PX` wide, that are black or blinded."""
    return blank_blocks(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY))
