"""Joined objects of a KITTI frame from a folder of `sightline export`, by numpy and onnxruntime.

python onnx_joined.py FOLDER IMAGE.png VELODYNE.bin CALIB.txt
"""

import json
from pathlib import Path

import numpy as np

import onnx_detection2d
import onnx_detection3d
from joined_objects import Found, join
from kitti_frame import Frame, arguments, open_graph, read_frame
from refine_lifted import SecondStage


def detect(folder: str, frame: Frame) -> list[Found]:
    """Run both detectors and join their boxes, the surest object first."""
    rule = json.loads((Path(folder) / "joined.json").read_text())
    graphs = "detection2d", "detection3d-proposals", "detection3d-refinement"
    image, first, second = (str(Path(folder) / f"{name}.onnx") for name in graphs)
    in_image = onnx_detection2d.detect(image, frame)
    refine = SecondStage(frame, *open_graph(second, "detection3d", "points"))
    return join(frame, in_image, onnx_detection3d.detect(first, second, frame), rule, refine)


if __name__ == "__main__":
    model, *files = arguments(__doc__, 4)
    for each in detect(model, read_frame(*files)):
        print(each.name, f"{each.score:.4f}", *np.round(each.box, 2), each.origin,
              f"{each.score3d:.4f}", *np.round(each.box3d, 3))  # fmt: skip
