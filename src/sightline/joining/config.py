"""Stages of joining and their limits."""

from dataclasses import dataclass
from typing import Annotated

from sightline.geometry.ranges import Within, check_ranges

Share = Annotated[float, Within(0, 1)]
"""Number from 0 to 1."""


@dataclass(frozen=True, kw_only=True, slots=True)
class JoinConfig:
    """Stages of joining; each can be switched off."""

    associate: bool = True
    """Whether boxes of both detectors become one object; off: each box is an object."""
    rescore: bool = True
    """Whether the models give scores; off: the detectors' own."""
    calibrate: bool = True
    """Calibration of the objects' scores, which keeps the order within a class."""
    mix_boxes: bool = True
    """Whether matched image boxes take the shape of the projected 3D box."""
    sweep_in_image: bool = True
    """Use of the 3D detector's boxes in the image. Off, for late sweeps: boxes and scores in the
    image are the image detector's, and objects without its box have a tenth of their score."""
    propose: bool = True
    """Whether the 3D detector's second stage refines lifted boxes that no 3D box explains."""
    lift: bool = True
    """Whether objects without a 3D box get one by geometry."""
    min_iou: Share = 0.5
    """Minimum IoU of a projected box and an image box of one object. A further image box of its
    class above it repeats the object."""
    projected_share: Share = 0.75
    """Share of the projected box in the mean of both."""
    own_share: Share = 0.5
    """Share of the detector's own score in the mean with the model's."""
    min_lifted_score: Share = 0.1
    """Score of an image box from which it is lifted; each takes some 3 ms."""
    min_proposed_score: Share = 0.2
    """Score of an image box, by the models, from which its lifted box is proposed."""
    proposed_score_share: Share = 0.7
    """Share of this score that the second stage gets: lifted boxes are seldom right as they are."""
    min_proposed_returns: Annotated[int, Within(0)] = 10
    """Number of returns in a refined box from which it counts; with fewer, geometry places it."""
    max_iou_from_above: Share = 0.1
    """IoU from above beyond which the less sure of a refined box and another of its class is left
    out."""
    max_iou: Share = 0.6
    """IoU above which an object with an image box alone repeats a surer one of its kind."""

    def __post_init__(self) -> None:
        """Check the ranges."""
        check_ranges(self)
