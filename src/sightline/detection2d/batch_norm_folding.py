"""Folding of batch normalisation into convolutions, which leaves the paper's network."""

from dataclasses import replace
from itertools import pairwise

import torch
from torch import nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

from sightline.detection2d.config import Detection2DConfig
from sightline.detection2d.model import Detector
from sightline.files.settings import config_to_dict, parse_settings
from sightline.files.weights import Weights, fill_network


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
            for ours, pair in zip(convs, _normalised(network.streams[sensor]), strict=True):
                ours.load_state_dict(fuse_conv_bn_eval(*pair).state_dict())
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
