"""Turns of nuScenes' clouds: z upwards, x where the camera looks."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from sightline.data.importing.frames import Rigid
from sightline.data.importing.nuscenes import Moment
from sightline.data.importing.nuscenes_files import read_frame, read_or_note_damage
from sightline.geometry.mount import mount_doubt, turn_ahead
from sightline.geometry.mount_axes import describe_upright_turn, turn_upright

_MAX_TRIED_SWEEPS: Final = 5
"""Number of sweeps of a mount in which the road is searched."""


@dataclass(frozen=True, slots=True)
class CloudTurns:
    """Turns of the clouds of all frames."""

    upright_from_old: dict[bytes, Rigid]
    """Turns by right angles of LiDARs upside down or on their side, by the bytes of the mount."""

    @classmethod
    def find(cls, moments: Sequence[Moment], max_intensity: float) -> "CloudTurns":
        """Find the turns by the tables' mounts and, where these are not upright, by the road."""
        doubtful: dict[bytes, list[Moment]] = {}
        for moment in moments:
            if mount_doubt(moment.mount) is not None:
                doubtful.setdefault(moment.mount.tobytes(), []).append(moment)
        turns = {}
        for key, alike in doubtful.items():
            read = (
                read_or_note_damage(lambda each: read_frame(each, max_intensity), moment, {})
                for moment in alike[:_MAX_TRIED_SWEEPS]
            )
            clouds = [contents.echoes for contents in read if contents is not None]
            turns[key] = turn_upright(clouds, alike[0].mount)
        return cls(turns)

    def of(self, moment: Moment) -> tuple[Rigid, float]:
        """Compute new_from_old of a frame's cloud, and the angle of its turn about the new z [deg].

        See `turn_upright` and `turn_ahead`.
        """
        upright_from_old = self.upright_from_old.get(moment.mount.tobytes(), np.eye(4))
        new_from_upright, angle_deg = turn_ahead(moment.mount @ upright_from_old.T)
        return new_from_upright @ upright_from_old, angle_deg

    def notes(self, moments: Sequence[Moment], camera: str) -> Iterator[str]:
        """Yield a line on each different turn of some frames."""
        keys = dict.fromkeys(moment.mount.tobytes() for moment in moments)
        turns = (self.upright_from_old[key] for key in keys if key in self.upright_from_old)
        yield from dict.fromkeys(line for each in turns for line in describe_upright_turn(each))
        for angle_deg in sorted({round(self.of(moment)[1]) for moment in moments} - {0}):
            yield (
                f"clouds are rotated by {-angle_deg} degrees, so that x points where {camera} looks"
            )
