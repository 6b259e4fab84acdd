"""Final weights of the normalised network are the paper's."""

from dataclasses import replace

import pytest
import torch
from torch import nn

from sightline.detection2d.config import Detection2DConfig, DgfnConfig
from sightline.detection2d.dgfn.weights import fold_batch_norm
from sightline.detection2d.model import Detector
from sightline.files.settings import config_to_dict
from sightline.files.weights import Weights, fill_network
from tests.detection2d.frames import SIZE, TINY, TINY_COMPACT


def weights_of(config):
    """A network as after a training, with statistics and factors of its normalisations."""
    torch.manual_seed(0)
    network = Detector(config).eval()
    for module in network.modules():
        if isinstance(module, nn.BatchNorm2d):
            nn.init.uniform_(module.weight, 0.5, 2)
            nn.init.normal_(module.bias)
            nn.init.normal_(module.running_mean)
            nn.init.uniform_(module.running_var, 0.5, 2)
    described = Weights(
        task="detection2d",
        config=config_to_dict(config),
        provenance={"steps": "7"},
        tensors=network.state_dict(),
    )
    return network, described


@pytest.mark.parametrize("fusion", ["gated", "ones", "early", "late", "camera", "lidar"])
def test_the_folded_network_is_the_papers_and_gives_the_same(fusion):
    normalised = replace(TINY, fusion=fusion, dgfn=DgfnConfig(batch_norm=True))
    network, described = weights_of(normalised)
    before = torch.get_rng_state()
    folded = fold_batch_norm(described)
    assert torch.equal(torch.get_rng_state(), before)  # a training goes on
    papers = replace(normalised, dgfn=DgfnConfig())
    assert folded.config == config_to_dict(papers)
    assert folded.provenance == described.provenance
    small = Detector(papers).eval()
    fill_network(small, folded.tensors)
    assert not any(isinstance(each, nn.BatchNorm2d) for each in small.modules())
    images = dict(zip(("image", "lidar"), torch.rand(2, 1, 3, *SIZE), strict=True))
    given = {name: images[name] for name in network.input_names}
    with torch.no_grad():
        found, expected = small(**given), network(**given)
    torch.testing.assert_close(found.scores, expected.scores, rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(found.boxes, expected.boxes, rtol=1e-4, atol=1e-2)


@pytest.mark.parametrize("config", [TINY, TINY_COMPACT])
def test_other_networks_stay_as_they_are(config: Detection2DConfig):
    _, described = weights_of(config)
    assert fold_batch_norm(described) is described
