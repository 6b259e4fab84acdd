"""Import of a bag: pairs images and sweeps by time, and writes a recording."""

import hashlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from decimal import Decimal
from functools import partial
from importlib.metadata import version
from itertools import compress
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float32, Int64

from sightline.data.checks.frame_checks import is_blank
from sightline.data.checks.lidar_mount import describe_rotation
from sightline.data.formats.image_file import write_rgb
from sightline.data.formats.recording_calibration import (
    RecordingCalibration,
    read_recording_calibration,
    recording_calibration_text,
)
from sightline.data.importing.bag import COMPRESSED_IMAGE, Bag, Message, open_bag
from sightline.data.importing.bag_calibration import (
    calibration_of_bag,
    doubt_about_level,
    require_fitting_tilt,
    with_plausible_tilt,
)
from sightline.data.importing.bag_clocks import Clock
from sightline.data.importing.bag_files import (
    bag_changed_at,
    describe_unread_files,
    size_of_bag,
    warn_of_other_parts,
)
from sightline.data.importing.bag_messages import (
    cloud_from_message,
    image_file_from_message,
    image_from_message,
    num_unread,
)
from sightline.data.importing.bag_pairs import Pairs, pair_messages
from sightline.data.importing.bag_sectors import describe_parts_of_turns
from sightline.data.importing.bag_topics import ChosenTopics, choose_topics, describe_info
from sightline.data.importing.frames import Rigid
from sightline.data.importing.writer import (
    MAX_BRIGHT_SHARE,
    RESULTS,
    STRAIGHT_NOTE,
    CloudTally,
    ImportReport,
    check_not_into_source,
    collected_warnings,
    count_echoes,
    describe_newer_sources,
    describe_view,
    moved_cloud,
    names_present,
    remove_incomplete,
    source_calibration,
    staged_doubt,
    staging_folder,
    turned_calibration,
    unusable_error,
    write_calibration,
    write_cloud,
    write_or_keep_calibration,
    write_or_keep_times,
)
from sightline.data.layouts.recording_files import IMAGES, POINTS
from sightline.files.atomic import atomic_write_bytes
from sightline.files.plain_text import shortened
from sightline.files.problem import Problem
from sightline.geometry.cloud_checks import cloud_fault
from sightline.geometry.echoes import echoes
from sightline.geometry.mount import mount_doubt, turn_ahead
from sightline.geometry.mount_axes import describe_upright_turn, turn_upright
from sightline.jobs.output_dirs import acquire_output_dir, data_name
from sightline.jobs.progress import track

_CALIBRATION_REMEDY: Final = (
    "correct the calibration file, or give one by --calibration (docs/recordings.md has an example)"
)
_Cloud = Float32[np.ndarray, "_num_points 4"]
_INTENSITIES: Final = (1.0, 255.0, 1023.0, 4095.0, 65535.0)
"""Usual intensities of a reflectance of 1: shares, and whole numbers of 8, 10, 12 and 16 bits."""
_MIN_SHARE: Final = 0.03
"""Smallest median of measured reflectances; lower ones may be fractions of another scale."""
_NUM_TRIED_SWEEPS: Final = 5
"""Number of sweeps for guessing the scale of intensities and the direction of up."""
_MAX_TRIED_FRAMES: Final = 5
"""Number of frames tried at the start of a drive: if none is readable, nothing is written."""


