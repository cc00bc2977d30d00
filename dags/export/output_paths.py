"""Where a command writes what it was asked for: refused before any work where that cannot be.

A run may take hours before its first file is written, so a name that no writer takes, or a folder that is not there, is
found before the run and not after it.
"""

from __future__ import annotations

import os
from collections.abc import Collection
from pathlib import Path

from posegaussian.storage.model.errors import ConfigError


def output_file(option: str, file: Path, endings: Collection[str]) -> Path:
    """The file of an option such as `--video`. Raises ConfigError for another ending, for a folder, and where it
    cannot be made."""
    if file.suffix.lower() not in endings:
        named = f"ends in {file.suffix}" if file.suffix else "has no ending"
        raise ConfigError(
            f"{option} {file}: its name {named}, it must be {' or '.join(sorted(endings))}; for example"
            f" {file.with_suffix(sorted(endings)[0])}"
        )
    if file.is_dir():
        raise ConfigError(
            f"{option} {file}: there is a folder of that name; name a file, for example"
            f" {file.with_name(f'{file.stem}_1{file.suffix}')}"
        )
    _writable(option, file, file.parent)
    return file


def output_folder(option: str, folder: Path) -> Path:
    """The folder of an option such as `--frames`; it may be new.
    Raises ConfigError for a file, and where it cannot be made."""
    if folder.exists() and not folder.is_dir():
        raise ConfigError(f"{option} {folder}: there is a file of that name; name a folder")
    _writable(option, folder, folder if folder.is_dir() else folder.parent)
    return folder


def _writable(option: str, path: Path, folder: Path) -> None:
    """Raise ConfigError unless something can be made in a folder;
    a folder that is missing may be misspelt and is not made."""
    if not folder.is_dir():
        reason = "is no folder" if folder.exists() else "does not exist"
        raise ConfigError(f"{option} {path}: {folder} {reason}; make it first, or name another place")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise ConfigError(f"{option} {path}: nothing can be written to {folder.resolve()}; name another place")
