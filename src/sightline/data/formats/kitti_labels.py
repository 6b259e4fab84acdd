"""KITTI's label and result files: one object per line with 15 fields, and a score in results."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from sightline.files.atomic import atomic_write_text
from sightline.files.plain_file import read_bytes
from sightline.files.plain_text import shortened, without_marks
from sightline.files.problem import FileError

FIELDS = (
    "class",
    "truncation",
    "occlusion",
    "alpha",
    "x_min",
    "y_min",
    "x_max",
    "y_max",
    "height",
    "width",
    "length",
    "x",
    "y",
    "z",
    "rotation_y",
    "score",
)
"""Fields of a line, in order; labels end before the score."""

CLASS_NAMES = ("Car", "Van", "Truck", "Pedestrian", "Person_sitting", "Cyclist", "Tram", "Misc")
"""Class names of objects in labels; ignored regions are DontCare."""

UNKNOWN = -1.0
"""Placeholder of an unknown truncation or occlusion."""
NO_ALPHA = -10.0
"""Placeholder of an unknown observation angle."""
NO_SIZE, NO_LOCATION, NO_ROTATION = -1.0, -1000.0, -10.0
"""Placeholders of each size, each coordinate and rotation_y of an object without a 3D part."""

MAX_OCCLUSION, MAX_TRUNCATION = 2, 0.5
"""Largest values of labels that count in KITTI's scores; an occlusion of 3 is unknown."""

MAX_LABEL_BYTES = 2**24
"""Largest label or result file: more than 100,000 objects in one frame."""
_MAX_NAME_LENGTH = 64  # characters of a class
_MAX_MAGNITUDE = 1e12  # as of calibrations; squares of larger numbers are soon infinite
_TOO_LARGE = (f"beyond {_MAX_MAGNITUDE:g}", "write metres, radians and pixels")
_LABEL_FIELDS = 15
_MIN_HEADING = 3  # words without a number: of an object even a short line has some
_LANGUAGES = {b"{": "JSON", b"[": "JSON", b"<": "XML"}  # by their first character
_RESULT_FIELDS = 16
_OCCLUSION = 1  # columns of the numbers of a line
_LOCATION = slice(10, 13)
_PLACEHOLDERS = {
    "truncation": UNKNOWN,
    "alpha": NO_ALPHA,
    "height": NO_SIZE,
    "width": NO_SIZE,
    "length": NO_SIZE,
    "x": NO_LOCATION,
    "y": NO_LOCATION,
    "z": NO_LOCATION,
    "rotation_y": NO_ROTATION,
}


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class KittiObjects:
    """The objects of one label or result file, column by column, in the order of its lines.

    KITTI's own conventions: rectified camera frame (x right, y down, z forward), metres and
    radians; boxes in pixels. Missing values have KITTI's placeholders: -1, -10 or -1000.
    """

    class_names: tuple[str, ...]
    """Class names as in the file, e.g. Car, Pedestrian, DontCare."""
    truncation: Float64[np.ndarray, " num_objects"]
    """Share outside the image, 0 to 1; -1: unknown."""
    occlusion: Float64[np.ndarray, " num_objects"]
    """0 visible, 1 partly, 2 largely occluded, 3 unknown; -1 in results and for DontCare."""
    alpha: Float64[np.ndarray, " num_objects"]
    """Observation angle [rad]; -10: unknown."""
    boxes2d: Float64[np.ndarray, "num_objects 4"]
    """x_min, y_min, x_max, y_max [px]."""
    dimensions_hwl: Float64[np.ndarray, "num_objects 3"]
    """Height, width, length [m]; -1: no 3D part."""
    locations: Float64[np.ndarray, "num_objects 3"]
    """Centre of the bottom face [m]; -1000: no 3D part."""
    rotation_y: Float64[np.ndarray, " num_objects"]
    """Rotation about the camera's y axis [rad], 0 faces +x; -10: no 3D part."""
    scores: Float64[np.ndarray, " num_objects"] | None = None
    """Confidence on any scale, higher is more certain; None in labels."""

    def __post_init__(self) -> None:
        """Check that the columns have equal lengths, and that the scores are numbers."""
        lengths = {
            "class_names": len(self.class_names),
            "truncation": len(self.truncation),
            "occlusion": len(self.occlusion),
            "alpha": len(self.alpha),
            "boxes2d": len(self.boxes2d),
            "dimensions_hwl": len(self.dimensions_hwl),
            "locations": len(self.locations),
            "rotation_y": len(self.rotation_y),
        }
        if self.scores is not None:
            lengths["scores"] = len(self.scores)
        if len(set(lengths.values())) > 1:
            raise ValueError(f"objects of one frame need columns of one length, got {lengths}")
        if self.scores is not None and np.isnan(self.scores).any():
            raise ValueError(f"{int(np.isnan(self.scores).sum())} scores are NaN, expected numbers")

    def __len__(self) -> int:
        """Number of objects."""
        return len(self.class_names)


