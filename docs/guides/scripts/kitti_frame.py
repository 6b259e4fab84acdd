"""A frame of KITTI's object benchmark and an exported file, as the scripts here take them."""

import json
import sys
from pathlib import Path
from typing import Any, NamedTuple

import cv2  # only to decode the image
import numpy as np
import onnxruntime

from kitti_calibration import read_calibration

Array = np.ndarray
Steps = dict[str, Any]
"""Metadata of an exported file: inputs, outputs and the steps around the network."""


class Frame(NamedTuple):
    """Image, sweep and calibration."""

    rgb: Array  # height x width x 3, 0 to 255
    points: Array  # x forward, y left, z up [m], reflectance in [0, 1]; float32
    camera: Array  # 3 x 4, pixels from camera metres: P2
    mounting: Array  # 4 x 4, camera frame from LiDAR frame: R0_rect @ Tr_velo_to_cam


def arguments(usage: str | None, count: int) -> list[str]:
    """Take the arguments of a script, or end it with the last line of its docstring."""
    if len(sys.argv) != count + 1:
        sys.exit(f"usage: {(usage or '').strip().splitlines()[-1]}")
    return sys.argv[1:]


def read_frame(image: str, sweep: str, calibration: str) -> Frame:
    """Read image_2/N.png, velodyne/N.bin and calib/N.txt."""
    bgr = cv2.imread(image, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    if bgr is None:
        sys.exit(f"{image} cannot be read as an image; give a .png file of image_2")
    try:
        camera, mounting = read_calibration(calibration)
        points = np.frombuffer(Path(sweep).read_bytes(), np.float32).reshape(-1, 4)
        scale = 2 * camera[:2, 2] / bgr.shape[1::-1]  # 1: its centre is that of the image
        is_of_image = (np.diag(camera) > 0)[:2].all() and scale.max() > 0.74 and scale.min() < 1.35
        if not ((np.abs(points) <= [1e3, 1e3, 1e3, 1]).all() and is_of_image):
            raise ValueError("expected points [m], reflectances up to 1, and P2 of such an image")
        return Frame(bgr[..., ::-1], points, camera, mounting)
    except (OSError, KeyError, ValueError) as error:
        sys.exit(f"{sweep}, {calibration}: {error}; give IMAGE.png VELODYNE.bin CALIB.txt of KITTI")


def project(points: Array, camera: Array, mounting: Array) -> tuple[Array, Array, Array]:
    """Project points to x, y [px] and depth [m]; no number where they are behind the camera."""
    matrix = camera @ mounting
    x, y, depth = (points[:, :3].astype(np.float64) @ matrix[:, :3].T + matrix[:, 3]).T
    depth = np.where(depth > 0, depth, np.nan)
    return x / depth, y / depth, depth


def pixels_of(x: Array, y: Array, size: tuple[int, int]) -> tuple[Array, Array, Array]:
    """Find the points that fall on a pixel of an image (height, width): places, rows, columns."""
    column, row = np.floor(x + 0.5), np.floor(y + 0.5)  # pixel 0 has its centre at 0
    shown = (row >= 0) & (row < size[0]) & (column >= 0) & (column < size[1])
    return np.flatnonzero(shown), row[shown].astype(int), column[shown].astype(int)


def seen_points(frame: Frame, rule: Steps) -> Array:
    """Cut the sweep to the camera's view and to the range; x, y, z."""
    height, width = frame.rgb.shape[:2]
    x, y, _ = project(frame.points, frame.camera, frame.mounting)
    shown = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    raised = frame.points[:, :3] + single([0, 0, rule["height_offset_m"]])
    low, high = single(rule["lowest_m"]), single(rule["highest_m"])
    inside = ((raised >= low) & (raised <= high)).all(axis=1)
    return raised[inside & (shown | (not rule["in_view"]))]


def single(values: object) -> Array:
    """Make an array of single precision, in which networks compute."""
    return np.asarray(values, np.float32)


def open_graph(path: str, task: str, *inputs: str) -> tuple[Any, Steps]:
    """Open an exported file of a task with these inputs, and read the steps in its metadata."""
    try:
        session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    except Exception as error:  # noqa: BLE001 - onnxruntime raises many of its own
        sys.exit(f"{path} is no ONNX file that can be run: {str(error).splitlines()[0]}")
    metadata = session.get_modelmeta().custom_metadata_map
    if "sightline.processing" not in metadata:
        sys.exit(f"{path} lacks the metadata sightline.processing; export the weights again")
    if (found := metadata.get("sightline.task")) != task:
        sys.exit(f"{path} is of the task {found!r}, expected {task}; name an export of that")
    names = {each.name for each in session.get_inputs()}
    if not names.issuperset(inputs):
        given, expected = ", ".join(sorted(names)), ", ".join(inputs)
        sys.exit(f"{path} takes {given}, expected {expected}; name the other file or other weights")
    weights = json.loads(metadata.get("sightline.provenance", "{}")).get("sha256")
    return session, json.loads(metadata["sightline.processing"]) | {"weights": weights}
