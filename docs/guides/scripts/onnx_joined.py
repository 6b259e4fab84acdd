"""Joined objects of a KITTI frame from a folder of `sightline export`, by numpy and onnxruntime.

python onnx_joined.py FOLDER IMAGE.png VELODYNE.bin CALIB.txt
"""

import json
import sys
from pathlib import Path

import numpy as np

import onnx_detection2d
import onnx_detection3d
from joined_objects import Found, join
from kitti_frame import Frame, Steps, arguments, open_graph, read_frame
from refine_lifted import SecondStage

GRAPHS = "detection2d", "detection3d-proposals", "detection3d-refinement"


def open_folder(folder: str) -> tuple[Steps, list[str]]:
    """Read joined.json, and compare the graphs' weights with those that it was fitted for."""
    paths = [str(Path(folder) / f"{name}.onnx") for name in GRAPHS]
    try:
        rule = json.loads((Path(folder) / "joined.json").read_text())
        fitted = rule["provenance"]["sha256"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        sys.exit(f"{folder} is no folder of `sightline export FOLDER --weights joined`: {error!r}")
    for path, name in zip(paths, GRAPHS, strict=True):
        task = name.partition("-")[0]
        if open_graph(path, task)[1]["weights"] != fitted[task]:
            sys.exit(f"{path} is not of the weights of joined.json; export the folder again")
    return rule, paths


def detect(folder: str, frame: Frame) -> list[Found]:
    """Run both detectors and join their boxes, the surest object first."""
    rule, (image, first, second) = open_folder(folder)
    in_image = onnx_detection2d.detect(image, frame)
    refine = SecondStage(frame, *open_graph(second, "detection3d", "points"))
    return join(frame, in_image, onnx_detection3d.detect(first, second, frame), rule, refine)


if __name__ == "__main__":
    model, *files = arguments(__doc__, 4)
    for each in detect(model, read_frame(*files)):
        print(each.name, f"{each.score:.4f}", *np.round(each.box, 2), each.origin,
              f"{each.score3d:.4f}", *np.round(each.box3d, 3))  # fmt: skip
