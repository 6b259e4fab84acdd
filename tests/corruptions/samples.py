"""Samples of all kinds, including degenerate ones, and a list of all corruptions."""

from dataclasses import dataclass, replace

import torch
from hypothesis import strategies as st

from sightline.corruptions.kinds import KINDS
from sightline.corruptions.noise import CameraDeadPixels
from sightline.corruptions.occlusion import CameraOcclusion, LidarOcclusion
from sightline.corruptions.pixel_box import BoxDrawing
from sightline.corruptions.suites import SUITES
from sightline.geometry.boxes2d import Boxes2D
from sightline.geometry.boxes3d import Boxes3D
from sightline.structures.labels import ObjectLabels
from sightline.structures.sample import CameraLidarSample
from tests.data.scenes import SIZE, sample_of, seeds

ANYWHERE = BoxDrawing(placement="uniform")
CORRUPTIONS = (
    *(case.corruption for case in SUITES["dgfn7"].cases),
    *(kind.at(severity) for kind in KINDS.values() for severity in (2, 5)),
    CameraOcclusion(box=ANYWHERE),
    LidarOcclusion(box=ANYWHERE),
    CameraDeadPixels(share=(0.1, 0.7)),
)
"""Each kind that there is, and others of other settings."""


def objects_at(*boxes: tuple[float, float, float, float], name: str = "Car") -> ObjectLabels:
    """Labels that have 2D boxes alone."""
    count = len(boxes)
    return ObjectLabels(
        class_names=(name,) * count,
        boxes2d=Boxes2D(torch.tensor(boxes).double().reshape(count, 4)),
        boxes3d=Boxes3D(torch.zeros(count, 7).double()),
        truncation=torch.zeros(count).double(),
        occlusion=torch.zeros(count, dtype=torch.int64),
        alpha=torch.zeros(count).double(),
    )


LABELS = (
    None,
    objects_at(),
    objects_at((10, 20, 40, 50), name="DontCare"),
    objects_at((10, 20, 40, 50), (300, 60, 460, 140)),
    objects_at((-90, -80, -50, -20)),  # beside the image
)


@dataclass(frozen=True)
class Described:
    """Choice of a sample; built in the test, as checked code may not run in a strategy."""

    seed: int
    num_points: int
    size: tuple[int, int]
    level: int | None
    """Level of all pixels; None: blocks of colour."""
    labels: int
    """Number in LABELS."""
    lacking: tuple[str, ...]

    def sample(self) -> CameraLidarSample:
        sample = sample_of(self.seed, num_points=self.num_points)
        height, width = self.size
        image = sample.image[:, :height, :width]
        image = image if self.level is None else torch.full_like(image, self.level)
        labels = LABELS[self.labels]
        sample = replace(sample, image_size=self.size, image=image, depth=None, objects=labels)
        return replace(sample, **dict.fromkeys(self.lacking))


described = st.builds(
    Described,
    seed=seeds,
    num_points=st.sampled_from([0, 1, 300]),
    size=st.sampled_from([SIZE, (1, 1), (1, 7), (40, 3)]),
    level=st.sampled_from([None, None, 0, 255]),
    labels=st.integers(0, len(LABELS) - 1),
    lacking=st.sampled_from([(), (), (), ("image",), ("points",), ("image", "points")]),
)
"""Sound samples, and such as hardly are any."""


def same(first: CameraLidarSample, second: CameraLidarSample) -> bool:
    """Test image and sweep for equality to the last bit; None equals None."""
    return all(
        (a is None and b is None) or (a is not None and b is not None and torch.equal(a, b))
        for a, b in ((first.image, second.image), (first.points, second.points))
    )
