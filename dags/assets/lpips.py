"""The weights of LPIPS: networks from where torchvision publishes them, checked by the hash in their names, and the
linear layers that go with them out of the `lpips` wheel, which is never installed: it needs torchvision.

Nothing in a file is run, neither here nor where it is read (`stages/metrics/measures/lpips_weights.py`).
"""

from __future__ import annotations

import hashlib
import http.client
import json
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import BinaryIO
from urllib.error import URLError
from urllib.request import Request, urlopen

from posegaussian.dags.assets.wheels import LARGEST, Wheel, download, megabytes, member, sha256
from posegaussian.stages.estimators.blazepose_files import cache_folder
from posegaussian.stages.metrics.measures.declaration import WeightFile
from posegaussian.storage.files.write import whole_file
from posegaussian.storage.model.documents import MEGABYTE, read_bytes, reader_of
from posegaussian.storage.model.errors import NotWritten, SourceError

PUBLISHED = "https://download.pytorch.org/models"
"""Folder of torchvision's weights."""
MOST = 1024 * MEGABYTE
"""Bytes of a network's file; VGG16 has half of it."""
PATIENCE = 60.0
"""Seconds without a byte after which a server is given up."""
FETCH = "posegaussian models fetch lpips"
WHEEL = Wheel(
    requirement="lpips==0.1.4",
    file="lpips-0.1.4-py3-none-any.whl",
    sha256="fd537af5828b69d2e6ffc0a397bd506dbc28ca183543617690844c08e102ec5e",
    licence="BSD-2-Clause",
)


@dataclass(frozen=True)
class Published:
    """One file of weights."""

    key: WeightFile
    """As in `metrics.lpips_weights`."""
    name: str
    """File name in the cache folder, and where it is published."""
    sha256: str
    """Hex digest of its content, or the beginning that its name ends with."""
    member: str | None = None
    """Path inside the wheel; None: it is published by itself."""

    def is_it(self, digest: str) -> bool:
        """Whether a file with this digest is the published one."""
        return digest.startswith(self.sha256)


NETWORKS = (
    Published("alex", "alexnet-owt-7be5be79.pth", "7be5be79"),
    Published("vgg", "vgg16-397923af.pth", "397923af"),
)
HEADS = (
    Published(
        "alex_linear",
        "alex.pth",
        "df73285e35b22355a2df87cdb6b70b343713b667eddbda73e1977e0c860835c0",
        "lpips/weights/v0.1/alex.pth",
    ),
    Published(
        "vgg_linear",
        "vgg.pth",
        "a78928a0af1e5f0fcb1f3b9e8f8c3a2a5a3de244d830ad5c1feddc79b8432868",
        "lpips/weights/v0.1/vgg.pth",
    ),
)


def folder() -> Path:
    """Of the files."""
    return cache_folder() / "lpips"


def there() -> dict[WeightFile, tuple[Path, str]]:
    """{file: (its path, its sha256)} of those in the cache that are the published ones."""
    found: dict[WeightFile, tuple[Path, str]] = {}
    for p in (*NETWORKS, *HEADS):
        if (file := folder() / p.name).is_file() and p.is_it(digest := _digest(file)):
            found[p.key] = (file, digest)
    return found


def settings() -> list[str]:
    """`stage.key=value` that name the files which are there; none where none is."""
    found = there()
    values = {
        "metrics.lpips_weights": {key: str(file.resolve()) for key, (file, _) in found.items()},
        "metrics.lpips_sha256": {key: digest for key, (_, digest) in found.items()},
    }
    return [f"{name}={json.dumps(value)}" for name, value in values.items()] if found else []


def listing() -> list[str]:
    """Sentences: which files are there, what is missing or spoilt, and the command that mends it."""
    found = there()
    lines = [f"lpips (AlexNet, VGG16 and what LPIPS lays over them, licence {WHEEL.licence}) in {folder()}"]
    for p in (*NETWORKS, *HEADS):
        file = folder() / p.name
        state = "there" if p.key in found else "spoilt: not the published sha256" if file.is_file() else "missing"
        lines.append(f"  {p.name:28} {state}")
    if len(found) < len(NETWORKS) + len(HEADS):
        lines.append(f"  bring them with `{FETCH}`, or `posegaussian models add FILE` where there is no network")
    return lines


