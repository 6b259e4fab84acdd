from dataclasses import asdict

import numpy as np
import pytest
import torch

from sightline.augmentation.faults import (
    FalseEchoes,
    Fault,
    FewerRings,
    NoCamera,
    TurnedLidar,
    draw_turned_lidar,
    fault_rng,
)
from sightline.augmentation.sample_changes import (
    add_outliers,
    drop_camera,
    rotate_extrinsics,
    thin_rings,
)
from sightline.data.datasets.kitti_object import KittiObjectDataset
from sightline.simulation.packaged import PACKAGED_FRAMES
from tests.data.scenes import sample_of

FAULTS = (
    TurnedLidar(yaw_deg=0.5, roll_deg=-1.0),
    FalseEchoes(share=0.05),
    FewerRings(keep_every=4, first=1),
    NoCamera(),
)


@pytest.fixture(scope="module")
def frame():
    return KittiObjectDataset(PACKAGED_FRAMES)[0]


@pytest.mark.parametrize(
    ("fault", "change"),
    list(
        zip(
            FAULTS,
            [
                lambda sample: rotate_extrinsics(sample, yaw_deg=0.5, roll_deg=-1.0),
                lambda sample: add_outliers(sample, share=0.05, rng=np.random.default_rng(3)),
                lambda sample: thin_rings(sample, 4, 1),
                drop_camera,
            ],
            strict=True,
        )
    ),
)
def test_a_fault_changes_a_sample_as_its_function_does(frame, fault, change):
    found, expected = fault(frame, np.random.default_rng(3)), change(frame)
    assert (found.image is None) == (expected.image is None)
    assert torch.equal(found.points, expected.points)
    assert found.objects is frame.objects


def test_faults_have_names_of_their_own_and_can_be_recorded():
    assert [str(fault) for fault in FAULTS] == [
        "yaw 0.5 deg, roll -1 deg",
        "5 % outliers",
        "1 ring of 4",
        "no camera",
    ]
    assert str(TurnedLidar()) == "yaw 0 deg"
    assert asdict(FAULTS[1]) == {"share": 0.05}
    assert all(isinstance(fault, Fault) for fault in FAULTS)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: FalseEchoes(share=1.5), "share must be between 0 and 1, got 1.5"),
        (lambda: FewerRings(keep_every=2, first=2), "below keep_every 2, got 2"),
        (lambda: TurnedLidar(yaw_deg=float("nan")), "finite angles"),
    ],
)
def test_a_fault_that_cannot_be_is_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_a_sample_meets_the_same_fault_every_time_and_another_sample_another():
    first, again, other = (sample_of(seed) for seed in (1, 1, 2))
    echoes = FalseEchoes(share=0.5)
    found = [echoes(sample, fault_rng(sample)).points for sample in (first, again)]
    assert torch.equal(*found)
    assert fault_rng(first).random() != fault_rng(other).random()
    assert fault_rng(first).random() != fault_rng(first, seed=1).random()


def test_errors_of_the_mount_are_drawn_as_wide_as_asked_for():
    rng = np.random.default_rng(0)
    drawn = [draw_turned_lidar(0.2, rng) for _ in range(2000)]
    angles = np.array([[each.yaw_deg, each.pitch_deg, each.roll_deg] for each in drawn])
    np.testing.assert_allclose(angles.std(axis=0), [0.2, 0.1, 0.1], rtol=0.1)
    np.testing.assert_allclose(angles.mean(axis=0), 0, atol=0.02)
