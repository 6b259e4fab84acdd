"""Lists of samples that select frames of a data set."""

from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path

from sightline.files.plain_text import read_piped_text, read_text, shortened
from sightline.files.safe_names import relative_parts
from sightline.geometry.arguments import wrong_type

_PACKAGED = Path(__file__).with_name("sample_lists")


def read_sample_list(sample_list: str | Path | Sequence[str], root: Path | str) -> tuple[str, ...]:
    """Read the frames of a list, in its order.

    Args:
        sample_list: The frames themselves; or the name, without ".txt", of a list in the package
            ("kitti-object-train": 3712 frames, "kitti-object-val": 3769, as commonly published) or
            in `root`/ImageSets; or the path of a file or a pipe with one frame per line.
        root: The data set's folder.

    Raises:
        TypeError: The list has another type.
        ValueError: There is no such list, it is empty, names a frame twice, or contains an invalid
            file name.
    """
    if isinstance(sample_list, str | Path):
        path = _find(sample_list, Path(root))
        text = read_piped_text(path) if path.is_fifo() else read_text(path)
        lines = (line.strip() for line in text.split("\n"))
        frames, source = tuple(line for line in lines if line), str(path)
    else:
        if not isinstance(sample_list, Iterable):
            raise wrong_type("sample_list", sample_list, "the frames' names; give a list of text")
        frames, source = tuple(sample_list), "the list of frames"
        invalid = next((frame for frame in frames if not isinstance(frame, str)), None)
        if invalid is not None:
            raise ValueError(
                f"{source} holds {invalid!r}, expected text such as '000001'; give names as text"
            )
    if not frames:
        raise ValueError(f"{source} names no frames, expected one per line; name another list")
    for number, frame in enumerate(frames, start=1):
        relative_parts(frame, source, f"frame {number}")  # becomes part of files' names
    if len(set(frames)) < len(frames):
        repeated = next(frame for frame, count in Counter(frames).items() if count > 1)
        raise ValueError(
            f"{source} names frame '{shortened(repeated)}' twice; remove one of the lines"
        )
    return frames


def _find(sample_list: str | Path, root: Path) -> Path:
    candidates = (
        Path(sample_list),
        _PACKAGED / f"{sample_list}.txt",
        root / "ImageSets" / f"{sample_list}.txt",
    )
    for candidate in candidates:
        if candidate.is_file() or candidate.is_fifo():
            return candidate
    known = sorted(path.stem for path in _PACKAGED.glob("*.txt"))
    known += sorted(path.stem for path in (root / "ImageSets").glob("*.txt"))
    raise ValueError(
        f"there is no list {str(sample_list)!r}; give the path of a file with one frame per line, "
        f"or one of {', '.join(known)}"
    )
