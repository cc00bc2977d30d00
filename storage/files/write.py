"""Files that are written for good: beside their place, whole, on disk, and only then under their name. There is no
other way.

So a full disk, a kill or a power cut leaves the old file or the new one, never an empty or a cut one. What raises, as
Ctrl-C and SIGTERM do in a command, leaves nothing beside it; what ends the process at once (SIGKILL or another signal
that nobody catches, a second Ctrl-C, a power cut) leaves the half written file there, hidden, as `.NAME...partial`.
What the system says is told as a sentence: which file, why, how much is free and needed, what to do (`NotWritten`).
"""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NoReturn
from uuid import uuid4

import numpy as np

from posegaussian.storage.files.names import files_below
from posegaussian.storage.model.errors import NotWritten

PARTIAL = ".partial"
"""Ending of what is not whole yet; `posegaussian.storage.archive.deletion` finds what a kill leaves of it."""

FULL = frozenset({errno.ENOSPC, errno.EDQUOT})
"""Errors that pass when something is deleted."""

_NAME_BYTES = 255
"""Longest name of a file that common file systems take."""

_ZEROS = bytes(2**20)


def write_atomically(path: Path, data: bytes | memoryview) -> None:
    """Write a file so that a reader sees the old one or the new one,
    and that a power cut does not lose it. Raises NotWritten."""
    with whole_file(path, len(data)) as partial, open(partial, "wb") as f:
        f.write(data)


@contextlib.contextmanager
def whole_file(path: str | Path, need: int | None = None) -> Iterator[Path]:
    """A path to write to within the block, by whatever writes to paths; at its end the file is synced and takes its
    name.

    Folders above it are made. Where the block raises, nothing is left and an earlier file stays; a writer that does not
    raise when it fails is for the block to check.

    Args:
        path: where the file is to be.
        need: bytes it will take at most, where they are known.

    Raises:
        NotWritten: where the system does not take it.
    """
    path = Path(path)
    partial = path.with_name(f".{path.name[:40]}.{os.getpid()}.{uuid4().hex[:8]}{PARTIAL}")
    made: list[Path] = []
    try:
        with refusals(path, need, partial):
            if path.is_dir():
                raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
            made += _make(path.parent)
            yield partial
            with open(partial, "rb+") as f:
                os.fsync(f.fileno())
            os.replace(partial, path)
            for folder in (path.parent, *(f.parent for f in made)):
                sync_folder(folder)
    except BaseException:
        with contextlib.suppress(OSError):
            partial.unlink(missing_ok=True)
        for folder in made:
            with contextlib.suppress(OSError):  # somebody else may use it by now
                folder.rmdir()
        raise


def make_folder(folder: Path) -> None:
    """Make a folder and those above it, where they are not there. Raises NotWritten."""
    with refusals(folder):
        folder.mkdir(parents=True, exist_ok=True)


def require_writable(folder: Path) -> None:
    """Raise NotWritten unless files can be made in a folder, or, where it is not there yet, in what it would lie in.

    A file without a name is made, which goes at once: what permissions say is not true of every file system.
    """
    from tempfile import TemporaryFile

    above = next((f for f in (folder, *folder.parents) if os.path.lexists(f)), Path())
    try:
        TemporaryFile(dir=above).close()
    except OSError as e:
        raise NotWritten(e.errno or errno.EIO, _sentence(e, folder, None, None, above)) from e


def _make(folder: Path) -> list[Path]:
    """Make a folder and those above it; returns those that were made, deepest first."""
    made = [f for f in (folder, *folder.parents) if not f.is_dir()]
    folder.mkdir(parents=True, exist_ok=True)
    return made


