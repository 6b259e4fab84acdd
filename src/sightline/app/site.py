"""The page as a folder of plain files, with answers computed beforehand (`serve --export`)."""

import asyncio
import hashlib
import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any, Final, get_args

from sightline.app.answers import Answers
from sightline.app.breaking import reproducing_commands
from sightline.app.parts import Answer, PartMaker, PartName, Task
from sightline.app.setup import page_setup
from sightline.app.site_folder import SiteFolder
from sightline.app.state import PRESETS, Breakage, FaultChoice, PageState
from sightline.app.timeline import health_along
from sightline.app.workers import Workers
from sightline.corruptions.kinds import SEVERITIES, find_kind
from sightline.data.datasets.sample_dataset import SampleDataset
from sightline.data.datasets.sample_files import dataset_title
from sightline.data.layouts.kitti_trees import Part, Velodyne
from sightline.data.open import open_dataset
from sightline.export.choice import choose_engine
from sightline.export.names import EngineChoice
from sightline.jobs.output_dirs import check_outside_dataset
from sightline.jobs.progress import ProgressLines
from sightline.jobs.run import check_workers
from sightline.simulation.packaged import PACKAGED_FRAMES
from sightline.structures.sample import digest_sample

FIRST_FRAMES: Final = 2
"""Number of frames that are exported if none are named."""

_FIRST_LINE_S: Final = 10.0
_MEGABYTE: Final = 1e6
_OTHERS_BYTES: Final = 90_000
"""Approximate size of a state's boxes, gates and health."""
_DEPTH_SHARE: Final = 0.6
"""Approximate size of a state's depth pictures beside that of the image."""
_POLICY: Final = "default-src 'self'; base-uri 'none'; form-action 'none'"
_SUFFIXES: Final = {"points": ".bin"}


@dataclass(frozen=True, kw_only=True, slots=True)
class SiteContent:
    """Content of an exported page."""

    states: int
    frames: int
    num_bytes: int

    def __str__(self) -> str:
        """Format for the user."""
        size = f"{self.num_bytes / _MEGABYTE:.1f} MB"
        return f"{self.states} states of {self.frames} frames, {size}"


def export_page(
    data: Path | None,
    site: Path,
    *,
    frames: Sequence[str] | None,
    kinds: Sequence[str],
    severities: Sequence[int] | None,
    workers: int,
    velodyne: Velodyne | None,
    engine: EngineChoice,
    announce: Callable[[str], None],
) -> SiteContent:
    """Compute the page's answers to some states, and write them with the page to a folder.

    The states of each frame are sound sensors, the page's buttons, and each kind at each severity
    with seed 0, with the fast weights. The folder appears under its name when it is whole; an
    interrupted export goes on when it is run again. The same call writes the same bytes.

    Args:
        data: Folder of the data set; None: the packaged frames.
        site: The folder; an older export there is replaced.
        frames: Names of the frames; the limits of health are theirs alone if others cannot be
            opened. None: the first `FIRST_FRAMES`.
        kinds: Kinds of fault.
        severities: Severities of the kinds; None: all.
        workers: Number of worker processes.
        velodyne: The sweeps' folder in an object tree. None: velodyne, or else velodyne_reduced.
        engine: Engine of the networks.
        announce: Called with an estimate before the work.

    Raises:
        ValueError: The data cannot be used, there is no such frame or kind, or the folder is not an
            export's or cannot be written.
    """
    check_workers(workers)
    if severities and not kinds:
        raise ValueError("--severities are those of --kinds; name kinds, or leave them out")
    folder = data or PACKAGED_FRAMES
    check_outside_dataset(folder, [site])
    whole = _whole_data(folder, velodyne, frames)
    named = frames if whole is None else frames or whole.sample_ids[:FIRST_FRAMES]
    dataset = _opened(folder, velodyne, named)
    states = chosen_states(dataset.sample_ids, kinds, severities or SEVERITIES)
    maker = PartMaker(dataset, folder, engine, whole=whole)
    settings = {
        "made_by": SiteFolder.made_by,
        "code": _code_digest(),
        "engine": choose_engine(engine),
        "data": dataset_title(dataset, folder),
    }
    with SiteFolder(site, settings) as aside:
        writer = _Writer(aside, dataset, states, data, maker)
        missing = [state for state in states if not writer.is_done(state)]
        size = _estimate(maker, states) / _MEGABYTE
        announce(
            f"{site}: {len(states)} states of {len(dataset)} frames, about {size:.0f} MB; "
            f"{len(missing)} are to be computed"
        )
        asyncio.run(_write(writer, maker, missing, workers))
        num_bytes = aside.finish(writer.expected)
    return SiteContent(states=len(states), frames=len(dataset), num_bytes=num_bytes)