def import_bag(
    source: Path,
    out: Path,
    *,
    camera_topic: str | None,
    lidar_topic: str | None,
    info_topic: str | None,
    calibration: Path | None,
    max_gap_s: float,
    clock: Clock,
    undistort: bool,
    max_intensity: float | None,
) -> ImportReport:
    """Import a drive; arguments and errors as in `import_recording`."""
    check_not_into_source(source, out)
    if source.is_file():
        warn_of_other_parts(source)
    notes = [*describe_unread_files(source)]
    with open_bag(source) as bag, collected_warnings(notes):
        topics = choose_topics(bag, camera_topic, lidar_topic, info_topic)
        if calibration is not None:
            given = source_calibration(read_recording_calibration(calibration))
        else:
            given, calibration_notes = calibration_of_bag(bag, topics, undistort=undistort)
            notes += (*calibration_notes, *(describe_info(topics) if info_topic is None else ()))
            notes += topics.rectified_note()
        if undistort and given.lens is None:
            notes.append(STRAIGHT_NOTE)
        pairs = pair_messages(
            bag, topics, max_gap_s, clock, keep_other_frames=calibration is not None
        )
        notes += describe_parts_of_turns(bag, topics.lidar.name)
        read = (topics.camera.name, topics.lidar.name)
        notes += (*bag.kind_notes(read), *bag.publisher_notes(read), *bag.copy_notes(read))
        notes += bag.count_notes(bag.num_read)
        intensity = max_intensity or given.max_intensity
        is_guessed = max_intensity is None and intensity == 1
        mount = given.matrices.camera_from_lidar
        is_needed = is_guessed or mount_doubt(mount) is not None
        clouds = _some_clouds(bag, topics, pairs) if is_needed else []
        if is_guessed:
            intensity = _guess_intensity(clouds)
        upright_from_old = turn_upright(clouds, mount)
        new_from_upright, angle_deg = turn_ahead(mount @ upright_from_old.T)
        new_from_old = new_from_upright @ upright_from_old
        turn = new_from_old[:3, :3]
        written = replace(
            turned_calibration(given, new_from_old),
            max_intensity=1.0,
            clouds_from_source=None if (turn == np.eye(3)).all() else turn,
        )
        if calibration is None:
            written = with_plausible_tilt(written)
        else:
            require_fitting_tilt(written, calibration)
        settings = {
            "sightline": version("sightline"),
            "source": data_name(source),
            "source_bytes": size_of_bag(source),  # of a replaced bag, or one with further files
            "times_s": _digest(pairs.times_s),
            "camera_topic": topics.camera.name,
            "lidar_topic": topics.lidar.name,
            "max_gap_s": max_gap_s,
            "clock": clock,
            "max_intensity": intensity,
            # Without the rotation, which earlier versions did not write.
            "calibration": recording_calibration_text(replace(written, clouds_from_source=None)),
        }
        names = [f"{number:06}" for number in range(len(pairs.positions))]
        frames = _Frames(out, topics, written, intensity, is_guessed, new_from_old)
        tried = dict.fromkeys((*range(len(names))[:_MAX_TRIED_FRAMES], *_spread(len(names))))
        frames.try_first(bag, {names[each]: pairs.positions[each] for each in tried}, source)
        acquire_output_dir(out, settings, results=RESULTS)
        notes += write_or_keep_calibration(out, written, names)
        times = dict(zip(names, pairs.times_s, strict=True))
        # before the frames: `check` tells an import that was stopped
        notes += write_or_keep_times(out, times)
        present = names_present(out, IMAGES, POINTS)
        pending = [number for number, name in enumerate(names) if name not in present]
        kept = present.intersection(names)
        notes += describe_newer_sources(out, dict.fromkeys(kept, bag_changed_at(source)))
        frames.write(bag, {names[number]: pairs.positions[number] for number in pending})
        if frames.faults:
            write_or_keep_times(out, times, left_out=frames.faults)
    return ImportReport(
        out=out,
        written=len(pending) - len(frames.faults),
        skipped=len(names) - len(pending),
        notes=(
            f"camera {topics.camera}, LiDAR {topics.lidar}, calibration "
            f"{calibration or topics.info}; intensities of 0 to {intensity:g}",
            *pairs.notes,
            *notes,
            *frames.notes(),
            *describe_upright_turn(upright_from_old),
            *describe_rotation(angle_deg, "clouds are written"),
            *describe_view(out),
            *(doubt_about_level(given.lidar_tilt, out) if calibration is None else ()),
        ),
    )


