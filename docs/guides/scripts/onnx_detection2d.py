"""2D boxes of a KITTI frame from an exported file, by numpy and onnxruntime alone.

python onnx_detection2d.py NAME.onnx IMAGE.png VELODYNE.bin CALIB.txt
"""

import sys

import numpy as np

from kitti_frame import (
    Array,
    Frame,
    Steps,
    arguments,
    open_graph,
    pixels_of,
    project,
    read_frame,
    single,
)

Found = list[tuple[str, float, Array]]
"""Class, score and x_min, y_min, x_max, y_max [px] of each box, the surest first."""


def detect(model: str, frame: Frame) -> Found:
    """Prepare the inputs, run the network, keep the surest boxes."""
    session, steps = open_graph(model, "detection2d", "image", "lidar")
    size, rule = frame.rgb.shape[:2], steps["resizing"]
    factor = rule["scale"] * min(rule["longest_focal_px"] / frame.camera[1, 1], 1)
    height, width = rule["size"] or [max(round(side * factor), 1) for side in size]
    if height > size[0] or width > size[1]:
        sys.exit(f"this script only shrinks frames, got {size}, wanted {height, width}; enlarge it")
    rows = rule["scale"] * (rule["rows_above_horizon"] + rule["rows_below_horizon"])
    is_long = frame.camera[1, 1] >= rule["far_view_from_focal_px"]
    if rule["size"] is None and (height > rows or is_long):
        limits = f"up to {rows:g} rows, a focal length below {rule['far_view_from_focal_px']:g} px"
        sys.exit(f"this script takes only {limits}; shrink or crop the frame, or use Sightline")
    scale = np.array([width / size[1], height / size[0]])
    camera = frame.camera.copy()  # pixels are squares around their centres
    camera[:2] = scale[:, None] * camera[:2] + (scale[:, None] - 1) / 2 * camera[2]
    lidar = lidar_image(frame._replace(camera=camera), (height, width), steps["inputs"]["lidar"])
    image = shrink(frame.rgb, (height, width)).astype(np.float32).transpose(2, 0, 1) / 255
    stride = steps["padding"]["multiple_of"]
    margins = ((0, 0), (0, -height % stride), (0, -width % stride))  # bottom and right, zeros
    inputs = {"image": np.pad(image, margins)[None], "lidar": np.pad(lidar, margins)[None]}
    scores, boxes = session.run(["scores", "boxes"], inputs)
    in_frame = (boxes[0] + 0.5) / single([*scale, *scale]) - 0.5
    in_frame = in_frame.clip(0, single([size[1] - 1, size[0] - 1] * 2))
    return suppress(scores[0], in_frame, steps["classes"], steps["suppression"])


def shrink(rgb: Array, size: tuple[int, int]) -> Array:
    """Average the pixels over the area of each new pixel."""
    shares = []
    for old, new in zip(rgb.shape[:2], size, strict=True):
        edges, pixels = np.linspace(0, old, new + 1)[:, None], np.arange(old)
        common = np.minimum(edges[1:], pixels + 1) - np.maximum(edges[:-1], pixels)
        shares.append(common.clip(0) * new / old)
    rows, columns = shares
    return np.einsum("ih,hwc,jw->ijc", rows, rgb, columns, optimize=True).round()


def lidar_image(frame: Frame, size: tuple[int, int], rule: Steps) -> Array:
    """Draw depth, height and intensity of the nearest point of each pixel, all in [0, 1]."""
    points = frame.points[frame.points[:, 0] > 0]
    x, y, depth = project(points, frame.camera, frame.mounting)
    places, rows, columns = pixels_of(x, y, size)
    order = np.argsort(-depth[places][::-1], kind="stable")  # the nearest is drawn last
    places, rows, columns = (each[::-1][order] for each in (places, rows, columns))
    x, _, z, reflectance = points[places].T
    height = (z + rule["height_offset_m"]) / rule["height_m"]
    shares = np.stack((x / rule["x_m"], height, reflectance / rule["full_reflectance"]))
    image = np.zeros((3, *size), np.float32)
    image[:, rows, columns] = 1 - shares.clip(0, 1)
    return image


def suppress(scores: Array, boxes: Array, names: list[str], rule: Steps) -> Found:
    """Keep boxes that do not overlap a surer one of their class by more than the limit."""
    places, classes = np.nonzero(scores > rule["score_above"])
    order = np.argsort(-scores[places, classes], kind="stable")[: rule["max_candidates"]]
    kept: Found = []
    for place, of_class in zip(places[order], classes[order], strict=True):
        box, name = boxes[place].astype(np.float64), names[of_class]
        rivals = np.array([other for known, _, other in kept if known == name]).reshape(-1, 4)
        low, high = np.maximum(box[:2], rivals[:, :2]), np.minimum(box[2:], rivals[:, 2:])
        shared, area = (high - low).clip(0).prod(axis=1), (box[2:] - box[:2]).clip(0).prod()
        union = area + (rivals[:, 2:] - rivals[:, :2]).prod(axis=1) - shared
        if area > 0 and (shared <= rule["iou"] * union).all():
            kept.append((name, float(scores[place, of_class]), box))
    return kept[: rule["max_detections"]]


if __name__ == "__main__":
    model, *files = arguments(__doc__, 4)
    for name, score, box in detect(model, read_frame(*files)):
        print(name, f"{score:.4f}", *(f"{side:.2f}" for side in box))
