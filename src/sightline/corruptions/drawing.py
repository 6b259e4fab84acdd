"""Random draws of a training image's case."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from sightline.corruptions.kinds import SEVERITIES
from sightline.corruptions.suites import Case, Suite, find_suite
from sightline.geometry.arguments import plain_tuple
from sightline.geometry.choices import check_choices


@dataclass(frozen=True, kw_only=True)
class CorruptionSampler:
    """Distribution of a suite's cases for training.

    Raises:
        ValueError: There is no such suite or case, or the probabilities are negative, do not sum to
            1, are of a kind that is left out, or leave nothing to draw.
    """

    suite: str = "dgfn7"
    probabilities: Mapping[str, float] | None = None
    """Probability of each case, of sum 1; other cases are never drawn. A kind's name stands for all
    its severities, with equal probability. None: the suite's own."""
    without: tuple[str, ...] = ()
    """Kinds that are never drawn, for tests on unseen kinds; their probability is shared by the
    others."""
    per: Literal["image", "update"] = "image"
    """Whether each image has its own case, or all images of one weight update share one, as in Kim
    et al. 2018, section IV-A. The random draws within a case are always separate for each image."""

    def __post_init__(self) -> None:
        """Check choices, names and probabilities."""
        check_choices(self)
        object.__setattr__(self, "without", plain_tuple("without", self.without))
        suite = find_suite(self.suite)
        suite.without(self.without)
        if self.probabilities is not None:
            _check_drawn(suite, self.probabilities, self.without)
            shares = self.probabilities.values()
            # NaN fails the comparison, too.
            if not (min(shares, default=0) >= 0 and abs(sum(shares) - 1) <= 1e-6):
                raise ValueError(
                    "the probabilities of the cases must be at least 0 and sum to 1, got "
                    f"{dict(self.probabilities)}"
                )
        if not sum(_probabilities(suite, self.probabilities, self.without)):
            without = f" without {', '.join(self.without)}" if self.without else ""
            raise ValueError(
                f"no case is left to draw{without}; set other probabilities, or exclude fewer kinds"
            )

    def draw(self, rng: np.random.Generator, num_images: int = 1) -> tuple[Case, ...]:
        """Draw cases for the images of one weight update, in order.

        Args:
            rng: Source of randomness. With `per` "update", all workers and devices that prepare
                images of one update must pass generators of equal state.
            num_images: Number of images.
        """
        suite = find_suite(self.suite)
        shares = _probabilities(suite, self.probabilities, self.without)
        size = 1 if self.per == "update" else num_images
        drawn = [suite.cases[index] for index in rng.choice(len(shares), size=size, p=shares)]
        return tuple(drawn * num_images if self.per == "update" else drawn)


def _check_drawn(
    suite: Suite, probabilities: Mapping[str, float], without: Collection[str]
) -> None:
    """Refuse cases that the suite does not have, or a probability of one that is never drawn."""
    suite.select(probabilities)
    for name, share in probabilities.items():
        kinds = {case.kind for case in suite.select([name])}
        if share and kinds & set(without):
            raise ValueError(
                f"{name} has the probability {share:g}, and `without` leaves it out; leave it out "
                "of one of them"
            )


def _probabilities(
    suite: Suite, given: Mapping[str, float] | None, without: tuple[str, ...]
) -> list[float]:
    """Compute each case's probability, of sum 1 within numpy's tolerance; or all 0."""
    if given is None:
        given = {case.name: case.probability for case in suite.cases}
    drawn = set(suite.without(without))
    shares = [_share(case, given) if case in drawn else 0.0 for case in suite.cases]
    total = sum(shares)
    return [share / total for share in shares] if total else shares


def _share(case: Case, given: Mapping[str, float]) -> float:
    share = float(given.get(case.name, 0))
    if case.severity is not None:
        share += float(given.get(case.kind, 0)) / len(SEVERITIES)
    return share