@dataclass(slots=True)
class _Frames:
    """Writer of images and clouds in the order of the bag."""

    out: Path
    topics: ChosenTopics
    calibration: RecordingCalibration
    max_intensity: float
    is_guessed: bool
    """True if `max_intensity` was guessed from some sweeps, false if the user gave it."""
    new_from_old: Rigid
    faults: dict[str, ValueError] = field(default_factory=dict)
    """Errors of the left-out frames, by name."""
    doubts: dict[str, Problem] = field(default_factory=dict)
    """Doubts of the frames before the first plausible one, by name."""
    clouds: CloudTally = field(default_factory=CloudTally)
    blank: dict[str, bool] = field(default_factory=dict)
    """Whether pictures have a single colour, by name."""
    unread: dict[str, list[int]] = field(default_factory=dict)
    """Numbers of points or rows beyond the sizes of messages with such, by topic."""

    def try_first(
        self, bag: Bag, positions: dict[str, Int64[np.ndarray, "2"]], source: Path
    ) -> None:
        """Check frames up to the first plausible one with points before any is written.

        Args:
            bag: The bag.
            positions: Numbers of images and sweeps, of the first frames and some others.
            source: The bag's path.

        Raises:
            ValueError: None of the first frames can be read, all that can are doubtful, or the
                calibration is.
        """
        fault: ValueError | None = None
        num_empty = 0
        for number, (name, position) in enumerate(positions.items()):
            if number == _MAX_TRIED_FRAMES and not num_empty and not self.doubts:
                break  # none can be read
            with staging_folder() as staged:
                trial = replace(self, out=staged, faults={}, blank={}, unread={})
                trial.write(bag, {name: position})
                if trial.faults:
                    fault = fault or trial.faults[name]
                    continue
                write_calibration(staged, self.calibration)
                doubt = staged_doubt(staged, source, calibration_remedy=_CALIBRATION_REMEDY)
                if doubt is not None and doubt.remedy == _CALIBRATION_REMEDY:
                    raise unusable_error(doubt)  # other frames have the same calibration
                if doubt is not None:
                    self.doubts[name] = doubt
                elif (staged / POINTS / f"{name}.bin").stat().st_size:
                    return
                else:
                    num_empty += 1
        if self.doubts:
            raise unusable_error(next(iter(self.doubts.values())))
        if fault is not None and not num_empty:
            raise fault

    def write(self, bag: Bag, positions: dict[str, Int64[np.ndarray, "2"]]) -> None:
        """Write frames by name from the messages of the given numbers.

        Frames with an unreadable image or cloud are left out and noted in `faults`.
        """
        camera, lidar = self.topics.camera.name, self.topics.lidar.name
        names: dict[tuple[str, int], str] = {}
        for name, (image, sweep) in positions.items():
            names[camera, int(image)] = name
            names[lidar, int(sweep)] = name
        if not names:
            return
        messages = bag.messages({camera, lidar}, selected=names)
        for message in track(messages, description="importing", total=len(names)):
            name = names.pop((message.topic, message.number))
            read = self._image if message.topic == camera else self._cloud
            try:
                write_file = read(name, message)
            except ValueError as error:
                self.faults.setdefault(name, error)
            else:
                write_file()
            if not names:
                break
        remove_incomplete(self.out, self.faults)

    def notes(self) -> tuple[str, ...]:
        """Return lines on left-out points and frames, with counts."""
        lines = (
            *self.clouds.lines(self.max_intensity),
            *(
                f"warning: frame {name} {doubt.problem}; {doubt.remedy}"
                for name, doubt in self.doubts.items()
            ),
            *self._blank_note(),
            *self._unread_notes(),
        )
        if not self.faults:
            return lines
        first = next(iter(self.faults.values()))
        return (
            *lines,
            f"warning: dropped {len(self.faults)} unreadable frames; the first: {first}",
        )

    def _blank_note(self) -> tuple[str, ...]:
        kept = {name: is_blank for name, is_blank in self.blank.items() if name not in self.faults}
        blank = [name for name, is_blank in kept.items() if is_blank]
        if not blank:
            return ()
        return (
            f"warning: {len(blank)} of {len(kept)} images have a single colour, e.g. that of frame "
            f"{blank[0]}; check whether the camera delivered images",
        )

    def _count_unread(self, message: Message) -> None:
        if number := num_unread(message.content):
            self.unread.setdefault(message.topic, []).append(number)

    def _unread_notes(self) -> Iterator[str]:
        for topic, numbers in self.unread.items():
            items = "rows" if topic == self.topics.camera.name else "points"
            yield (
                f"warning: {len(numbers)} messages of {shortened(topic)} hold {sum(numbers)} "
                f"{items} more than their width and height declare: these are left out; correct "
                "width and height where they are published, if they belong to the sensor's data"
            )

    def _image(self, name: str, message: Message) -> Callable[[], None]:
        """Read an image; return a function that writes it."""
        topic = self.topics.camera
        if topic.kind == COMPRESSED_IMAGE:
            file = image_file_from_message(message.content, topic.name)
            self._check_size(file.size, message)
            self.blank[name] = file.is_blank
            path = self.out / IMAGES / f"{name}{file.suffix}"
            return partial(atomic_write_bytes, path, file.content)
        image = image_from_message(message.content, topic.name)
        self._count_unread(message)
        self._check_size((image.shape[0], image.shape[1]), message)
        self.blank[name] = is_blank(image)
        return partial(write_rgb, self.out / IMAGES / f"{name}.png", image)

    def _check_size(self, size: tuple[int, int], message: Message) -> None:
        expected = self.calibration.image_size
        if expected is not None and size != expected:
            raise ValueError(
                f"topic {shortened(message.topic)}: image {message.number} is {size[0]}x{size[1]} "
                f"(height x width), but its calibration is for {expected[0]}x{expected[1]}; choose "
                "the calibrated topic, or give a calibration by --calibration"
            )

    def _cloud(self, name: str, message: Message) -> Callable[[], None]:
        """Read a cloud; return a function that writes it."""
        source = f"topic {shortened(message.topic)}"
        read = cloud_from_message(message.content, message.topic)
        self._count_unread(message)
        # a later sweep may exceed any scale guessed from whole numbers
        is_open = self.is_guessed and self.max_intensity > 1
        points, tally = count_echoes(
            name,
            read,
            self.max_intensity,
            source,
            max_bright_share=1.0 if is_open else MAX_BRIGHT_SHARE,
        )
        self.clouds += tally
        return partial(write_cloud, self.out, name, moved_cloud(points, self.new_from_old))


