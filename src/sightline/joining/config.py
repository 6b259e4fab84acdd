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
    """Match boxes of both detectors to one object; off: each box is an object."""
    rescore: bool = True
    """Score boxes by the fitted models; off: by the detectors alone."""
    calibrate: bool = True
    """Calibration of the objects' scores, which keeps the order within a class."""
    mix_boxes: bool = True
    """Average matched image boxes with their projected 3D boxes."""
    sweep_in_image: bool = True
    """Use of the 3D detector's boxes in the image. Off, for late sweeps: boxes and scores in the
    image are the image detector's, and objects without its box have a tenth of their score."""
    propose: bool = True
    """Refine lifted boxes of unmatched image boxes by the second stage of 3D detection."""
    lift: bool = True
    """Give objects without a 3D box one by geometry."""
    min_iou: Share = 0.5
    """Minimum IoU of a projected box and an image box of one object. A further image box of its
    class above it repeats the object."""
    projected_share: Share = 0.75
    """Share of the projected box in the mean of both."""
    own_share: Share = 0.5
    """Share of the detector's own score in the mean with the model's."""
    sweep_share: Share = 0.5
    """Share of the 3D detector's score that counts in the image, beside the image detector; the
    model of image boxes knows the 3D detector's already."""
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
