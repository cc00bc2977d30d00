"""Names that an archive holds, and where they lead: checked here, before anything is read, written or deleted there.

An archive may come from a stranger, and every name in it is a claim. A name is taken as one plain part of a path, a key
as several of them, and a place is used only where no symbolic link lies on the way to it: so whatever an archive says,
nothing beside it is touched. The archive's own folder, which the user names, may be reached through links.
"""

from __future__ import annotations

import errno
import json
import os
import re
import stat
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from posegaussian.storage.model.errors import ArchiveError, CalibrationError

MOST_NAME_BYTES = 100
"""Bytes of the name of a camera or a sequence: folders and files are named after them."""

SMALL_BYTES = 2**20
"""A file of so many bytes is read by one call."""

FORBIDDEN = '/\\:*?"<>|'
"""Characters that no name of a camera or a sequence holds: some file system takes them for something else."""

WORD = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.\-]{0,126}")
"""A name that the program gave itself: of a stage, a camera path, a part of an array's name."""


class Unsafe(ArchiveError):
    """A name or a link in an archive that would lead out of it, or to something that is no file."""


def name_fault(name: Any) -> str | None:
    """Why something cannot be the name of a camera or a sequence; None where it can."""
    if not isinstance(name, str) or not name.strip():
        return "it is empty"
    if name.startswith("."):
        return "it starts with a dot"
    if not name.isprintable() or any(c in name for c in FORBIDDEN):
        return f"it holds one of {' '.join(FORBIDDEN)} or what cannot be printed"
    if len(name.encode()) > MOST_NAME_BYTES:
        return f"it is longer than {MOST_NAME_BYTES} bytes"
    return None


def check_camera_names(names: Iterable[Any]) -> None:
    """Raise CalibrationError for a camera whose name cannot be that of a folder:
    exports and captures make one for each."""
    for name in names:
        why = name_fault(name)
        if why is not None:
            raise CalibrationError(
                f"camera name {str(name)[:200]!r} cannot name a folder: {why}; use letters, digits, '-', '_' and '.'"
            )


def is_word(name: Any) -> bool:
    """Whether something may be a name that the program gave: letters, digits, `_`, `.`, `-`, no dot first."""
    return isinstance(name, str) and WORD.fullmatch(name) is not None


def below(root: Path, key: str) -> Path:
    """The place `root`/`key`; it may not be there yet.

    Raises Unsafe for a key that is absolute or climbs, for a symbolic link on the way below `root`, and for what is
    neither file nor folder.
    """
    parts = key.split("/")
    if any(p in ("", ".", "..") or "\\" in p or not p.isprintable() for p in parts):
        raise Unsafe(
            f"archive folder {root}: {key[:200]!r} is no place in it: it is absolute, climbs or holds what no name"
            " holds; the archive was not made by posegaussian alone, so do not work on it"
        )
    place = str(root)
    for i, part in enumerate(parts):
        place = f"{place}/{part}"
        try:
            mode = os.lstat(place).st_mode
        except FileNotFoundError:
            break
        refuse_link(place, mode)
        if not stat.S_ISDIR(mode) and i < len(parts) - 1:
            raise Unsafe(f"{place} is a file, where the archive has a folder for {key}; take it away")
    return root / key


def refuse_link(place: str, mode: int) -> None:
    """Raise Unsafe for a symbolic link and for what is neither file nor folder, by its mode."""
    if stat.S_ISLNK(mode):
        raise Unsafe(
            f"{place} is a symbolic link to {os.readlink(place)[:200]!r}: an archive is followed nowhere but into its"
            " own folder, so nothing was read, written or deleted there;"
            " put what it points to in its place, or take it away"
        )
    if not stat.S_ISDIR(mode) and not stat.S_ISREG(mode):
        raise Unsafe(f"{place} is neither a file nor a folder; an archive holds nothing else, so take it away")


