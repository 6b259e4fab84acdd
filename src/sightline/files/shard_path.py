"""Paths of files in shards, which are read without unpacking them."""

import errno
import io
import os
import stat
from collections.abc import Iterator, Mapping
from fnmatch import fnmatchcase
from pathlib import Path, PosixPath
from typing import Any

from sightline.files.byte_source import RefusedError, url_of
from sightline.files.plain_file import as_path
from sightline.files.problem import FileError, shown_place
from sightline.files.shard_index import SHARED, Member, ShardTree, open_tree


def data_path(path: Path | str) -> Path:
    """Path of a data set, or of a place in it; a `ShardPath` if it lies in shards.

    Shards are a folder that `sightline shard` wrote, or one of its tars. URLs of such a folder or
    tar, such as s3://bucket/shards, are read by fsspec.

    Raises:
        ValueError: The shards are damaged, or cannot be reached.
    """
    path = as_path(path)
    if isinstance(path, ShardPath):
        return path
    if "?" in path.name and url_of(path) is not None:
        raise FileError(
            path,
            "has a query, which is of one file, and shards are several",
            "give the address of their folder, or copy them to this machine",
        )
    found = _tree_of(path)
    if found is None and url_of(path) is not None:
        raise FileError(
            path,
            "holds no shards, or cannot be reached",
            "give the address of a folder that `sightline shard` wrote, or of one of its tars",
        )
    if found is None or (found[1] and path.exists()):  # a real file beside the tars
        return path
    return ShardPath(path)


def is_single_shard(path: Path) -> bool:
    """Test whether a file is read from one tar, which may be some of a data set's frames."""
    return isinstance(path, ShardPath) and any(each.suffix == ".tar" for each in path.parents)


def stored_file(path: Path) -> Path | None:
    """File of this machine that holds a path: a tar for one in shards. None: it is on a server."""
    found = _tree_of(Path(str(path))) if isinstance(path, ShardPath) else None
    member = found[0].files.get(found[1]) if found is not None else None
    stored = path if member is None else member.tar
    return None if url_of(stored) is not None else stored


def tar_lengths(path: Path) -> Mapping[Path, int]:
    """Length of each tar of a path's shards by its index; empty: it is in none.

    Raises:
        FileError: The shards are damaged or cannot be read.
    """
    found = _tree_of(Path(str(path)))
    return {} if found is None else found[0].lengths


def shared_tar(path: Path) -> Path | None:
    """Tar of the files that belong to no frame, in the shards of a path; None: it is in none.

    Raises:
        FileError: The shards are damaged or cannot be read.
    """
    plain = Path(str(path))
    found = _tree_of(plain)
    if found is None:
        return None
    depth = len(Path(found[1]).parts)
    root = (plain, *plain.parents)[depth]
    return (root.parent if root.suffix == ".tar" else root) / f"{SHARED}.tar"


_ROOT_PARTS = 2  # of an address without a path: the scheme, and the server or bucket
_remote_trees: dict[Path, ShardTree] = {}


def _tree_of(path: Path) -> tuple[ShardTree, str] | None:
    """Shards in which a path lies, and its place in them.

    Raises:
        FileError: They are damaged or cannot be read, or a server refuses to say if there are any.
    """
    is_remote = url_of(path) is not None
    refusal: RefusedError | None = None
    for opened in (_known_remote_tree, _open_remote_tree) if is_remote else (open_tree,):
        for root in (path, *path.parents):
            try:
                tree = opened(root)
            except RefusedError as error:
                refusal = refusal or error
                continue
            if tree is not None:
                place = path.relative_to(root).as_posix()
                return tree, "" if place == "." else place
    if refusal is not None:
        raise refusal
    return None


def _known_remote_tree(root: Path) -> ShardTree | None:
    """Tree of remote shards that have been opened, or of a tar: each question takes requests."""
    known = _remote_trees.get(root)
    return _open_remote_tree(root) if known is None and root.suffix == ".tar" else known


def _open_remote_tree(root: Path) -> ShardTree | None:
    tree = open_tree(root)
    if tree is not None:
        _remote_trees[root] = tree
    return tree