def chosen_states(
    frames: Sequence[str], kinds: Sequence[str], severities: Sequence[int]
) -> list[PageState]:
    """List the states of each frame: the page's buttons, then each kind at each severity.

    Raises:
        ValueError: There is no such kind or severity.
    """
    faults = [
        Breakage("", (FaultChoice(find_kind(kind).name, severity, 0),))
        for kind in kinds
        for severity in sorted(severities)
    ]
    broken = dict.fromkeys([*PRESETS.values(), *faults])
    return [PageState(broken=each._replace(frame=frame)) for frame in frames for each in broken]


def _opened(
    folder: Path, velodyne: Velodyne | None, frames: Sequence[str] | None = None
) -> SampleDataset:
    parts: tuple[Part, ...] = ("image", "points", "objects")
    dataset = open_dataset(folder, sample_list=frames, velodyne=velodyne, parts=parts, needs=())
    if not len(dataset):
        raise ValueError(f"{folder} has no frames; give a folder of a data set with some")
    return dataset


def _whole_data(
    folder: Path, velodyne: Velodyne | None, frames: Sequence[str] | None
) -> SampleDataset | None:
    """Open all frames; None: they cannot be opened, perhaps for others than the named ones.

    Raises:
        ValueError: None are named, and the data cannot be used.
    """
    try:
        return _opened(folder, velodyne)
    except ValueError:
        if not frames:
            raise
        return None


def _estimate(maker: PartMaker, states: Sequence[PageState]) -> float:
    """Estimate the size of all files, by the first frame [bytes]."""
    scene = maker.make(Task(part="scene", state=states[0]))
    image, points = len(scene.files["image"]), len(scene.files["points"])
    size = 0.0
    for state in states:
        sensors = {
            sensor
            for fault in state.broken.faults
            for sensor in find_kind(fault.kind).at(fault.severity).sensors
        }
        is_turned = state.broken.yaw_deg != 0
        is_sound = not sensors and not is_turned
        size += image * (is_sound or "camera" in sensors)
        size += points * (is_sound or is_turned or "lidar" in sensors)
        size += image * _DEPTH_SHARE + _OTHERS_BYTES
    return size


class _Writer:
    """Writer of the files of an exported page."""

    def __init__(
        self,
        aside: SiteFolder,
        dataset: SampleDataset,
        states: Sequence[PageState],
        data: Path | None,
        maker: PartMaker,
    ) -> None:
        self._aside, self._dataset, self._states = aside, dataset, states
        self._engine = maker.engine
        self._name = Path((data or PACKAGED_FRAMES).resolve().name)
        self._is_packaged = data is None
        limits = f"{maker.limits.camera}, {maker.limits.lidar}"
        self._contents = {
            name: f"{_content_of(dataset, index)} {limits}"
            for index, name in enumerate(dataset.sample_ids)
        }
        self.expected: set[str] = set()
        """Paths of all files of the page."""

    def is_done(self, state: PageState) -> bool:
        """Test whether all files of a state exist, some from an interrupted or older export."""
        place = self._place(state)
        content = self._aside.read(place)
        if content is None:
            return False
        try:
            named = list(map(str, json.loads(content)["files"].values()))
        except (ValueError, LookupError, TypeError, AttributeError, RecursionError):
            return False  # a damaged file of an older export
        if not all(map(self._aside.has, named)):
            return False
        self.expected |= {place, *named}
        return True

    def write_state(self, state: PageState, answers: dict[PartName, Answer]) -> None:
        """Write all parts of a state, pictures first."""
        named: dict[str, str] = {}
        for answer in answers.values():
            for name, content in answer.files.items():
                suffix = _SUFFIXES.get(name, ".jpg")
                named[name] = f"files/{_digest(content)}{suffix}"
                self._write(named[name], content)
        commands = reproducing_commands(state, self._name, self._dataset, self._engine)
        source = "the folder that `sightline demo` prints" if self._is_packaged else "the data"
        parts = [
            {"part": name, **answer.content, "files": sorted(answer.files)}
            for name, answer in answers.items()
            if name != "scene"
        ]
        state_json = {
            "scene": answers["scene"].content,
            "parts": parts,
            "commands": f"# {self._name}: {source}\n{commands}",
            "files": named,
        }
        self._write(self._place(state), _json(state_json))

    def write_page(self, timelines: dict[str, Any]) -> None:
        """Write what belongs to no state: the page itself and what it offers."""
        title = "packaged frames" if self._is_packaged else self._name.name
        setup = page_setup(title, self._dataset.sample_ids)
        setup["states"] = {_key(state): self._place(state) for state in self._states}
        setup["yaws"] = sorted({state.broken.yaw_deg for state in self._states})
        setup["tasks"] = {task: [chosen] for task, chosen in self._states[0].weights}
        self._write("setup.json", _json(setup))
        self._write("timelines.json", _json(timelines))
        for each in files("sightline.app").joinpath("static").iterdir():
            if each.name != "index.html":
                self._write(f"static/{each.name}", each.read_bytes())
        self._write("index.html", _index().encode())

    def timelines_of(self) -> dict[str, PageState]:
        """List a state for each time line, by its key without the frame."""
        return {_key(state, with_frame=False): state for state in reversed(self._states)}

    async def timeline(self, answers: Answers, state: PageState) -> list[Any]:
        """Judge all frames under the faults of a state."""
        events = health_along(answers, state, self._dataset.sample_ids)
        return [[name, content] async for name, content in events]

    def _place(self, state: PageState) -> str:
        """Path of a state's file, which differs where the frame or the limits of health do."""
        text = f"{state.to_query()} {self._contents[state.broken.frame]}"
        return f"states/{_digest(text.encode())}.json"

    def _write(self, place: str, content: bytes) -> None:
        self._aside.write(place, content)
        self.expected.add(place)