def files_below(folder: Path | str) -> Iterator[str]:
    """Paths of all files below a folder that may not be there, in the order of names, a folder's files before its
    folders. Raises Unsafe."""
    todo = [str(folder)]
    while todo:
        here = todo.pop()
        try:
            refuse_link(here, os.lstat(here).st_mode)
            with os.scandir(here) as scan:
                entries = sorted(scan, key=lambda e: e.name)
        except FileNotFoundError:
            continue  # a run that goes on meanwhile removed it
        folders = []
        for entry in entries:
            if entry.is_dir(follow_symlinks=False):
                folders.append(entry.path)
                continue
            if not entry.is_file(follow_symlinks=False):
                try:
                    refuse_link(entry.path, os.lstat(entry.path).st_mode)
                except FileNotFoundError:
                    continue
            yield entry.path
        todo += reversed(folders)


def refuse_links(folder: Path) -> None:
    """Raise Unsafe for a symbolic link anywhere below a folder that may not be there, before it is written into."""
    for _ in files_below(folder):
        pass


def folders_in(folder: Path) -> list[Path]:
    """The folders directly in a folder that may not be there, sorted. Raises Unsafe for a link among them."""
    try:
        refuse_link(str(folder), os.lstat(folder).st_mode)
        found = sorted(folder.iterdir())
    except FileNotFoundError:
        return []
    for p in found:
        if p.is_symlink():
            refuse_link(str(p), os.lstat(p).st_mode)
    return [p for p in found if p.is_dir()]


def read_file(file: Path | str, most: int) -> bytes:
    """The bytes of a file of at most `most` bytes.
    Raises Unsafe for a link, for no file and for a larger one, and OSError."""
    try:
        handle = os.open(file, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as e:
        if e.errno in (errno.ELOOP, errno.ENXIO):
            refuse_link(str(file), os.lstat(file).st_mode)
        raise
    try:
        found = os.fstat(handle)
        if not stat.S_ISREG(found.st_mode):
            refuse_link(str(file), found.st_mode)
            raise Unsafe(f"{file} is a folder, where the archive has a file; take it away")
        if found.st_size > most:
            raise Unsafe(
                f"{file} has {found.st_size} bytes, such a file has at most {most};"
                " it was not made by posegaussian, so take it away"
            )
        data = os.read(handle, found.st_size + 1)
        if len(data) <= found.st_size <= SMALL_BYTES:
            return data
        with open(
            handle, "rb", closefd=False
        ) as f:  # a large one comes in pieces, and one that grows meanwhile is read on
            return data + f.read()
    finally:
        os.close(handle)


def parse_json(text: bytes) -> Any:
    """The value of a JSON text. Raises ValueError, also for one that is nested too deep."""
    try:
        return json.loads(text)
    except RecursionError:
        raise ValueError("it is nested too deep") from None


class FileSizes:
    """One look at the files of a folder: every folder on the way to them is looked at once.
    Keys are those of receipts, checked."""

    def __init__(self, root: Path) -> None:
        """Nothing is looked at yet."""
        self._root = str(root)
        self._known = {""}

    def size(self, key: str) -> int:
        """Bytes of a file; -1 where there is none. Raises Unsafe for a link on the way to it or in its place."""
        folder = key.rpartition("/")[0]
        if folder not in self._known and not self._has(folder):
            return -1
        place = f"{self._root}/{key}"
        try:
            found = os.lstat(place)
        except FileNotFoundError:
            return -1
        if stat.S_ISREG(found.st_mode):
            return found.st_size
        refuse_link(place, found.st_mode)
        return -1

    def _has(self, folder: str) -> bool:
        """Whether a folder is there, and those above it; each is then known."""
        above = folder.rpartition("/")[0]
        if above not in self._known and not self._has(above):
            return False
        place = f"{self._root}/{folder}"
        try:
            mode = os.lstat(place).st_mode
        except FileNotFoundError:
            return False
        refuse_link(place, mode)
        if stat.S_ISDIR(mode):
            self._known.add(folder)
        return stat.S_ISDIR(mode)
