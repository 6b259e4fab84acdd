import itertools
import math
from dataclasses import replace

import pytest
import torch
from safetensors.torch import save_file

import sightline
from sightline.detection2d.config import PAPER, DgfnConfig, InputConfig
from sightline.detection2d.dgfn.network import VGG_CONVS
from sightline.detection2d.dgfn.weights import load_vgg_weights
from sightline.detection2d.model import Detector
from sightline.detection2d.placement import camera_image, lidar_image, place
from sightline.simulation.packaged import PACKAGED_FRAMES
from tests.detection2d.frames import TINY

SMALL_FRAMES = replace(PAPER, input=InputConfig(size=(48, 96)))


@pytest.fixture(scope="module")
def tensors():
    """What torchvision's VGG16 holds up to its classifier."""
    torch.manual_seed(0)
    made, place, channels = {}, 0, 3
    for group in VGG_CONVS:
        for count in group:
            made[f"features.{place}.weight"] = torch.randn(count, channels, 3, 3) / math.sqrt(
                4 * channels
            )
            made[f"features.{place}.bias"] = torch.randn(count)
            place, channels = place + 2, count
        place += 1
    return made


@pytest.fixture(scope="module")
def files(tensors, tmp_path_factory):
    folder = tmp_path_factory.mktemp("vgg")
    torch.save({**tensors, "classifier.0.bias": torch.zeros(2)}, folder / "vgg16.pth")
    save_file(tensors, folder / "vgg16.safetensors")
    return folder


def test_the_places_are_those_of_torchvisions_vgg16(tensors):
    models = pytest.importorskip("torchvision.models", reason="no torchvision")
    with torch.device("meta"):
        peer = models.vgg16().features.state_dict()
    assert {name: tensor.shape for name, tensor in tensors.items()} == {
        f"features.{name}": tensor.shape for name, tensor in peer.items()
    }


@pytest.mark.parametrize("suffix", ["pth", "safetensors"])
def test_every_stream_starts_from_the_file(tensors, files, suffix):
    network = Detector(SMALL_FRAMES)
    load_vgg_weights(network, str(files / f"vgg16.{suffix}"))
    for stream in network.streams.values():
        *before, last = zip(stream.vgg_convs, list(tensors)[::2], strict=True)
        for conv, name in before:
            assert torch.equal(conv.weight, tensors[name])
            assert torch.equal(conv.bias, tensors[name.replace("weight", "bias")])
        conv, name = last
        factor = conv.weight.flatten()[0] / tensors[name].flatten()[0]
        assert 0 < factor < 1
        torch.testing.assert_close(conv.weight, tensors[name] * factor)
        torch.testing.assert_close(conv.bias, tensors[name.replace("weight", "bias")] * factor)


@torch.no_grad()
@pytest.mark.parametrize("fusion", ["gated", "early"])
def test_features_of_conv5_3_get_the_length_of_conv4_3s(files, fusion):
    network = Detector(replace(SMALL_FRAMES, fusion=fusion))
    load_vgg_weights(network, str(files / "vgg16.pth"))
    lengths = {sensor: [] for sensor in network.streams}
    frames = sightline.open_dataset(PACKAGED_FRAMES)
    for index in range(2):
        placed, _ = place(frames[index], SMALL_FRAMES.input)
        given = {"image": camera_image(placed), "lidar": lidar_image(placed, SMALL_FRAMES.input)}
        planes = network.planes({name: image[None] for name, image in given.items()})
        for sensor, each in planes.items():
            maps = each
            stream = network.streams[sensor]
            convs = 0
            for layer in (*itertools.chain(*stream.to_conv4_3), *stream.to_fc7):
                maps = layer(maps)
                convs += isinstance(layer, torch.nn.Conv2d)
                if convs == 13 and isinstance(layer, torch.nn.ReLU):
                    break
            lengths[sensor].append(float(maps.square().sum(dim=1).sqrt().mean()))
    for found in lengths.values():
        assert sum(found) / 2 == pytest.approx(20.0, rel=1e-3)


def test_a_stream_of_both_sensors_answers_equal_images_as_one_sensor_would(files):
    both, one = (Detector(replace(SMALL_FRAMES, fusion=fusion)) for fusion in ("early", "camera"))
    for network in (both, one):
        load_vgg_weights(network, str(files / "vgg16.pth"))
    image = torch.rand(1, 3, 16, 16)
    first, expected = (
        network.streams[name].vgg_convs[0] for network, name in ((both, "both"), (one, "camera"))
    )
    torch.testing.assert_close(first(image.repeat(1, 2, 1, 1)), expected(image))


def broken(tensors, path, how):
    if how == "text":
        path.write_text("hello")
    elif how == "code":
        torch.save({"features.0.weight": torch.nn.Linear(1, 1)}, path)
    elif how == "list":
        torch.save([torch.zeros(1)], path)
    elif how == "other":
        torch.save({**tensors, "features.5.weight": torch.zeros(1)}, path)
    elif how == "nan":
        torch.save({**tensors, "features.28.bias": torch.full((512,), torch.nan)}, path)
    return path


@pytest.mark.parametrize(
    ("how", "message"),
    [
        ("absent", "cannot be read as VGG16's weights"),
        ("text", "damaged|cannot be read"),
        ("code", "holds more than tensors"),
        ("list", r"expected features\.0\.weight"),
        ("other", r"expected features\.5\.weight of shape \[128, 64, 3, 3\]"),
        ("nan", r"NaN or infinite values in features\.28\.bias"),
    ],
)
def test_a_file_of_something_else_is_refused_with_what_to_do(tensors, tmp_path, how, message):
    path = broken(tensors, tmp_path / "w.pth", how)
    with torch.device("meta"):
        network = Detector(PAPER)
    with pytest.raises(ValueError, match=message) as refused:
        load_vgg_weights(network, str(path))
    assert "--model.init_args.vgg_weights null" in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_narrow_network_is_refused(files):
    with pytest.raises(ValueError, match=r"fit a network of width 1, got 0\.03"):
        load_vgg_weights(Detector(TINY), str(files / "vgg16.pth"))


def test_a_normalised_network_is_refused(files):
    with torch.device("meta"):
        network = Detector(replace(PAPER, dgfn=DgfnConfig(batch_norm=True)))
    with pytest.raises(ValueError, match="fit streams without batch_norm; begin without them by"):
        load_vgg_weights(network, str(files / "vgg16.pth"))


def test_without_a_net_it_says_where_to_fetch_them(monkeypatch):
    models = pytest.importorskip("torchvision.models", reason="no torchvision")

    def refuse(*_, **__):
        raise OSError("no route to host")

    monkeypatch.setattr(models.VGG16_Weights, "get_state_dict", refuse)
    with pytest.raises(
        ValueError, match=r"no route to host\); fetch https://.* elsewhere and name"
    ):
        load_vgg_weights(Detector(PAPER), "imagenet")


def test_without_torchvision_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "torchvision.models", None)
    with torch.device("meta"):
        network = Detector(PAPER)
    with pytest.raises(ValueError, match=r"pip install '\.\[pretrained\]'.*; or name a file"):
        load_vgg_weights(network, "imagenet")
