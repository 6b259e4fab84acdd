import hashlib
import json

import numpy as np
import pytest

from sightline.files.problem import FileError
from sightline.files.weights_header import find_weights
from sightline.joining.models import CLASSES, COLUMNS, LogisticModel, fitted_models, read_models
from tests.joining.scenes import own_score_models

DIGESTS = {"detection2d": "a" * 64, "detection3d": "b" * 64}


def test_a_score_is_the_logistic_function_of_the_weighted_evidence():
    model = LogisticModel(weights=(2.0, -1.0), bias=0.5)
    expected = 1 / (1 + np.exp(-(2 * 0.25 - 3.0 + 0.5)))
    assert model.score(np.array([[0.25, 3.0]]))[0] == pytest.approx(expected)
    assert model.score(np.array([[1e9, 0.0], [-1e9, 0.0]])).tolist() == pytest.approx([1, 0])


def test_models_are_read_as_they_were_written(tmp_path):
    models = own_score_models({"sha256": DIGESTS, "seed": 1})
    models.write(tmp_path / "models.json")
    assert read_models(tmp_path / "models.json") == models


def test_models_fit_only_the_weights_that_they_were_fitted_for():
    models = own_score_models({"sha256": DIGESTS})
    assert models.fits(DIGESTS["detection2d"], DIGESTS["detection3d"])
    assert not models.fits(DIGESTS["detection3d"], DIGESTS["detection2d"])
    assert not own_score_models().fits(*DIGESTS.values())


PLAIN_FAULTS = ("", "[]", "{", '{"provenance": {}}')
FAULTS = ("cut", "nan", "columns", "other columns", "text", "too large", "no map")


@pytest.mark.parametrize("fault", PLAIN_FAULTS + FAULTS)
def test_a_damaged_file_is_refused_with_its_name_and_a_remedy(tmp_path, fault):
    path = tmp_path / "models.json"
    own_score_models().write(path)
    content = json.loads(path.read_text())
    if fault == "nan":
        content["image"]["Car"]["bias"] = float("nan")
    if fault == "columns":
        content["sweep"]["Cyclist"]["weights"].pop()
    if fault == "other columns":
        content["columns"]["sweep"].reverse()
    if fault == "text":
        content["image"]["Car"]["weights"] = "1" * len(content["image"]["Car"]["weights"])
    if fault == "too large":
        content["image"]["Car"]["bias"] = 1e308
    if fault == "no map":
        content["calibrators"]["image"]["Car"] = {}
    text = json.dumps(content)
    path.write_text({"cut": text[:-40]}.get(fault, fault if fault in PLAIN_FAULTS else text))
    with pytest.raises(
        FileError, match=r"models.json: holds no models of this version.*; name a file"
    ):
        read_models(path)


@pytest.mark.parametrize("in_image", ["detection2d-best", "detection2d-fast-cpu"])
@pytest.mark.parametrize("in_sweep", ["detection3d-best", "detection3d-fast-cpu"])
def test_models_ship_for_each_pair_of_detectors_that_ships(in_image, in_sweep):
    digests = [
        hashlib.sha256(find_weights(name).read_bytes()).hexdigest() for name in (in_image, in_sweep)
    ]
    models = fitted_models(*digests)
    assert models.provenance["weights"] == {"detection2d": in_image, "detection3d": in_sweep}
    assert fitted_models(*reversed(digests)) is None
    for kind, columns in COLUMNS.items():
        for name in CLASSES:
            model = getattr(models, kind)[name]
            assert len(model.weights) == len(columns)
            assert model.weights[0] > 0  # a surer detection is a surer object