def read_labels(path: Path) -> KittiObjects:
    """Read a label file (ground truth); an empty file is a frame without objects.

    A 16th field, as in results used as ground truth, is ignored, as in KITTI's own evaluation.

    Raises:
        FileError: A field is missing, not a number or not finite; contains the file, line and
            field.
    """
    return parse_objects(_read_bytes(path, "label"), path, with_scores=False)


def read_results(path: Path) -> KittiObjects:
    """Read a result file (detections with scores); an empty file is a frame without detections.

    Raises:
        FileError: A field is missing, not a number or not finite; contains the file, line and
            field.
    """
    return parse_objects(_read_bytes(path, "result"), path, with_scores=True)


def parse_objects(data: bytes, source: Path | str, *, with_scores: bool) -> KittiObjects:
    """Parse the contents of a label file, or of a result file (`with_scores`).

    Fields are separated by ASCII white space; blank lines are skipped. Numbers are finite decimals
    (KITTI's C program would also accept `nan`, `inf` and hexadecimals, and would misread all lines
    after a missing field: all four are errors here). The occlusion of a label is a whole number; in
    a result it has no meaning and may be any number. Only a score may have a magnitude above 1e12.

    Args:
        data: Bytes of the file.
        source: Name of the file in errors.
        with_scores: Whether lines end with a score.

    Raises:
        FileError: A field is missing, not a number, not finite or too large, a class name is too
            long, or the file is UTF-16; contains the source and line.
    """
    data = without_marks(data, source)
    num_fields = _RESULT_FIELDS if with_scores else _LABEL_FIELDS
    names: list[bytes] = []
    tokens: list[bytes] = []
    complete = True
    for _, fields in _lines(data):
        complete &= len(fields) == num_fields or (not with_scores and len(fields) == _RESULT_FIELDS)
        names.append(fields[0])
        tokens += fields[1:num_fields]
    try:
        if not complete:
            raise ValueError
        # float accepts underscores as in 1_000, the format does not; Person_sitting has one, too
        values = np.array([*map(_number if b"_" in data else float, tokens)])
        class_names = tuple([name.decode() for name in names])
    except ValueError:
        raise _first_fault(data, source, with_scores=with_scores) from None
    values = values.reshape(len(names), num_fields - 1)
    if max(map(len, class_names), default=0) > _MAX_NAME_LENGTH:
        raise _first_fault(data, source, with_scores=with_scores)
    whole = with_scores or bool((values[:, _OCCLUSION] % 1 == 0).all())
    is_sound = np.isfinite(values).all() and whole
    if not is_sound or (np.abs(values[:, : _LABEL_FIELDS - 1]) > _MAX_MAGNITUDE).any():
        raise _first_fault(data, source, with_scores=with_scores)
    values.setflags(write=False)
    return objects_from_rows(class_names, values)


def objects_from_rows(
    class_names: tuple[str, ...], rows: Float64[np.ndarray, "num_objects num_fields"]
) -> KittiObjects:
    """Build objects from the numbers of their lines: `FIELDS` after the class, score optional."""
    return KittiObjects(
        class_names=class_names,
        truncation=rows[:, 0],
        occlusion=rows[:, 1],
        alpha=rows[:, 2],
        boxes2d=rows[:, 3:7],
        dimensions_hwl=rows[:, 7:10],
        locations=rows[:, 10:13],
        rotation_y=rows[:, 13],
        scores=rows[:, 14] if rows.shape[1] == _RESULT_FIELDS - 1 else None,
    )


def write_objects(path: Path, objects: KittiObjects, *, decimals: int | None = 2) -> None:
    """Write a label file, or a result file if the objects have scores.

    The file is written atomically. KITTI's own label files are reproduced byte for byte.

    Args:
        path: The file.
        objects: Objects to write.
        decimals: Decimals of all fields except the score; KITTI uses 2. None: as many as needed to
            restore the exact numbers. Scores are always exact: rounding would create ties, which
            change the evaluation.

    Raises:
        ValueError: A class name is empty, too long or has white space, an occlusion is no whole
            number, or a number is not finite or too large: readers would refuse the file.
    """
    columns = [objects.truncation, objects.occlusion, objects.alpha, objects.boxes2d]
    columns += [objects.dimensions_hwl, objects.locations, objects.rotation_y]
    if objects.scores is not None:
        columns.append(objects.scores)
    rows = np.column_stack(columns).tolist()
    with_scores = objects.scores is not None
    lines = []
    for number, (name, row) in enumerate(zip(objects.class_names, rows, strict=True), start=1):
        try:
            lines.append(_format_line(name, row, decimals, with_scores=with_scores))
        except ValueError as error:
            raise ValueError(f"{path} cannot be written, line {number}: {error}") from None
    atomic_write_text(path, "".join(lines))


