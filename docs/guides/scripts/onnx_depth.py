"""Dense depth of a KITTI frame from an exported file, by numpy and onnxruntime alone.

python onnx_depth.py NAME.onnx IMAGE.png VELODYNE.bin CALIB.txt OUT.npz
"""

from typing import Any, NamedTuple

import numpy as np

from adaptive_fill import fill, inverted
from depth_maps import write_maps
from kitti_frame import Array, Frame, Steps, arguments, open_graph, pixels_of, project, read_frame
from smooth_planes import smooth_planes


class DepthMap(NamedTuple):
    """Depth [m], where it can be trusted, and the expected error [m]."""

    depth_m: Array
    valid: Array
    uncertainty_m: Array


def complete(model: str, frame: Frame) -> DepthMap:
    """Fill the sparse map, run the network on it and on its mirror image, finish its map."""
    net, steps = open_graph(model, "depth-completion", "image", "sparse_depth_m", "filled_depth_m")
    sparse = sparse_map(frame)
    if not sparse.any():
        return DepthMap(sparse, sparse > 0, np.full_like(sparse, np.inf))
    filled, is_supported = fill(sparse, steps["filling"])
    planes = {
        "image": frame.rgb.transpose(2, 0, 1) / np.float32(255),
        "sparse_depth_m": sparse[None],
        "filled_depth_m": filled[None],
    }
    (height, width), stride = sparse.shape, steps["padding"]["multiple_of"]
    margins = ((0, 0), (-height % stride, 0), (0, -width % stride))  # at the top and right
    modes = {"image": "edge", "sparse_depth_m": "constant", "filled_depth_m": "edge"}
    pad: Any = np.pad
    inputs = {name: pad(each, margins, mode=modes[name])[None] for name, each in planes.items()}
    names = ["depth_m", "uncertainty_m"]
    depth, error = net.run(names, inputs)
    if steps["flip_test"]:
        mirrored = {name: np.ascontiguousarray(each[..., ::-1]) for name, each in inputs.items()}
        depth_2, error_2 = net.run(names, mirrored)
        depth, error = (depth + depth_2[..., ::-1]) / 2, (error + error_2[..., ::-1]) / 2
    depth, error = (each[0, 0, -height % stride :, :width] for each in (depth, error))
    depth = drop_small_corrections(depth, filled, sparse > 0, steps["corrections"])
    if steps["keep_measured"]:
        depth = np.where((sparse > 0) & (filled == sparse), sparse, depth)
    depth = depth.clip(*steps["range_m"])
    if steps["smoothing"] is not None:
        inverse = inverted(depth)
        for reach in steps["smoothing"]["windows_px"]:
            inverse = smooth_planes(inverse, reach, steps["smoothing"]["noise_m"])
        depth = inverted(inverse).clip(*steps["range_m"])
    is_trusted = error < np.float32(steps["valid_below_share"]) * depth
    return DepthMap(depth, is_supported & is_trusted, error)


def sparse_map(frame: Frame) -> Array:
    """Project the sweep to depth [m]; 0: no point, of several points the nearest."""
    x, y, depth = project(frame.points, frame.camera, frame.mounting)
    places, rows, columns = pixels_of(x, y, frame.rgb.shape[:2])
    nearest = np.full(frame.rgb.shape[:2], np.inf, np.float32)
    np.minimum.at(nearest, (rows, columns), depth[places].astype(np.float32))
    return np.where(np.isfinite(nearest), nearest, np.float32(0))


def drop_small_corrections(depth: Array, filled: Array, measured: Array, rule: Steps) -> Array:
    """Undo changes of the filled map up to a threshold; from twice the threshold on they stay."""
    height = len(measured)
    top = np.where(measured.any(axis=0), measured.argmax(axis=0), height)
    around = rule["above_columns_around"]
    padded = np.pad(top, around, constant_values=height)
    top = np.lib.stride_tricks.sliding_window_view(padded, 2 * around + 1).min(axis=-1)
    first, last = rule["above_from_rows"]
    is_above = ((top - np.arange(height)[:, None] - first) / (last - first)).clip(0, 1)
    beside_px, away_px = rule["beside_to_px"]
    is_beside, reach = np.zeros(measured.shape), int(away_px)
    padded = np.pad(measured, reach)
    for down, right in np.ndindex(2 * reach + 1, 2 * reach + 1):
        share = (away_px - np.hypot(down - reach, right - reach)) / (away_px - beside_px)
        seen = padded[down : down + height, right : right + measured.shape[1]]
        is_beside = np.maximum(is_beside, seen * np.clip(share, 0, 1))
    change, least = np.log(depth / filled), rule["least"]
    limits = {
        way: least
        + (rule["above"][way] - least) * is_above
        + (rule["beside"][way] - least) * is_beside
        for way in ("nearer", "farther")
    }
    limit = np.where(change < 0, limits["nearer"], limits["farther"]).clip(1e-9)
    share = (np.abs(change) / limit - 1).clip(0, 1)
    return (filled * np.exp(share * change)).astype(np.float32)


if __name__ == "__main__":
    model, *files, out = arguments(__doc__, 5)
    write_maps(out, complete(model, read_frame(*files))._asdict())
