"""Names of engines and file formats; imports nothing."""

from typing import Final, Literal

EngineName = Literal["torch", "onnxruntime", "openvino"]
EngineChoice = Literal["auto", "torch", "onnxruntime", "openvino"]
"""Name of an engine; `auto`: the engine that `choice.choose_engine` selects."""
Precision = Literal["float32", "bfloat16"]
Format = Literal["onnx", "openvino"]

SUFFIXES: Final[dict[Format, str]] = {"onnx": ".onnx", "openvino": ".xml"}
"""File suffix of each format; OpenVINO writes the weights to a .bin file beside it."""