def _read_bytes(path: Path, kind: str) -> bytes:
    remedy = f"give a {kind} file of KITTI's, one for each frame"
    return read_bytes(path, max_bytes=MAX_LABEL_BYTES, remedy=remedy)


def _lines(data: bytes) -> Iterator[tuple[int, list[bytes]]]:
    """Split lines, numbered from 1, into fields; blank lines are left out.

    Works on bytes, not text: only ASCII white space separates fields, as in C.
    """
    for number, line in enumerate(data.splitlines(), start=1):
        if fields := line.split():
            yield number, fields


def _number(token: bytes) -> float:
    if b"_" in token:  # Python reads 1_000 as a number, the format does not
        raise ValueError
    return float(token)


def _first_fault(data: bytes, source: Path | str, *, with_scores: bool) -> FileError:
    """Error for the first invalid line, with the remedy."""
    expected = FIELDS if with_scores else FIELDS[:_LABEL_FIELDS]
    kind = "result" if with_scores else "label"
    for number, fields in _lines(data):
        other = _no_object(fields) or _other_format(fields) or _spaced_class(fields, len(expected))
        if other:
            return FileError(source, f"line {number} {other[0]}", other[1])
        count = f"line {number} has {len(fields)} fields, but a {kind} has {len(expected)}"
        if len(fields) < len(expected):
            is_label = len(fields) == _LABEL_FIELDS
            if mark := next((each for each in (b",", b";") if each in b"".join(fields)), None):
                remedy = f"separate fields by spaces, without {mark.decode()}"
                return FileError(source, count, remedy)
            labels = ", or give result files if these are labels" if is_label else ""
            return FileError(source, count, f"add {', '.join(expected[len(fields) :])}{labels}")
        if len(fields) > _RESULT_FIELDS:
            return FileError(source, count, f"remove the fields after {expected[-1]}")
        for name, token in zip(expected, fields, strict=False):
            if fault := _fault_of_field(name, token, with_scores=with_scores):
                return FileError(source, f"line {number}: {fault[0]}", fault[1])
    raise AssertionError(f"{source} was refused, but no line is invalid")


def _no_object(fields: Sequence[bytes]) -> tuple[str, str] | None:
    """Problem and remedy for a comment, a heading or spaces of other kinds in a line; or None."""
    if fields[0].startswith((b"#", b"//")):
        return "is a comment, expected an object", "remove the line"
    if len(fields) >= _MIN_HEADING and all(map(_is_word, fields)):
        return "is a heading or other text, expected an object", "remove the line"
    text = b"".join(fields).decode(errors="replace")
    if any(letter.isspace() for letter in text):
        return "has no-break or wide spaces between its fields", "separate fields by plain spaces"
    return None


def _other_format(fields: Sequence[bytes]) -> tuple[str, str] | None:
    """Problem and remedy for a line of JSON, XML, calibrations, KITTI tracking or YOLO; or None."""
    is_number = [_is_number(field) for field in fields]
    is_object = len(fields) >= _LABEL_FIELDS and all(is_number[1:])
    if (language := _LANGUAGES.get(fields[0][:1])) and not is_object:
        return (
            f"is {language}, expected an object of KITTI's: {_LABEL_FIELDS} fields between spaces",
            f"convert the file: a line for each object, {', '.join(FIELDS[:3])} and so on",
        )
    if b":" in fields[0] and len(fields) < _LABEL_FIELDS and all(is_number[1:]):
        name = shortened(fields[0].decode(errors="replace"), 24)
        return (
            f"begins with '{name}' and numbers, as calibrations do",
            "give the folder of label or result files; KITTI's calib holds calibrations",
        )
    if tracked := _tracking(fields):
        return tracked
    if len(fields) in (5, 6) and all(is_number) and all(0 <= float(x) <= 1 for x in fields[1:]):
        return (
            f"has {len(fields)} numbers, as YOLO labels have (class, centre, width, height "
            f"relative to the image), expected the {_LABEL_FIELDS} fields of KITTI",
            "convert them to class names and x_min, y_min, x_max, y_max in pixels",
        )
    return None


def sequence_fault(path: Path) -> tuple[str, str] | None:
    """Problem and remedy for a file of KITTI tracking, of a whole sequence; None: it is none."""
    try:
        lines = _lines(_read_bytes(path, "result"))
    except FileError:
        return None  # its reader reports it
    number, fields = next(lines, (0, []))
    tracked = _tracking(fields)
    return None if tracked is None else (f"line {number} {tracked[0]}", tracked[1])


