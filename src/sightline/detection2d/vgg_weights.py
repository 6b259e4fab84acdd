"""VGG16's ImageNet weights as initial weights of the streams."""

import pickle
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import torch
from safetensors.torch import load_file
from torch import Tensor

from sightline.detection2d.model import Detector
from sightline.detection2d.vgg_stream import VGG_CONVS, VggStream
from sightline.files.problem import install_command

IMAGENET: Final = "imagenet"
"""Name of the weights that torchvision downloads."""

_FLAG = "--model.init_args.vgg_weights"
_GO_ON = (
    f"name a file of torchvision's VGG16 (.pth or .safetensors) by {_FLAG}, or begin without by "
    f"{_FLAG} null"
)


def load_vgg_weights(network: Detector, source: str) -> None:
    """Copy the 13 convolutions of VGG16 to every stream of a network.

    A stream of both sensors' images gets the first convolution's kernels for each, halved. SSD also
    takes fc6 and fc7 from VGG16, by leaving out kernels; here they are random.

    Args:
        network: Network of width 1.
        source: A file, or `IMAGENET`: torchvision's `IMAGENET1K_FEATURES`, which were trained in
            the range of the streams' inputs.

    Raises:
        ValueError: The weights are not available or not VGG16's, or the network has no such
            streams.
    """
    if network.config.dgfn is None:
        raise ValueError(
            f"VGG16's weights fit dgfn's streams only; begin without them by {_FLAG} null"
        )
    if network.config.dgfn.batch_norm:
        raise ValueError(
            f"VGG16's weights fit streams without batch_norm; begin without them by {_FLAG} null"
        )
    if network.config.width != 1:
        raise ValueError(
            f"VGG16's weights fit a network of width 1, got {network.config.width}; begin without "
            f"them by {_FLAG} null"
        )
    tensors = _downloaded() if source == IMAGENET else _read(Path(source))
    convs = _convolutions(tensors, source)
    for stream in network.streams.values():
        assert isinstance(stream, VggStream), "of a network with VGG16's layout"
        for ours, (weight, bias) in zip(stream.vgg_convs, convs, strict=True):
            assert ours.bias is not None, "VGG16's convolutions have one"
            copies = ours.weight.shape[1] // weight.shape[1]
            with torch.no_grad():
                ours.weight.copy_(weight.repeat(1, copies, 1, 1) / copies)
                ours.bias.copy_(bias)


def _downloaded() -> Mapping[str, Any]:
    try:
        from torchvision.models import VGG16_Weights
    except ImportError as error:
        raise ValueError(
            "VGG16's ImageNet weights come through torchvision, which is not installed: "
            f"{install_command('pretrained')}; or {_GO_ON}"
        ) from error
    weights = VGG16_Weights.IMAGENET1K_FEATURES
    try:
        tensors: Mapping[str, Any] = weights.get_state_dict(progress=False, check_hash=True)
    except (OSError, RuntimeError) as error:
        raise ValueError(
            f"VGG16's ImageNet weights cannot be downloaded ({error}); fetch {weights.url} "
            f"elsewhere and {_GO_ON}"
        ) from error
    return tensors


def _read(path: Path) -> object:
    try:
        if path.suffix == ".safetensors":
            return load_file(path)
        return torch.load(path, map_location="cpu", weights_only=True)
    except pickle.UnpicklingError as error:  # its own message explains how to run the code in it
        raise ValueError(f"{path} holds more than tensors, or is damaged; {_GO_ON}") from error
    except Exception as error:
        # Damaged bytes make the readers raise nearly any exception.
        reason = " ".join(str(error).split())[:160] or type(error).__name__
        raise ValueError(
            f"{path} cannot be read as VGG16's weights ({reason}); {_GO_ON}"
        ) from error


def _convolutions(tensors: object, source: str) -> list[tuple[Tensor, Tensor]]:
    """Read kernels and biases in order: in torchvision's `features`, with activations and pools."""
    found = []
    place, channels = 0, 3
    for group in VGG_CONVS:
        for wanted in group:
            pair = []
            for kind, shape in (("weight", (wanted, channels, 3, 3)), ("bias", (wanted,))):
                name = f"features.{place}.{kind}"
                tensor = tensors.get(name) if isinstance(tensors, Mapping) else None
                if not isinstance(tensor, Tensor) or tuple(tensor.shape) != shape:
                    raise ValueError(
                        f"{source} holds no VGG16 as torchvision has it: expected {name} of shape "
                        f"{list(shape)}; {_GO_ON}"
                    )
                if not tensor.isfinite().all():
                    raise ValueError(f"{source} holds NaN or infinite values in {name}; {_GO_ON}")
                pair.append(tensor.float())
            found.append((pair[0], pair[1]))
            place, channels = place + 2, wanted
        place += 1
    return found
