"""Readers of PCD and PLY files, which allot no more memory than the file's size warrants."""

import io
import re
import struct
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from sightline.data.plain_file import read_bytes
from sightline.data.problem import FileError

MAX_BYTES: Final = 2**28
"""Largest file, and largest unpacked cloud: 4 million points of 64 bytes."""

REMEDY: Final = "export the cloud again, with fields x, y, z [m] and intensity"
"""Remedy in errors about clouds."""

INTENSITY_NAMES: Final = ("reflectivity", "reflectance", "intensity", "intensities", "i")
"""Names of the field that says how bright an echo is, calibrated ones first.

Ouster's and Hesai's drivers write `reflectivity` (0 to 255, corrected for range) beside `intensity`
(photon counts).
"""

_MAX_HEADER = 2**16
_LZF_GAIN = 100  # more than the format can pack: 264 bytes in three
_PCD_KINDS = {
    **{("F", size): f"<f{size}" for size in (2, 4, 8)},
    **{("I", size): f"<i{size}" for size in (1, 2, 4, 8)},
    **{("U", size): f"<u{size}" for size in (1, 2, 4, 8)},
}
_PLY_KINDS = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
_PLY_ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}
_MICROSOFT_NAN = re.compile(rb"[-+]?(?:nan\(\w*\)|1\.#\w+)", re.IGNORECASE)


class _Field(NamedTuple):
    name: str
    kind: str
    length: int = 1

    @property
    def num_bytes(self) -> int:
        return self.length * np.dtype(self.kind).itemsize


def plain_name(name: str) -> str:
    """A field's name in lower case, without the beginning that CloudCompare gives to its own."""
    return name.lower().removeprefix("scalar_")


