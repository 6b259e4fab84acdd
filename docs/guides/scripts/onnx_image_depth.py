"""Depth of a KITTI frame from its image and few or no returns, by numpy and onnxruntime alone.

python onnx_image_depth.py depth-image.onnx IMAGE.png VELODYNE.bin CALIB.txt OUT.npz
"""

import sys
from typing import Any, NamedTuple

import numpy as np

from depth_maps import write_maps
from kitti_frame import Array, Frame, Steps, arguments, open_graph, read_frame
from onnx_depth import sparse_map
from onnx_detection2d import shrink


class Guess(NamedTuple):
    """Depth and its expected error [m]."""

    depth_m: Array
    uncertainty_m: Array


def guess(model: str, frame: Frame) -> Guess:
    """Shrink the frame, run the network, enlarge its maps."""
    net, steps = open_graph(model, "depth-completion", "image", "sparse_depth_m", "filled_depth_m")
    if steps["filling"]["method"] != "street":
        sys.exit(f"{model} completes a sweep; use onnx_depth.py")
    size, rule = frame.rgb.shape[:2], steps["resizing"]
    focal = frame.camera[1, 1], frame.camera[0, 0]
    height, width = (
        max(round(side * rule["focal_px"] / own), 1) for side, own in zip(size, focal, strict=True)
    )
    if height > size[0] or width > size[1]:
        sys.exit(f"this script only shrinks frames, got {size}, wanted {height, width}; enlarge it")
    scale = np.array([width / size[1], height / size[0]])
    camera = frame.camera.copy()  # pixels are squares around their centres
    camera[:2] = scale[:, None] * camera[:2] + (scale[:, None] - 1) / 2 * camera[2]
    small = frame._replace(rgb=shrink(frame.rgb, (height, width)), camera=camera)
    planes = {
        "image": small.rgb.astype(np.float32).transpose(2, 0, 1) / 255,
        "sparse_depth_m": sparse_map(small)[None],
        "filled_depth_m": street(small, steps["filling"])[None],
    }
    stride = steps["padding"]["multiple_of"]
    margins = ((0, 0), (-height % stride, 0), (0, -width % stride))  # at the top and right
    modes = {"image": "edge", "sparse_depth_m": "constant", "filled_depth_m": "edge"}
    pad: Any = np.pad
    inputs = {name: pad(each, margins, mode=modes[name])[None] for name, each in planes.items()}
    found = net.run(["depth_m", "uncertainty_m"], inputs)
    depth, error = (enlarge(m[0, 0, -height % stride :, :width], size) for m in found)
    return Guess(depth.clip(*steps["range_m"]), error)


def street(frame: Frame, rule: Steps) -> Array:
    """Depth of a plain street in the camera's pixels; the LiDAR is level and at KITTI's height."""
    height, width = frame.rgb.shape[:2]
    turn, shift = frame.mounting[:3, :3], frame.mounting[:3, 3]
    above_road = rule["usual_lidar_height_m"] - (turn.T @ shift)[2]
    above_road = max(above_road, rule["lowest_camera_m"])
    across, down, constant = turn[:, 2] @ np.linalg.inv(frame.camera[:, :3])
    slope = across * np.arange(width) + down * np.arange(height)[:, None] + constant
    rise = np.maximum(-slope / above_road, slope / rule["wall_height_m"])
    return (1 / (1 / rule["farthest_m"] + rise)).astype(np.float32)


def enlarge(plane: Array, size: tuple[int, int]) -> Array:
    """Interpolate a map linearly between the centres of its pixels, along rows and columns."""
    for axis, count in enumerate(size):
        old = plane.shape[axis]
        places = ((np.arange(count) + 0.5) * old / count - 0.5).clip(0, old - 1)
        first = np.minimum(places.astype(int), max(old - 2, 0))
        share = np.expand_dims(places - first, 1 - axis)
        after = plane.take(np.minimum(first + 1, old - 1), axis)
        plane = plane.take(first, axis) * (1 - share) + after * share
    return plane.astype(np.float32)


if __name__ == "__main__":
    model, *files, out = arguments(__doc__, 5)
    write_maps(out, guess(model, read_frame(*files))._asdict())