def sync_folder(folder: Path) -> None:
    """Make renames inside a folder survive a power cut."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def link_or_copy(source: Path, target: Path) -> None:
    """A hard link in the place of `target`, or a copy where the file system has none or the two are on different ones.

    For files that are replaced, never written in place. Raises NotWritten.
    """
    with refusals(target):
        _make(target.parent)
        target.unlink(missing_ok=True)
        try:
            os.link(source, target)
        except OSError as e:
            if e.errno not in (errno.EXDEV, errno.EPERM, errno.EMLINK, errno.ENOTSUP, errno.EOPNOTSUPP):
                raise
        else:
            return
    with whole_file(target, source.stat().st_size) as partial:
        shutil.copyfile(source, partial)


def link_tree(source: Path, target: Path) -> None:
    """`link_or_copy` of every file below a folder. Raises NotWritten, and Unsafe for a symbolic link among them."""
    for file in map(Path, files_below(source)):
        link_or_copy(file, target / file.relative_to(source))


def scratch_array(folder: Path, dtype: Any, shape: tuple[int, ...]) -> np.ndarray:
    """Zeros in a file without a name in `folder`, which goes with the array; its room is taken at once.

    Without that a full disk is noticed by the first write to a page that has no place, which the system answers with a
    signal that ends the process. Raises NotWritten.
    """
    from tempfile import TemporaryFile

    size = int(np.prod(shape)) * np.dtype(dtype).itemsize
    with refusals(folder, size), TemporaryFile(dir=folder) as f:
        _take_room(f.fileno(), size)
        return np.memmap(f, dtype, "r+", shape=shape)


def _take_room(handle: int, size: int) -> None:
    """Have the file system give a file all its blocks; where it cannot be asked, zeros are written."""
    if size and hasattr(os, "posix_fallocate"):
        try:
            os.posix_fallocate(handle, 0, size)
            return
        except OSError as e:
            if e.errno not in (errno.EOPNOTSUPP, errno.ENOTSUP, errno.EINVAL):
                raise
    _fill(handle, size)


def _fill(handle: int, size: int) -> None:
    for start in range(0, size, len(_ZEROS)):
        left = memoryview(_ZEROS)[: size - start]
        while left:
            left = left[os.write(handle, left) :]


def ask_why(partial: Path, size: int, told: str) -> NoReturn:
    """Raise the OSError that kept a library from writing `size` bytes: the library says only that it failed, the system
    says why.

    The bytes are written once more, as zeros, to a file that is going to be deleted. `told`: what the library said.
    """
    with open(partial, "wb") as f:
        _fill(f.fileno(), size)
        os.fsync(f.fileno())
    raise OSError(errno.EIO, told)


@contextlib.contextmanager
def refusals(path: str | Path, need: int | None = None, partial: Path | None = None) -> Iterator[None]:
    """Within, an OSError about `path`, or about what is below or above it, becomes a NotWritten that says what to do.

    One about another file goes on as it is. `partial`: what is written in the place of `path`.
    """
    path = Path(path)
    try:
        yield
    except NotWritten:
        raise
    except OSError as e:
        if e.errno is None or not _about(e, path):
            raise
        raise NotWritten(e.errno, _sentence(e, path, need, partial)) from e


def _about(error: OSError, path: Path) -> bool:
    """Whether an error is about a path, what is half written in its place, a file below it or a folder above it."""
    told = [Path(f) for f in (error.filename, error.filename2) if isinstance(f, str | os.PathLike)]
    return not told or any(
        f == path or path in f.parents or f in path.parents or (f.parent == path.parent and f.suffix == PARTIAL)
        for f in told
    )


def _sentence(error: OSError, path: Path, need: int | None, partial: Path | None, above: Path | None = None) -> str:
    number, above = error.errno, above or next((f for f in path.parents if os.path.lexists(f)), Path())
    if number in FULL:
        return f"cannot write {path}: {_full(number, above, need, partial)}"
    if number in (errno.ENOTDIR, errno.EEXIST):
        return f"cannot write {path}: {above} is a file, no folder; name another place, or move that file away"
    if number == errno.ENAMETOOLONG:
        return (
            f"cannot write {path.parent / path.name[:20]}...: its name has {len(os.fsencode(path.name))} bytes and its"
            f" path {len(os.fsencode(path))}, file systems take {_NAME_BYTES} and some 4000; choose a shorter one"
        )
    why = {
        errno.EROFS: ("the file system is read-only", "choose a folder that can be written"),
        errno.EACCES: (
            f"there is no permission to write in {above}",
            "choose another folder, or have its owner allow it",
        ),
        errno.EPERM: (
            f"there is no permission to write in {above}",
            "choose another folder, or have its owner allow it",
        ),
        errno.ENOENT: (f"no file can be made in {above}", "choose another folder"),
        errno.EISDIR: ("it is a folder", "name a file, or move the folder away"),
        errno.EFBIG: (
            f"it is larger than files may become here{'' if need is None else f', about {_bytes(need)}'}",
            "see `ulimit -f`, or name another disk",
        ),
    }.get(number or 0, (str(error.strerror or error), f"look at the disk that holds {above}, then do it again"))
    return f"cannot write {path}: {why[0]}; {why[1]}"


def _full(number: int | None, folder: Path, need: int | None, partial: Path | None) -> str:
    """What is used up, how much is left and needed, and what to do."""
    advice = "make room there (of an archive `posegaussian gc` says what could go), or name a place on another disk"
    if number == errno.EDQUOT:
        return f"your quota of the disk that holds {folder} is used up; {advice}"
    stat = os.statvfs(folder)
    if stat.f_files and not stat.f_favail:
        return f"the disk that holds {folder} has no room for another file, however small (no free inodes); {advice}"
    free = stat.f_bavail * stat.f_frsize
    if partial is not None:
        with contextlib.suppress(OSError):
            free += partial.stat().st_blocks * 512  # goes with the half written file
    wanted = f", up to {_bytes(need)} are needed" if need is not None else ""
    return f"the disk is full: {_bytes(free)} are free in {folder}{wanted}; {advice}"


def _bytes(count: int) -> str:
    for unit, size in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if count >= size:
            return f"{count / size:.1f} {unit}"
    return f"{count} bytes"