def fetch() -> list[str]:
    """Bring what is missing; returns sentences about what was done, the last of them the settings that name the files.

    Raises SourceError without network, for a wrong hash, of which nothing is kept, or a folder that cannot be written.
    """
    before = there()
    said = []
    if missing := [p for p in HEADS if p.key not in before]:
        with TemporaryDirectory(prefix="posegaussian-models-") as work:
            said += from_wheel(download(WHEEL, Path(work)), missing)
    for p in NETWORKS:
        if p.key not in before:
            said += _bring(p)
    return [*(said or [f"lpips is in {folder()} already, every sha256 is right; nothing was fetched"]), *_how_to_use()]


def from_wheel(wheel: Path, wanted: Sequence[Published] = ()) -> list[str]:
    """Take linear layers, all unless some are named, out of a wheel of lpips. Raises SourceError for one that does not
    hold them."""
    try:
        with reader_of(wheel, "wheel"), zipfile.ZipFile(wheel) as z:
            contents = {p: member(z, p.member or p.name) for p in wanted or HEADS}
    except (zipfile.BadZipFile, KeyError, SourceError) as e:
        raise SourceError(f"{wheel} does not hold LPIPS' linear layers ({e}); {WHEEL.file} does") from e
    for p, content in contents.items():
        if not p.is_it(sha256(content)):
            raise SourceError(
                f"{wheel}: {p.member} has sha256 {sha256(content)}, the published one has {p.sha256}; nothing was kept."
                f" Take it from {WHEEL.file}"
            )
    for p, content in contents.items():
        _put_bytes(p, content)
    return [f"wrote {folder() / p.name}" for p in contents] + [f"licence {WHEEL.licence}: lpips, Richard Zhang"]


def add(file: Path) -> list[str]:
    """Take a file of weights the user has, told by its content, so that its name does not matter. Raises SourceError
    for one that is none of the published."""
    digest = _digest(file)
    for p in (*NETWORKS, *HEADS):
        if p.is_it(digest):
            _put_bytes(p, read_bytes(file, "model", MOST if p in NETWORKS else LARGEST))
            return [f"wrote {folder() / p.name}", *_how_to_use()]
    raise SourceError(
        f"{file} has sha256 {digest}, which is none of LPIPS' files"
        f" ({', '.join(p.name for p in (*NETWORKS, *HEADS))}); take the networks from {PUBLISHED}, the others from"
        f" {WHEEL.file}"
    )


def _bring(p: Published) -> list[str]:
    """A network from where it is published, checked before it takes its name."""
    url = f"{PUBLISHED}/{p.name}"
    sizes: list[int] = []

    def write(partial: Path) -> None:
        request = Request(url, headers={"User-Agent": "posegaussian"})
        with urlopen(request, timeout=PATIENCE) as answer, open(partial, "wb") as f:
            digest = _copied(answer, f, url)
            sizes.append(f.tell())
        if not p.is_it(digest):
            raise SourceError(
                f"{url} gave a file with sha256 {digest}, the published one begins with {p.sha256}, as its name says;"
                " nothing was kept. Try again, or look what stands between this machine and that server"
            )

    try:
        _put(p, write)
    except (URLError, http.client.HTTPException, TimeoutError, ConnectionError) as e:
        reason = getattr(e, "reason", None) or e or type(e).__name__
        raise SourceError(
            f"{url} could not be fetched ({reason}); connect to the network, or bring that file from another machine"
            f" and run `posegaussian models add {p.name}`"
        ) from e
    return [f"fetched {url} ({megabytes(sizes[0])}), its sha256 begins with {p.sha256}: wrote {folder() / p.name}"]


def _copied(source: BinaryIO, target: BinaryIO, url: str) -> str:
    """Copy, and return the sha256. Raises SourceError for more bytes than such a file has."""
    digest, size = hashlib.sha256(), 0
    while block := source.read(MEGABYTE):
        size += len(block)
        if size > MOST:
            raise SourceError(f"{url} gave more than {megabytes(MOST)}; no such file is that large, nothing was kept")
        digest.update(block)
        target.write(block)
    return digest.hexdigest()


def _put(p: Published, write: Callable[[Path], None]) -> None:
    """Have a file of the cache written, whole or not at all."""
    try:
        with whole_file(folder() / p.name) as partial:
            write(partial)
    except NotWritten as e:
        raise SourceError(f"{e}; XDG_CACHE_HOME chooses another place for models") from e


def _put_bytes(p: Published, content: bytes) -> None:
    def write(partial: Path) -> None:
        partial.write_bytes(content)

    _put(p, write)


def _digest(file: Path) -> str:
    with open(file, "rb") as f:
        return hashlib.file_digest(f, "sha256").hexdigest()


def _how_to_use() -> list[str]:
    """What names the files in a configuration; `evaluate` finds them by itself."""
    return [f"--set '{assignment}'" for assignment in settings()]
