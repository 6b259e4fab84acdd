import ctypes
import struct
import subprocess
import sys
import zlib
from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import pytest

from sightline.data.formats.image_file import read_rgb
from sightline.data.formats.quiet_decoder import decode_quietly
from sightline.files.problem import FileError

IMAGE = cv2.GaussianBlur(
    np.random.default_rng(0).integers(0, 255, (60, 80, 3), dtype=np.uint8), (9, 9), 3
)
JPEG = cv2.imencode(".jpg", IMAGE)[1].tobytes()


def png(change=lambda pixels: pixels, **profile):
    """A PNG with right checksums whose packed pixels, or whose notes, are changed."""
    chunks = {b"IHDR": struct.pack(">IIBBBBB", 80, 60, 8, 2, 0, 0, 0)}
    chunks |= {name.encode(): content for name, content in profile.items()}
    rows = np.pad(IMAGE.reshape(60, -1), ((0, 0), (1, 0)))
    chunks |= {b"IDAT": change(zlib.compress(rows.tobytes())), b"IEND": b""}
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(content))
        + name
        + content
        + struct.pack(">I", zlib.crc32(name + content))
        for name, content in chunks.items()
    )


DAMAGED = {
    "a.png": png(lambda packed: packed[:40] + bytes([packed[40] ^ 255]) + packed[41:]),
    "b.png": png(lambda packed: zlib.compress(zlib.decompress(packed)[:999])),
    "c.jpg": JPEG[: len(JPEG) // 2] + b"\xff\xd9",
}
SOUND = {
    "a.png": png(),
    "b.png": png(iCCP=b"x\0\0" + zlib.compress(b"junk")),
    "c.png": png(tEXt=b"", zTXt=b"Comment\0\0junk", iTXt=b"x", tIME=b"1"),
    "d.jpg": JPEG[:-2] + bytes(17) + JPEG[-2:],
}


@pytest.mark.parametrize("name", DAMAGED)
def test_damaged_pictures_are_one_error_and_nothing_else_is_printed(tmp_path, name, capfd):
    (tmp_path / name).write_bytes(DAMAGED[name])
    with pytest.raises(FileError, match=f"{name}: is damaged: "):
        read_rgb(tmp_path / name)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("name", SOUND)
def test_sound_pictures_with_odd_profiles_or_bytes_are_read_in_silence(tmp_path, name, capfd):
    (tmp_path / name).write_bytes(SOUND[name])
    assert read_rgb(tmp_path / name).shape == IMAGE.shape
    assert capfd.readouterr() == ("", "")


def test_damage_is_told_of_the_right_picture_by_many_threads_and_the_rest_is_printed(capfd):
    files = [*DAMAGED.values(), *SOUND.values()] * 20
    alone = [decode_quietly(content, cv2.IMREAD_COLOR)[1] for content in files]
    assert [bool(said) for said in alone[:6]] == [True] * 3 + [False] * 3
    level = cv2.utils.logging.getLogLevel()
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(lambda each: decode_quietly(each, cv2.IMREAD_COLOR)[1], files))
    assert together == alone
    assert cv2.utils.logging.getLogLevel() == level
    ctypes.CDLL(None).perror(b"said by C")
    assert "said by C" in capfd.readouterr().err


def test_a_forked_process_leaves_no_file_open(tmp_path):
    (tmp_path / "a.png").write_bytes(SOUND["a.png"])
    code = (
        "import os, sys\n"
        "from sightline.data.formats.image_file import read_rgb\n"
        f"read_rgb({str(tmp_path / 'a.png')!r})\n"
        "child = os.fork()\n"
        "if child: sys.exit(os.waitpid(child, 0)[1])\n"
    )
    command = [sys.executable, "-W", "error::ResourceWarning", "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
