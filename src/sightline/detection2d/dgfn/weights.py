"""Weights of the paper's network: VGG16's as a start, batch normalisation folded at the end."""

import pickle
from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import torch
from safetensors.torch import load_file
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

from sightline.data.open import open_dataset
from sightline.detection2d.config import Detection2DConfig
from sightline.detection2d.dgfn.network import VGG_CONVS, VggStream
from sightline.detection2d.model import Detector
from sightline.detection2d.placement import camera_image, lidar_image, place
from sightline.files.problem import install_command
from sightline.files.settings import config_to_dict, parse_settings
from sightline.files.weights import Weights, fill_network
from sightline.simulation.packaged import PACKAGED_FRAMES

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

    The features of conv5_3 are scaled to the mean length that L2Norm gives those of conv4_3
    (`l2_norm_scale`), measured on the package's frames. Left at their own length, up to twenty
    times that, they saturate all that is random after them, the gates of fc7 too. The scaling is
    exact: ReLU and pooling commute with it.

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
    for sensor in network.streams:
        stream = _vgg_stream(network, sensor)
        for conv, (weight, bias) in zip(stream.vgg_convs, convs, strict=True):
            assert conv.bias is not None, "VGG16's convolutions have one"
            copies = conv.weight.shape[1] // weight.shape[1]
            with torch.no_grad():
                conv.weight.copy_(weight.repeat(1, copies, 1, 1) / copies)
                conv.bias.copy_(bias)
    _scale_conv5_3(network, network.config.dgfn.l2_norm_scale)


@torch.no_grad()
def _scale_conv5_3(network: Detector, length: float) -> None:
    """Scale the conv5_3 of each stream to this mean length of the features over frames' pixels."""
    lengths: dict[str, list[float]] = {sensor: [] for sensor in network.streams}
    frames = open_dataset(PACKAGED_FRAMES, parts={"image", "points"})
    for index in range(len(frames)):
        placed, _ = place(frames[index], network.config.input)
        image, lidar = camera_image(placed)[None], lidar_image(placed, network.config.input)[None]
        for sensor, planes in network.planes({"image": image, "lidar": lidar}).items():
            stream = _vgg_stream(network, sensor)
            features = stream.to_conv5_3(planes).norm(dim=1)
            lengths[sensor].append(float(features.mean()))
    for sensor, found in lengths.items():
        conv5_3 = _vgg_stream(network, sensor).vgg_convs[-1]
        factor = length * len(found) / sum(found)
        for parameter in conv5_3.parameters():
            parameter.mul_(factor)


def _vgg_stream(network: Detector, sensor: str) -> VggStream:
    stream = network.streams[sensor]
    assert isinstance(stream, VggStream), "of a network with VGG16's layout"
    return stream


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
        for out_channels in group:
            pair = []
            for kind, shape in (
                ("weight", (out_channels, channels, 3, 3)),
                ("bias", (out_channels,)),
            ):
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
            place, channels = place + 2, out_channels
        place += 1
    return found


def fold_batch_norm(weights: Weights) -> Weights:
    """Fold the batch normalisation of a trained `dgfn` network into its convolutions.

    The result is the network with `batch_norm` false and, up to rounding, the same outputs. Weights
    of other networks are returned as they are.

    Raises:
        ValueError: The weights do not fit the network that they describe.
    """
    config = parse_settings(Detection2DConfig, weights.config)
    if config.dgfn is None or not config.dgfn.batch_norm:
        return weights
    folded_config = replace(config, dgfn=replace(config.dgfn, batch_norm=False))
    with torch.random.fork_rng(devices=()):  # a training goes on afterwards
        network, folded = Detector(config), Detector(folded_config)
    fill_network(network, weights.tensors)
    with torch.no_grad():
        for sensor, stream in folded.streams.items():
            convs = [each for each in stream.modules() if isinstance(each, nn.Conv2d)]
            for conv, pair in zip(convs, _normalised(network.streams[sensor]), strict=True):
                conv.load_state_dict(fuse_conv_bn_eval(*pair).state_dict())
    others = {
        name: tensor
        for name, tensor in network.state_dict().items()
        if not name.startswith("streams.") or name.endswith(".norm.scale")
    }
    tensors = {**folded.state_dict(), **others}
    return replace(weights, config=config_to_dict(folded_config), tensors=tensors)


def _normalised(stream: nn.Module) -> list[tuple[nn.Conv2d, nn.BatchNorm2d]]:
    """Pair the convolutions of a stream with the normalisations after them."""
    layers = [each.eval() for each in stream.modules() if not list(each.children())]
    return [
        (conv, norm)
        for conv, norm in pairwise(layers)
        if isinstance(conv, nn.Conv2d) and isinstance(norm, nn.BatchNorm2d)
    ]
