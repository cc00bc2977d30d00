"""Wheels that model files are taken out of: downloaded by pip, checked, never installed."""

from __future__ import annotations

import hashlib
import subprocess
import sys
import zipfile
from dataclasses import dataclass
from pathlib import Path

from posegaussian.storage.model.documents import MEGABYTE
from posegaussian.storage.model.errors import SourceError

LARGEST = 64 * MEGABYTE
"""Bytes of a model file in a wheel; a packed one may promise more than memory holds."""


@dataclass(frozen=True)
class Wheel:
    """The wheel that models are taken out of."""

    requirement: str
    """What pip is asked for."""
    file: str
    """The one pinned file's name."""
    sha256: str
    """Hex digest of it."""
    licence: str
    """Under which the models are given."""
    platform: str | None = None
    """Platform tag of the one pinned file, whose contents are used on every platform; None: it is of any."""
    python: str | None = None
    """Python version of the one pinned file."""


def download(wheel: Wheel, work: Path) -> Path:
    """The pinned wheel in the folder `work`, by pip's own client, so that the user's index, proxy and certificates
    count. Raises SourceError without pip or network, and for a wrong sha256."""
    command = [sys.executable, "-m", "pip", "download", "--disable-pip-version-check", "--no-deps"]
    command += ["--only-binary=:all:"]
    command += ["--platform", wheel.platform] if wheel.platform else []
    command += ["--python-version", wheel.python] if wheel.python else []
    done = subprocess.run(
        [*command, "--dest", str(work), wheel.requirement], capture_output=True, text=True, check=False
    )
    found = work / wheel.file
    if done.returncode or not found.is_file():
        reasons = [
            line.removeprefix("ERROR: ") for line in done.stderr.splitlines() if line.startswith("ERROR: ")
        ] or done.stderr.splitlines()[-1:]
        raise SourceError(
            f"pip could not download {wheel.file} (exit status"
            f" {done.returncode}{', ' + reasons[0] if reasons else ''}); connect to a package index, or bring that file"
            f" from another machine and run `posegaussian models add {wheel.file}`"
        )
    if (digest := sha256(found.read_bytes())) != wheel.sha256:
        raise SourceError(
            f"{wheel.file} has sha256 {digest}, the published one has {wheel.sha256}; nothing was kept. Look"
            " which package index pip is configured for (`pip config list`)"
        )
    return found


def member(wheel: zipfile.ZipFile, name: str) -> bytes:
    """A file in a wheel. Raises SourceError for one that is too large, KeyError where there is none."""
    if (size := wheel.getinfo(name).file_size) > LARGEST:
        raise SourceError(f"{name} would be {size} bytes")
    return wheel.read(name)


def sha256(content: bytes) -> str:
    """Hex digest."""
    return hashlib.sha256(content).hexdigest()


def megabytes(size: int) -> str:
    """`2.96 MB`."""
    return f"{size / 1e6:.2f} MB"