async def _write(
    writer: _Writer, maker: PartMaker, missing: Sequence[PageState], count: int
) -> None:
    workers = Workers(maker, count)
    answers = Answers(workers.run)
    waiting, lines, done = iter(missing), ProgressLines(first_s=_FIRST_LINE_S), [0]

    async def go() -> None:
        for state in waiting:
            try:
                writer.write_state(state, await _whole(answers, state))
            except ValueError as error:
                raise ValueError(
                    f"{state.to_query()}: {error}. {done[0]} of {len(missing)} states are done "
                    "and stay: run the same again, or choose other --frames"
                ) from error
            done[0] += 1
            lines.show("exporting", done[0], len(missing))

    try:
        going = [asyncio.create_task(go()) for _ in range(count + 1)]
        try:
            await asyncio.gather(*going)
        finally:
            for each in going:
                each.cancel()
        timelines = {
            key: await writer.timeline(answers, state)
            for key, state in sorted(writer.timelines_of().items())
        }
        writer.write_page(timelines)
    finally:
        workers.close()


async def _whole(answers: Answers, state: PageState) -> dict[PartName, Answer]:
    """Compute all parts of a state, in the order of their names.

    Raises:
        ValueError: A part cannot be computed.
    """
    names: Iterable[PartName] = get_args(PartName)
    found = await asyncio.gather(*(answers.part(name, state) for name in names))
    return dict(zip(names, found, strict=True))


def _key(state: PageState, *, with_frame: bool = True) -> str:
    """Key of a state in the page's own words: the pairs of its link, not encoded."""
    pairs = state.to_pairs()
    return "&".join(f"{name}={value}" for name, value in pairs[0 if with_frame else 1 :])


def _index() -> str:
    """Page that reads files instead of asking a server; its policy forbids other hosts."""
    text = files("sightline.app").joinpath("static/index.html").read_text("utf-8")
    for before, after in (
        ('<html lang="en">', '<html lang="en" data-source="files">'),
        ("<title>", f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">\n<title>'),
    ):
        assert text.count(before) == 1, f"index.html has one {before}"
        text = text.replace(before, after)
    return text


def _json(content: object) -> bytes:
    return (json.dumps(content, separators=(",", ":")) + "\n").encode()


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:20]


def _content_of(dataset: SampleDataset, index: int) -> str:
    """Digest of a sample, or the fault if it cannot be read, which is told later."""
    try:
        return digest_sample(dataset[index])
    except ValueError as error:
        return str(error)


@cache
def _code_digest() -> str:
    """Digest of the package with its weights: answers of other code are computed anew."""
    root = Path(__file__).parents[1]
    digest = hashlib.sha256()
    for path in sorted(root.rglob("*")):
        if path.suffix in (".py", ".json", ".safetensors"):
            digest.update(f"{path.relative_to(root)}\0".encode() + path.read_bytes())
    return digest.hexdigest()[:20]
