"""Field of 3D detection, as the commands take it."""

from typing import Final, Literal

Around = Literal["auto", "yes", "no"]
"""Whether 3D detection searches the whole turn of the LiDAR; auto: as the data say."""
_CHOICES: Final[dict[str, bool | None]] = {"auto": None, "yes": True, "no": False}


def chosen_field(around: Around) -> bool | None:
    """Convert the choice for the jobs; None: as the samples say."""
    return _CHOICES[around]
