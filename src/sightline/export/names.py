"""What can run a network, and the files it can be written as; imports nothing."""

from typing import Final, Literal

EngineName = Literal["torch", "onnxruntime", "openvino"]
EngineChoice = Literal["auto", "torch", "onnxruntime", "openvino"]
"""An engine by name, or that which `choice.choose_engine` takes."""
Precision = Literal["float32", "bfloat16"]
Format = Literal["onnx", "openvino"]

SUFFIXES: Final[dict[Format, str]] = {"onnx": ".onnx", "openvino": ".xml"}
"""Of the file in each format; OpenVINO puts the weights beside it, as .bin."""