def _tracking(fields: Sequence[bytes]) -> tuple[str, str] | None:
    """Problem and remedy for a line of KITTI tracking; or None."""
    is_number = [_is_number(field) for field in fields[:3]]
    if len(fields) < _LABEL_FIELDS + 2 or is_number != [True, True, False]:
        return None
    return (
        f"has {len(fields)} fields: frame and track number come before the class, as in KITTI "
        "tracking, whose files hold a whole sequence",
        "write a file for each frame without its first two fields, and truncations from 0 to 1 "
        "instead of its levels 0 to 2",
    )


def _spaced_class(fields: Sequence[bytes], num_expected: int) -> tuple[str, str] | None:
    """Problem and remedy for a line whose further fields are words of its class; or None."""
    num_words = len(fields) - num_expected + 1
    words = [each.decode(errors="replace") for each in fields[: max(num_words, 0)]]
    are_words = all(map(_is_word, fields[:num_words])) and all(map(_has_letter, words))
    if num_words < 2 or not are_words or not all(map(_is_number, fields[num_words:])):
        return None
    return (
        f"has spaces in its class '{shortened(' '.join(words), 24)}', expected one word",
        f"write {shortened('_'.join(words), 24)}, or the class of KITTI's that is meant",
    )


def _has_letter(text: str) -> bool:
    return any(map(str.isalpha, text))


def _is_word(token: bytes) -> bool:
    """Check that a field is no number, also none such as nan."""
    try:
        float(token)
    except ValueError:
        return True
    return False


def _is_number(token: bytes) -> bool:
    try:
        return math.isfinite(_number(token))
    except ValueError:
        return False


def _fault_of_field(name: str, token: bytes, *, with_scores: bool) -> tuple[str, str] | None:
    """Problem and remedy of a field; None: the field is valid."""
    found = f"{name} is '{shortened(token.decode(errors='replace'), 24)}'"
    if name == "class":
        return _fault_of_class(token, found)
    try:
        value = _number(token)
    except ValueError:
        return f"{found}, not a number", "write a decimal number"
    if not math.isfinite(value):
        return f"{found}, not finite", "write a decimal number"
    if _is_too_large(name, value):
        return f"{found}, {_TOO_LARGE[0]}", _TOO_LARGE[1]
    if name == "occlusion" and value % 1 and not with_scores:
        return f"{found}, not a whole number", "write 0, 1, 2 or 3"
    return None


def _is_too_large(field: str, value: float) -> bool:
    return field != "score" and abs(value) > _MAX_MAGNITUDE


def _fault_of_class(token: bytes, found: str) -> tuple[str, str] | None:
    try:
        is_short = len(token.decode()) <= _MAX_NAME_LENGTH
    except UnicodeDecodeError:
        return f"{found}, not text in UTF-8", "write the file as plain text"
    remedy = "write a shorter name"
    return None if is_short else (f"{found}, longer than {_MAX_NAME_LENGTH} characters", remedy)


def _format_line(
    class_name: str, values: list[float], decimals: int | None, *, with_scores: bool
) -> str:
    """Format a line of the file; raises ValueError, without the position, if it is impossible."""
    if class_name.encode().split() != [class_name.encode()]:
        raise ValueError(f"class is {class_name!r}, expected one word: rename it")
    if "\0" in class_name or "\ufeff" in class_name:
        raise ValueError(f"class is {class_name!r}, which readers refuse: rename it")
    if len(class_name) > _MAX_NAME_LENGTH:
        raise ValueError(
            f"class is longer than {_MAX_NAME_LENGTH} characters: write a shorter name"
        )
    no_box3d = all(value == NO_LOCATION for value in values[_LOCATION])
    words = [class_name]
    for field, value in zip(FIELDS[1:], values, strict=False):
        if not math.isfinite(value):
            raise ValueError(f"{field} is {value}, not finite: leave the object out")
        if _is_too_large(field, value):
            raise ValueError(f"{field} is {value}, {': '.join(_TOO_LARGE)}")
        if field == "occlusion" and value % 1 and not with_scores:
            raise ValueError(f"occlusion is {value}, not a whole number: give 0, 1, 2 or 3")
        if _is_written_whole(field, value, no_box3d=no_box3d):
            words.append(str(int(value)))
        elif field == "score" or decimals is None:
            words.append(repr(value))
        else:
            words.append(f"{value:.{decimals}f}")
    return " ".join(words) + "\n"


def _is_written_whole(field: str, value: float, *, no_box3d: bool) -> bool:
    """Whether KITTI writes the number without a decimal point: occlusions and placeholders."""
    if field == "occlusion":
        return value % 1 == 0
    return no_box3d and _PLACEHOLDERS.get(field) == value