class ShardPath(PosixPath):
    """Path of a file or folder in shards, as if they were unpacked there; nothing can be written.

    `_tree_of` keeps what it has read, so a path needs no more state than its text and can be sent
    to worker processes.
    """

    __slots__ = ()

    def __format__(self, spec: str) -> str:
        """Format the path for messages: an address with its slashes, and without a password."""
        return format(shown_place(str(self)), spec)

    @property
    def parent(self) -> "ShardPath":
        """Path of the folder above; that of an address's first part is itself, as of a root."""
        is_root = len(self.parts) == _ROOT_PARTS and url_of(Path(str(self))) is not None
        return self if is_root else super().parent

    def _entry(self) -> Member | tuple[str, ...] | None:
        """File, or names in a folder; None: neither."""
        found = _tree_of(Path(str(self)))
        if found is None:
            return None
        tree, place = found
        return tree.files.get(place) or tree.folders.get(place)

    def _file(self) -> Member:
        entry = self._entry()
        if isinstance(entry, Member):
            return entry
        number = errno.ENOENT if entry is None else errno.EISDIR
        raise OSError(number, os.strerror(number), str(self))

    def stat(self, *, follow_symlinks: bool = True) -> os.stat_result:
        """Kind and length; there are no links, times or owners."""
        del follow_symlinks
        entry = self._entry()
        if entry is None:
            raise OSError(errno.ENOENT, os.strerror(errno.ENOENT), str(self))
        mode, size = (stat.S_IFREG, entry.size) if isinstance(entry, Member) else (stat.S_IFDIR, 0)
        return os.stat_result((mode | 0o444, 0, 0, 1, 0, 0, size, 0, 0, 0))

    def exists(self, *, follow_symlinks: bool = True) -> bool:
        """Test whether the shards hold a file or folder of this path."""
        del follow_symlinks
        return self._entry() is not None

    def is_dir(self, *, follow_symlinks: bool = True) -> bool:
        """Test whether the path leads to a folder in the shards."""
        del follow_symlinks
        return isinstance(self._entry(), tuple)

    def is_file(self, *, follow_symlinks: bool = True) -> bool:
        """Test whether the path leads to a file in the shards."""
        del follow_symlinks
        return isinstance(self._entry(), Member)

    def is_symlink(self) -> bool:
        """Shards hold no links."""
        return False

    def is_fifo(self) -> bool:
        """Shards hold no pipes."""
        return False

    def iterdir(self) -> "Iterator[ShardPath]":  # type: ignore[override]
        """Yield the files and folders of a folder, sorted."""
        entry = self._entry()
        if not isinstance(entry, tuple):
            number = errno.ENOENT if entry is None else errno.ENOTDIR
            raise OSError(number, os.strerror(number), str(self))
        return (ShardPath(self, name) for name in entry)

    def glob(self, pattern: Any, **_: Any) -> "Iterator[ShardPath]":  # type: ignore[override]  # noqa: ANN401 - as pathlib's
        """Yield the paths that match a pattern of names, sorted."""
        first, *rest = str(pattern).split("/", 1)
        for each in self.iterdir() if self.is_dir() else ():
            if fnmatchcase(each.name, first):
                yield from each.glob(*rest) if rest else (each,)

    def rglob(self, pattern: Any, **_: Any) -> "Iterator[ShardPath]":  # type: ignore[override]  # noqa: ANN401 - as pathlib's
        """Yield the paths below this folder that match a pattern of names."""
        yield from self.glob(pattern)
        for each in self.iterdir() if self.is_dir() else ():
            if each.is_dir():
                yield from each.rglob(pattern)

    def open(self, mode: str = "r", *_: Any, **__: Any) -> Any:  # noqa: ANN401 - as pathlib's
        """Open a file for reading, in bytes or as UTF-8."""
        self._file()
        if set(mode) - set("rbt"):
            raise OSError(errno.EROFS, "shards cannot be written to", str(self))
        content = self.read_bytes()
        return io.BytesIO(content) if "b" in mode else io.StringIO(content.decode())

    def read_bytes(self) -> bytes:
        """Read a file; one that is damaged cannot be read, as on a disk with checksums.

        The error's number is not that of a broken disk, which is blamed on the folder of a write.
        """
        member = self._file()
        try:
            return member.read()
        except FileError as error:
            reason = f"{member.tar.name} {error.problem.problem}"
            raise OSError(errno.EBADMSG, reason, str(self)) from error
