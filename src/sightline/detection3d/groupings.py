"""Groupings of a point network's levels by name: inputs of exported graphs."""

from collections.abc import Mapping, Sequence

from jaxtyping import Float
from torch import Tensor

from sightline.detection3d.point_layers import Grouping, SetAbstraction
from sightline.ops.group_points import group_points


def find_groupings(
    points: Float[Tensor, "batch num_points 3"], abstractions: Sequence[SetAbstraction]
) -> tuple[dict[str, Tensor], list[Tensor]]:
    """Find the groupings of successive levels by name, and each level's points, the input first."""
    found: dict[str, Tensor] = {}
    levels = [points]
    for number, abstraction in enumerate(abstractions):
        grouping = abstraction.find(levels[-1])
        found[f"centers_{number}"] = grouping.centers
        for scale, neighbours in enumerate(grouping.neighbours):
            found[f"neighbours_{number}_{scale}"] = neighbours
        levels.append(group_points(levels[-1], grouping.centers))
    return found, levels


def named_grouping(found: Mapping[str, Tensor], number: int) -> Grouping:
    """Select the grouping of a level by its number from the output of `find_groupings`."""
    start = f"neighbours_{number}_"
    names = (name for name in found if name.startswith(start))
    scales = sorted(names, key=lambda name: int(name.removeprefix(start)))  # 10 after 9
    return Grouping(found[f"centers_{number}"], tuple(found[name] for name in scales))