def _digest(times_s: Sequence[float | Decimal]) -> str:
    """Describe times in words that differ where one of them does."""
    text = " ".join(map(str, times_s))
    digest = hashlib.sha256(text.encode()).hexdigest()[:12]
    return f"{len(times_s)} from {times_s[0]:.6f} to {times_s[-1]:.6f} ({digest})"


def _some_clouds(bag: Bag, topics: ChosenTopics, pairs: Pairs) -> list[_Cloud]:
    """Read some readable sweeps of the drive: the first may be empty, or of a garage."""
    lidar = topics.lidar.name
    chosen = _spread(len(pairs.positions))
    selected = {(lidar, int(number)) for number in pairs.positions[chosen, 1]}
    clouds = []
    for message in bag.messages([lidar], selected=selected):
        with suppress(ValueError):  # reported when frames are written
            clouds.append(echoes(cloud_from_message(message.content, lidar)))
    return clouds


def _spread(count: int) -> list[int]:
    """Numbers of some frames of a drive, evenly spread."""
    return [round(each) for each in np.linspace(0, count - 1, _NUM_TRIED_SWEEPS).tolist()]


def _guess_intensity(clouds: Sequence[_Cloud]) -> float:
    """Guess the smallest usual scale on which most of the sweeps valid on the largest are valid.

    The scale of 1 must suit all of them, as dark sweeps of other scales are valid on it, or most
    of them are shares.
    """
    filled = [each for each in clouds if each[:, 3].any()]
    readable = [each for each in filled if cloud_fault(each, _INTENSITIES[-1]) is None]
    num_valid = [
        sum(cloud_fault(each, scale) is None for each in readable) for scale in _INTENSITIES
    ]
    if num_valid[0] == len(readable) or 2 * sum(map(_holds_shares, readable)) > len(readable):
        return _INTENSITIES[0]
    is_usual = (2 * each > len(readable) for each in num_valid[1:])
    return next(compress(_INTENSITIES[1:], is_usual))


def _holds_shares(points: _Cloud) -> bool:
    """Check for fractions of 1, apart from zeros and retroreflectors."""
    intensities = points[:, 3][points[:, 3] > 0]
    return bool(
        len(intensities)
        and (points[:, 3] > 1).mean() <= MAX_BRIGHT_SHARE
        and _MIN_SHARE < np.median(intensities) < 1  # whole numbers are not below 1
    )
