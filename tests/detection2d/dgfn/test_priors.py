import tarfile
from pathlib import Path

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.data.formats.kitti_labels import parse_objects
from sightline.detection2d.config import CLASSES, DgfnConfig
from sightline.detection2d.dgfn.network import (
    corners_of,
    decode_boxes,
    encode_boxes,
    make_priors,
    prior_shapes,
)
from sightline.evaluation.kitti_object_rules import NEVER, truth_levels
from sightline.geometry.boxes2d import Boxes2D, pairwise_iou2d
from tests.reference import ssd as reference

CONFIG = DgfnConfig()
SHAPES = prior_shapes(CONFIG.prior_sizes_px, CONFIG.prior_ratios)
PAPER_MAPS = ((47, 156), (24, 78), (12, 39), (6, 20), (4, 18), (2, 16))
PAPER_SIZE = (375, 1242)


def priors(maps, image_size):
    return torch.cat(
        [
            make_priors(shapes, *size, image_size, torch.zeros(1))
            for shapes, size in zip(SHAPES, maps, strict=True)
        ]
    )


def test_the_papers_maps_have_44504_priors():
    assert [len(shapes) for shapes in SHAPES] == [4, 6, 6, 6, 4, 4]
    assert priors(PAPER_MAPS, PAPER_SIZE).shape == (44504, 4)


@given(
    maps=st.lists(st.tuples(st.integers(1, 4), st.integers(1, 5)), min_size=6, max_size=6),
    image_size=st.tuples(st.integers(20, 400), st.integers(20, 900)),
)
def test_priors_are_those_of_plain_loops(maps, image_size):
    expected = reference.priors(CONFIG.prior_sizes_px, CONFIG.prior_ratios, maps, image_size)
    torch.testing.assert_close(
        corners_of(priors(maps, image_size)), torch.tensor(expected).float(), rtol=0, atol=1e-3
    )


boxes = st.tuples(*[st.floats(-50, 300)] * 2, *[st.floats(1, 400)] * 2)


@given(box=boxes, prior=boxes)
def test_a_box_is_had_back_from_its_offsets_which_are_the_papers(box, prior):
    truth = torch.tensor([[box[0], box[1], box[0] + box[2], box[1] + box[3]]])
    place = torch.tensor([prior])
    offsets = encode_boxes(truth, place)
    corners = corners_of(place)[0].tolist()
    torch.testing.assert_close(
        offsets, torch.tensor([reference.encode(truth[0].tolist(), corners)]), rtol=1e-3, atol=1e-2
    )
    torch.testing.assert_close(decode_boxes(offsets[None], place)[0], truth, rtol=1e-4, atol=1e-2)


def test_what_an_untrained_network_says_stays_finite():
    place = torch.tensor([[10.0, 10.0, 30.0, 30.0]])
    assert decode_boxes(torch.full((1, 1, 4), 1e6), place).isfinite().all()


def test_nearly_all_objects_that_kitti_evaluates_have_a_prior(kitti_root):
    archive = kitti_root / "labels_and_calib_7481.tar.gz"
    if not archive.is_file():
        pytest.skip("SIGHTLINE_KITTI has no archive of all labels")
    found = dict.fromkeys(CLASSES, 0)
    total = dict.fromkeys(CLASSES, 0)
    corners = Boxes2D(corners_of(priors(PAPER_MAPS, PAPER_SIZE)))
    with tarfile.open(archive) as files:
        for member in files:
            path = Path(member.name)
            if path.suffix != ".txt" or path.parent.name != "label_2" or int(path.stem) % 15:
                continue
            objects = parse_objects(files.extractfile(member).read(), path, with_scores=False)
            truth = Boxes2D(torch.tensor(objects.boxes2d, dtype=torch.float32))
            best = pairwise_iou2d(truth, corners).amax(dim=1)
            levels = truth_levels(objects.truncation, objects.occlusion, objects.boxes2d)
            for name, iou, level in zip(objects.class_names, best.tolist(), levels, strict=True):
                if name in CLASSES and level < NEVER:
                    total[name] += 1
                    found[name] += iou >= 0.5
    shares = {name: found[name] / total[name] for name in CLASSES}
    assert total["Car"] > 1000
    assert shares["Car"] >= 0.99
    assert shares["Pedestrian"] >= 0.89
    assert shares["Cyclist"] >= 0.97
