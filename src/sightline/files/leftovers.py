"""Names of files and folders that systems, network drives and sync tools leave beside data."""

from collections.abc import Collection, Iterable
from typing import Final

_FOLDERS: Final = frozenset(
    (
        *("@eadir", "#recycle", "#snapshot", "@tmp"),  # Synology
        *("@recycle", "@recently-snapshot", "~snapshot"),  # QNAP and NetApp
        *("$recycle.bin", "recycler", "system volume information", "found.000"),  # Windows
        *("lost+found", "__macosx", "network trash folder", "temporary items"),
    )
)
"""Folders without data, in lower case; others, such as .Trash-1000 and .stfolder, are hidden."""
_FILES: Final = frozenset(
    ("thumbs.db", "ehthumbs.db", "ehthumbs_vista.db", "desktop.ini", "icon\r")
)
_ENDINGS: Final = (
    *("zone.identifier", "@synoeastream", "@synoresource"),  # streams of other files
    *(".md5", ".sha1", ".sha256", ".sha512", ".sfv", ".crc32"),
)
_DOWNLOADS: Final = (".part", ".partial", ".filepart", ".crdownload", ".download", ".aria2", ".tmp")
_BACKUPS: Final = (".bak", ".backup", ".old", ".orig", "~")


def is_leftover(name: str) -> bool:
    """Test if a file or folder of this name is no data: hidden, a system's or a checksum."""
    plain = name.lower()
    return plain.startswith(".") or plain in _FOLDERS or plain in _FILES or plain.endswith(_ENDINGS)


def is_companion(name: str, files: Collection[str]) -> bool:
    """Test if a name begins with that of one of the files: 000001.png.bak beside 000001.png."""
    return any(name[:end] in files for end in range(1, len(name)))


def remedy_for_endings(names: Iterable[str]) -> str | None:
    """Remedy for files whose endings tell of a download or a backup; None: of neither."""
    plain = [name.lower() for name in names]
    if all(name.endswith(_DOWNLOADS) for name in plain):
        return "finish their download"
    return "rename them" if all(name.endswith(_BACKUPS) for name in plain) else None