def read_pcd(path: Path | str) -> np.ndarray:
    """Read the points of a PCD file as a structured array.

    Taken is what PCL takes: versions .5 to .7, header lines in any order, without COUNT, POINTS,
    HEIGHT or VIEWPOINT (of the oldest files without SIZE and TYPE), fields of COUNT 0 and gaps
    named `_`.

    Raises:
        FileError: The file cannot be read, is cut short, or its header makes no sense.
    """
    content = read_bytes(path, max_bytes=MAX_BYTES, remedy=REMEDY)
    header, start = _pcd_header(content, path)
    fields = _pcd_fields(header, path)
    num_points = _pcd_size(header, path)
    body = content[start:]
    data = " ".join(header["DATA"][:1]).lower()
    if data == "ascii":
        points = _ascii_points(body, fields, num_points, path)
        _warn_of_rest(len(points) - num_points, num_points, path)
        return points[:num_points]
    if data == "binary":
        points = _binary_points(body, fields, num_points, path)
        row_bytes = sum(field.num_bytes for field in fields)
        rest = body[num_points * row_bytes :]
        if row_bytes and rest.strip(b"\0\r\n "):
            _warn_of_rest(len(rest) // row_bytes, num_points, path)
        return points
    if data in ("binary_compressed", "binaryscompressed"):
        return _compressed_points(body, fields, num_points, path)
    raise FileError(
        path, f"holds DATA {data[:40]!r}, expected ascii, binary or binary_compressed", REMEDY
    )


def _pcd_header(content: bytes, path: Path | str) -> tuple[dict[str, list[str]], int]:
    """Words of each header line by its keyword, and where the points start."""
    header: dict[str, list[str]] = {}
    start = len(b"\xef\xbb\xbf") if content.startswith(b"\xef\xbb\xbf") else 0
    while start < min(len(content), _MAX_HEADER):
        end = content.find(b"\n", start)
        end = len(content) if end < 0 else end
        words = content[start:end].decode("latin-1").split()
        start = end + 1
        if words and not words[0].startswith("#"):
            header.setdefault(words[0].upper(), words[1:])
            if words[0].upper() == "DATA":
                return header, start
    lacking = "DATA" if {"FIELDS", "COLUMNS"} & set(header) else "FIELDS"
    raise FileError(path, f"is no whole PCD file: its header has no line {lacking}", REMEDY)


def _pcd_fields(header: dict[str, list[str]], path: Path | str) -> list[_Field]:
    names = header.get("FIELDS") or header.get("COLUMNS") or []
    if not names:
        raise FileError(path, "is no whole PCD file: its header has no line FIELDS", REMEDY)
    columns = {
        "SIZE": header.get("SIZE") or ["4"] * len(names),
        "TYPE": header.get("TYPE") or ["F"] * len(names),
        "COUNT": header.get("COUNT") or ["1"] * len(names),
    }
    for keyword, words in columns.items():
        if len(words) != len(names):
            problem = f"has {len(names)} FIELDS, but {keyword} for {len(words)}"
            raise FileError(path, f"{problem} in its header", REMEDY)
    fields = []
    for name, size, kind, count in zip(names, *columns.values(), strict=True):
        dtype = _PCD_KINDS.get((kind.upper(), _whole_number(size, "SIZE", path)))
        if dtype is None:
            problem = f"has the field {name[:40]} of TYPE {kind[:9]} and SIZE {size}"
            raise FileError(path, f"{problem}, which PCD does not have", REMEDY)
        fields.append(_Field(name, dtype, _whole_number(count, "COUNT", path)))
    return [field for field in fields if field.length]


def _pcd_size(header: dict[str, list[str]], path: Path | str) -> int:
    """Number of points that a header announces."""
    if header.get("POINTS"):
        return _whole_number(header["POINTS"][0], "POINTS", path)
    if not header.get("WIDTH"):
        raise FileError(path, "has neither POINTS nor WIDTH in its header", REMEDY)
    height = header.get("HEIGHT") or ["1"]
    width = _whole_number(header["WIDTH"][0], "WIDTH", path)
    return width * _whole_number(height[0], "HEIGHT", path)


def _whole_number(word: str, keyword: str, path: Path | str) -> int:
    if word.isascii() and word.isdigit() and len(word) <= 18:
        return int(word)
    problem = f"has {keyword} {word[:20]!r} in its header, expected a whole number"
    raise FileError(path, problem, REMEDY)


def read_ply(path: Path | str) -> np.ndarray:
    """Read the vertices of a PLY file, ASCII or binary, as a structured array.

    Raises:
        FileError: The file cannot be read, is cut short, or its vertices are no list of numbers.
    """
    content = read_bytes(path, max_bytes=MAX_BYTES, remedy=REMEDY)
    order, elements, start = _ply_header(content, path)
    names = [name for name, _, _ in elements]
    if "vertex" not in names:
        raise FileError(path, "has no element vertex in its header", REMEDY)
    position = names.index("vertex")
    _, num_points, fields = elements[position]
    before = elements[:position]
    if any(field.kind == "list" for _, _, listed in elements[: position + 1] for field in listed):
        problem = "has a list of numbers in its vertices or in an element before them"
        raise FileError(path, f"{problem}, which is not read", REMEDY)
    if order == "=":
        skipped = sum(count for _, count, _ in before)
        points = _ascii_points(
            content[start:], fields, num_points, path, skipped=skipped, is_last=False
        )
        return points[:num_points]
    start += sum(count * sum(field.num_bytes for field in each) for _, count, each in before)
    ordered = [_Field(field.name, order + field.kind) for field in fields]
    return _binary_points(content[start:], ordered, num_points, path)


def _ply_header(
    content: bytes, path: Path | str
) -> tuple[str, list[tuple[str, int, list[_Field]]], int]:
    """Byte order (= in ASCII), each element's name, number and fields, and where they start."""
    end = re.search(rb"^end_header[ \t]*\r?\n", content[:_MAX_HEADER], re.MULTILINE)
    if not content.startswith(b"ply") or end is None:
        raise FileError(path, "is no whole PLY file: its header has no end_header", REMEDY)
    order, elements = "", list[tuple[str, int, list[_Field]]]()
    for line in content[: end.start()].decode("latin-1").splitlines()[1:]:
        words = line.split()
        if words[:1] == ["format"] and len(words) > 1:
            order = _PLY_ORDERS.get(words[1], "")
        elif words[:1] == ["element"] and len(words) == 3:
            elements.append((words[1], _whole_number(words[2], words[1], path), []))
        elif words[:2] == ["property", "list"] and elements:
            elements[-1][2].append(_Field(words[-1], "list"))
        elif words[:1] == ["property"] and len(words) == 3 and elements:
            if words[1] not in _PLY_KINDS:
                problem = f"has the property {words[2][:40]} of {words[1][:40]}, which PLY has not"
                raise FileError(path, problem, REMEDY)
            elements[-1][2].append(_Field(words[2], _PLY_KINDS[words[1]]))
        elif words and words[0] not in ("comment", "obj_info"):
            raise FileError(path, f"has the header line {line[:40]!r}, which PLY has not", REMEDY)
    if not order:
        raise FileError(path, f"has no format of {', '.join(_PLY_ORDERS)} in its header", REMEDY)
    return order, elements, end.end()


def _dtype(fields: Sequence[_Field]) -> np.dtype[np.void]:
    """Rows of these fields without gaps; of several of one name the first."""
    layout: dict[str, tuple[object, int]] = {}
    offset = 0
    for field in fields:
        if field.name != "_":
            kind = field.kind if field.length == 1 else (field.kind, (field.length,))
            layout.setdefault(field.name, (kind, offset))
        offset += field.num_bytes
    return np.dtype(
        {
            "names": list(layout),
            "formats": [kind for kind, _ in layout.values()],
            "offsets": [at for _, at in layout.values()],
            "itemsize": offset,
        }
    )


def _binary_points(
    body: bytes, fields: Sequence[_Field], num_points: int, path: Path | str
) -> np.ndarray:
    """Points that lie one after the other."""
    row_bytes = sum(field.num_bytes for field in fields)
    if not num_points or not row_bytes:
        return _no_points(fields)
    _check_length(len(body) // row_bytes, num_points, path)
    return np.frombuffer(body, _dtype(fields), num_points)


def _compressed_points(
    body: bytes, fields: Sequence[_Field], num_points: int, path: Path | str
) -> np.ndarray:
    """Points that lie field by field in a block packed by LZF."""
    if not num_points:
        return _no_points(fields)
    if len(body) < 8:
        _check_length(0, num_points, path)
    packed_size, size = struct.unpack_from("<II", body)
    if size > MAX_BYTES or size > _LZF_GAIN * packed_size:
        problem = f"announces {size} bytes in {packed_size} compressed ones"
        raise FileError(path, f"{problem}, expected up to {MAX_BYTES} and no forgery", REMEDY)
    if packed_size > len(body) - 8:
        problem = f"holds {len(body) - 8} of the {packed_size} compressed bytes that it announces"
        raise FileError(path, f"{problem}: it is cut short", REMEDY)
    # PCL writes no gaps into compressed files; others do.
    for stored in (fields, [field for field in fields if field.name != "_"]):
        if size == num_points * sum(field.num_bytes for field in stored):
            return _unpacked(body[8 : 8 + packed_size], stored, size, num_points, path)
    problem = f"announces {num_points} points, which {size} unpacked bytes do not fit"
    raise FileError(path, problem, REMEDY)


def _unpacked(
    packed: bytes, fields: Sequence[_Field], size: int, num_points: int, path: Path | str
) -> np.ndarray:
    from pypcd4.pypcd4 import MetaData, PointCloud  # with pydantic, whose import takes a moment

    whole = MetaData(fields=("byte",), size=(1,), type=("U",), count=(1,), points=size, width=size)
    file = io.BytesIO(whole.compose_header().encode() + struct.pack("<II", len(packed), size))
    file.seek(0, io.SEEK_END)
    file.write(packed)
    file.seek(0)
    try:
        plain = PointCloud.from_fileobj(io.BufferedReader(file)).pc_data.view(np.uint8)
    except Exception as error:  # of the library, of any type
        raise FileError(path, "holds compressed points that cannot be unpacked", REMEDY) from error
    points = np.empty(num_points, _dtype(fields))
    start = 0
    done = set[str]()
    for field in fields:
        if field.name in (points.dtype.names or ()) and field.name not in done:
            block = np.frombuffer(plain, field.kind, num_points * field.length, start)
            points[field.name] = block.reshape(points[field.name].shape)
            done.add(field.name)
        start += num_points * field.num_bytes
    return points


def _ascii_points(
    body: bytes,
    fields: Sequence[_Field],
    num_points: int,
    path: Path | str,
    *,
    skipped: int = 0,
    is_last: bool = True,
) -> np.ndarray:
    """Points that are written out, a line each, by the fields that are needed."""
    if b"(" in body or b"#" in body:
        body = _MICROSOFT_NAN.sub(b"nan", body)
    lines = io.StringIO(body.decode("latin-1"), newline=None)
    for _ in range(min(skipped, len(body))):
        lines.readline()
    at = lines.tell()
    first = next((line.split() for line in lines if line.split("#")[0].strip()), [])
    lines.seek(at)
    if not num_points or not first:
        _check_length(0, num_points, path)
        return _no_points(fields)
    expected = sum(field.length for field in fields)
    if len(first) != expected:
        problem = f"has {len(first)} values in its first point, where its header has {expected}"
        raise FileError(path, problem, REMEDY)
    needed, column = dict[str, int](), 0
    for field in fields:
        if field.length == 1 and plain_name(field.name) in {"x", "y", "z", *INTENSITY_NAMES}:
            needed.setdefault(field.name, column)
        column += field.length
    if not needed:
        return _no_points(fields)  # whose names are refused
    num_lines = body.count(b"\n") + body.count(b"\r") + 1
    try:
        values = np.loadtxt(
            lines,
            usecols=list(needed.values()),
            ndmin=2,
            max_rows=None if is_last else min(num_points, num_lines),
        )
    except ValueError as error:
        cause = str(error).split("\n")[0][:90].rstrip(".")
        raise FileError(path, f"holds points that are no numbers: {cause}", REMEDY) from error
    _check_length(len(values), num_points, path)
    names = {field.name: "f8" if field.name in needed else "V0" for field in fields}
    points = np.zeros(len(values), list(names.items()))
    for number, name in enumerate(needed):
        points[name] = values[:, number]
    return points


def _no_points(fields: Sequence[_Field]) -> np.ndarray:
    return np.zeros(0, [(name, "f4") for name in dict.fromkeys(field.name for field in fields)])


def _check_length(num_found: int, num_points: int, path: Path | str) -> None:
    if num_found < num_points:
        problem = f"holds {num_found} of the {num_points} points that it announces"
        raise FileError(path, f"{problem}: it is cut short", REMEDY)


def _warn_of_rest(num_more: int, num_points: int, path: Path | str) -> None:
    if num_more > 0:
        warnings.warn(
            f"{path}: holds {num_more} points more than the {num_points} that it announces: they "
            "are left out; write how many there are into its header",
            stacklevel=4,
        )
