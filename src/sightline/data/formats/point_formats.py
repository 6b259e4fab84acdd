"""Readers of PCD and PLY files with memory limited by the file's size."""

import io
import re
import struct
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from sightline.data.formats.point_rows import (
    MAX_BYTES,
    MAX_HEADER,
    REMEDY,
    Field,
    ascii_points,
    binary_points,
    check_length,
    has_bare_returns,
    no_points,
    row_type,
    warn_of_repeated,
    warn_of_rest,
)
from sightline.files.plain_file import read_bytes
from sightline.files.problem import FileError

_NO_VIEWPOINT = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)  # position, then rotation as w, x, y, z
_LZF_GAIN = 100  # above the format's largest ratio: 264 bytes in three
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


def read_pcd(path: Path | str) -> np.ndarray:
    """Read the points of a PCD file as a structured array.

    Accepts the same files as PCL: versions .5 to .7, header lines in any order, without COUNT,
    POINTS, HEIGHT or VIEWPOINT (the oldest files also without SIZE and TYPE), fields of COUNT 0 and
    gaps named `_`.

    Raises:
        FileError: The file cannot be read, is truncated, or has an invalid header.
    """
    content = read_bytes(path, max_bytes=MAX_BYTES, remedy=REMEDY)
    header, start = _pcd_header(content, path)
    fields = _pcd_fields(header, path)
    num_points = _pcd_size(header, path)
    _check_viewpoint(header, path)
    warn_of_repeated(field.name for field in fields)
    body = content[start:]
    data = " ".join(header["DATA"][:1]).lower()
    if data == "ascii":
        return ascii_points(body, fields, num_points, path)
    if data == "binary":
        points = binary_points(body, fields, num_points, path)
        row_bytes = sum(field.num_bytes for field in fields)
        rest = body[num_points * row_bytes :]
        if row_bytes and rest.strip(b"\0\r\n "):
            warn_of_rest(len(rest) // row_bytes, num_points, path)
        return points
    if data in ("binary_compressed", "binaryscompressed"):
        return _compressed_points(body, fields, num_points, path)
    raise FileError(
        path, f"holds DATA {data[:40]!r}, expected ascii, binary or binary_compressed", REMEDY
    )


def _pcd_header(content: bytes, path: Path | str) -> tuple[dict[str, list[str]], int]:
    """Parse the words of each header line by keyword, and the offset of the points."""
    header: dict[str, list[str]] = {}
    start = len(b"\xef\xbb\xbf") if content.startswith(b"\xef\xbb\xbf") else 0
    line_end = b"\r" if has_bare_returns(content) else b"\n"
    while start < min(len(content), MAX_HEADER):
        end = content.find(line_end, start)
        end = len(content) if end < 0 else end
        words = content[start:end].decode("latin-1").split()
        start = end + 1
        if words and not words[0].startswith("#"):
            header.setdefault(words[0].upper(), words[1:])
            if words[0].upper() == "DATA":
                return header, start
    missing = "DATA" if {"FIELDS", "COLUMNS"} & set(header) else "FIELDS"
    raise FileError(path, f"is no whole PCD file: its header has no line {missing}", REMEDY)


def _check_viewpoint(header: dict[str, list[str]], path: Path | str) -> None:
    """Warn of a VIEWPOINT, which is not applied: in PCL, points are in the sensor's frame.

    Raises:
        FileError: The VIEWPOINT is no pose.
    """
    words = header.get("VIEWPOINT")
    if not words:
        return
    try:
        pose = [float(word) for word in words]
    except ValueError:
        pose = []
    if len(pose) != len(_NO_VIEWPOINT) or not np.isfinite(pose).all():
        text = " ".join(words)[:60]
        problem = f"has VIEWPOINT {text!r} in its header, expected tx ty tz qw qx qy qz"
        raise FileError(path, problem, "write VIEWPOINT 0 0 0 1 0 0 0, or leave the line out")
    if tuple(map(abs, pose)) != _NO_VIEWPOINT:
        warnings.warn(  # without the file's name: one warning for all files
            "PCD files have a VIEWPOINT other than 0 0 0 1 0 0 0, which is not applied: their "
            "points are assumed to be in the LiDAR's frame, as in PCL; transform them if they are "
            "in another frame",
            stacklevel=1,
        )


def _pcd_fields(header: dict[str, list[str]], path: Path | str) -> list[Field]:
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
            raise FileError(path, f"{problem}, which PCD does not support", REMEDY)
        fields.append(Field(name, dtype, _whole_number(count, "COUNT", path)))
    return [field for field in fields if field.length]


def _pcd_size(header: dict[str, list[str]], path: Path | str) -> int:
    """Number of points in the header."""
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
        FileError: The file cannot be read, is truncated, or its vertices are no list of numbers.
    """
    content = read_bytes(path, max_bytes=MAX_BYTES, remedy=REMEDY)
    order, elements, start = _ply_header(content, path)
    names = [name for name, _, _ in elements]
    if "vertex" not in names:
        raise FileError(path, "has no element vertex in its header", REMEDY)
    if names.count("vertex") > 1:
        raise FileError(path, "has several elements vertex in its header, expected one", REMEDY)
    position = names.index("vertex")
    _, num_points, fields = elements[position]
    before = elements[:position]
    if any(field.kind == "list" for _, _, listed in elements[: position + 1] for field in listed):
        problem = "has a list of numbers in its vertices or in an element before them"
        raise FileError(path, f"{problem}, which is not supported", REMEDY)
    warn_of_repeated(field.name for field in fields)
    after = elements[position + 1 :]
    if order == "=":
        skipped, following = (sum(count for _, count, _ in each) for each in (before, after))
        body = content[start:]
        return ascii_points(body, fields, num_points, path, skipped=skipped, following=following)
    start += sum(map(_element_bytes, before))
    ordered = [Field(field.name, order + field.kind) for field in fields]
    points = binary_points(content[start:], ordered, num_points, path)
    row_bytes = sum(field.num_bytes for field in ordered)
    has_lists = any(count and any(f.kind == "list" for f in each) for _, count, each in after)
    if row_bytes and not has_lists:
        rest = len(content) - start - num_points * row_bytes - sum(map(_element_bytes, after))
        warn_of_rest(rest // row_bytes, num_points, path)
    return points


def _element_bytes(element: tuple[str, int, list[Field]]) -> int:
    """Size in a binary file of an element without lists, or without rows."""
    _, count, fields = element
    return count * sum(field.num_bytes for field in fields) if count else 0


def _ply_header(
    content: bytes, path: Path | str
) -> tuple[str, list[tuple[str, int, list[Field]]], int]:
    """Parse byte order (= in ASCII), each element's name, number and fields, and their offset."""
    line_end = rb"\r" if has_bare_returns(content) else rb"\r?\n"
    last_line = rb"(?:^|[\r\n])end_header[ \t]*" + line_end
    end = re.search(last_line, content[:MAX_HEADER])
    if not content.startswith(b"ply") or end is None:
        raise FileError(path, "is no whole PLY file: its header has no end_header", REMEDY)
    order, elements = "", list[tuple[str, int, list[Field]]]()
    # splitlines would also split at 0x85 and others, which are parts of letters in UTF-8.
    for line in re.split(r"\r\n|\n|\r", content[: end.start()].decode("latin-1"))[1:]:
        words = line.split()
        if words[:1] == ["format"] and len(words) > 1:
            order = _PLY_ORDERS.get(words[1], "")
        elif words[:1] == ["element"] and len(words) == 3:
            elements.append((words[1], _whole_number(words[2], words[1], path), []))
        elif words[:2] == ["property", "list"] and elements:
            elements[-1][2].append(Field(words[-1], "list"))
        elif words[:1] == ["property"] and len(words) == 3 and elements:
            if words[1] not in _PLY_KINDS:
                problem = f"has the property {words[2][:40]} of {words[1][:40]}, unknown in PLY"
                raise FileError(path, problem, REMEDY)
            elements[-1][2].append(Field(words[2], _PLY_KINDS[words[1]]))
        elif words and words[0] not in ("comment", "obj_info"):
            raise FileError(
                path, f"has the header line {line[:40]!r}, which PLY does not support", REMEDY
            )
    if not order:
        raise FileError(path, f"has no format of {', '.join(_PLY_ORDERS)} in its header", REMEDY)
    return order, elements, end.end()


def _compressed_points(
    body: bytes, fields: Sequence[Field], num_points: int, path: Path | str
) -> np.ndarray:
    """Read points stored field by field in an LZF-compressed block."""
    if not num_points:
        return no_points(fields)
    if len(body) < 8:
        check_length(0, num_points, path)
    packed_size, size = struct.unpack_from("<II", body)
    if size > MAX_BYTES or size > _LZF_GAIN * packed_size:
        problem = f"declares {size} bytes in {packed_size} compressed ones"
        raise FileError(
            path,
            f"{problem}, expected at most {MAX_BYTES} and {_LZF_GAIN} per compressed byte",
            REMEDY,
        )
    if packed_size > len(body) - 8:
        problem = f"holds {len(body) - 8} of the {packed_size} declared compressed bytes"
        raise FileError(path, f"{problem}: it is cut short", REMEDY)
    # PCL writes no gaps into compressed files; others do.
    for stored in (fields, [field for field in fields if field.name != "_"]):
        if size == num_points * sum(field.num_bytes for field in stored):
            return _unpacked(body[8 : 8 + packed_size], stored, size, num_points, path)
    problem = f"declares {num_points} points, which do not fit {size} unpacked bytes"
    raise FileError(path, problem, REMEDY)


def _unpacked(
    packed: bytes, fields: Sequence[Field], size: int, num_points: int, path: Path | str
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
    points = np.empty(num_points, row_type(fields))
    start = 0
    done = set[str]()
    for field in fields:
        if field.name in (points.dtype.names or ()) and field.name not in done:
            block = np.frombuffer(plain, field.kind, num_points * field.length, start)
            points[field.name] = block.reshape(points[field.name].shape)
            done.add(field.name)
        start += num_points * field.num_bytes
    return points
