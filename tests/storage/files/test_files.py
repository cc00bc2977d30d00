"""Every writer of the project on a disk that fills up, and the one mechanism behind them."""

from __future__ import annotations

import errno
import mmap
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest

from posegaussian.dags.runtime.failures import Kind, failure
from posegaussian.storage.files import write
from posegaussian.storage.files.write import (
    link_or_copy,
    make_folder,
    require_writable,
    scratch_array,
    whole_file,
    write_atomically,
)
from posegaussian.storage.model.errors import NotWritten


def test_an_atomic_write_shows_the_old_content_until_it_is_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "a" / "f.json"
    write_atomically(file, b"old")

    def killed(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(write.os, "replace", killed)
    with pytest.raises(KeyboardInterrupt):
        write_atomically(file, b"new")
    monkeypatch.undo()
    assert file.read_bytes() == b"old"
    write_atomically(file, b"new")
    assert [p.name for p in file.parent.iterdir()] == ["f.json"]
    assert file.read_bytes() == b"new"


@pytest.mark.parametrize(
    ("number", "words"),
    [
        (errno.EROFS, r"the file system is read-only; choose a folder that can be written"),
        (errno.EACCES, r"there is no permission to write in {there}; choose another folder"),
        (errno.ENOENT, r"no file can be made in {there}; choose another folder"),
    ],
)
def test_a_place_that_takes_no_file_is_known_before_anything_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int, words: str
) -> None:
    place = tmp_path / "new" / "archive"
    require_writable(place)
    require_writable(tmp_path)
    assert list(tmp_path.iterdir()) == []

    def refused(dir: Path) -> None:
        raise OSError(number, os.strerror(number), str(dir / "tmp"))

    monkeypatch.setattr(tempfile, "TemporaryFile", refused)
    for folder in (place, tmp_path):
        with pytest.raises(NotWritten, match=f"^cannot write {folder}: {words.format(there=tmp_path)}"):
            require_writable(folder)


def test_a_place_below_a_file(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(NotWritten, match=f"{tmp_path}/file is a file, no folder; name another place"):
        require_writable(tmp_path / "file" / "archive")


@pytest.mark.parametrize(
    ("number", "words"),
    [
        (
            errno.ENOSPC,
            (
                r"the disk is full: [\d.]+ .?B are free in .*, up to 3 bytes are needed; make room there"
                r" .*`posegaussian gc`.* or name a place on another disk"
            ),
        ),
        (errno.EDQUOT, r"your quota of the disk .* is used up; make room"),
        (errno.EROFS, r"the file system is read-only; choose a folder that can be written"),
        (errno.EACCES, r"there is no permission to write in .*; choose another folder"),
        (errno.EIO, r"Input/output error; look at the disk"),
    ],
)
def test_what_the_system_refuses_is_a_sentence_and_changes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int, words: str
) -> None:
    file = tmp_path / "f.json"
    write_atomically(file, b"old")

    def refused(*_: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(write.os, "fsync", refused)
    with pytest.raises(NotWritten, match=f"cannot write {file}: {words}") as e:
        write_atomically(file, b"new")
    with pytest.raises(NotWritten):
        write_atomically(tmp_path / "new" / "deeper" / "f.json", b"new")
    assert e.value.errno == number
    assert [p.name for p in tmp_path.iterdir()] == ["f.json"]
    assert file.read_bytes() == b"old"
    why = failure(e.value)
    assert (why.kind, why.details) == (
        Kind.TRANSIENT if number == errno.EIO else Kind.DETERMINISTIC,
        "",
    ), "a sentence in the table of failures, tried again where that can help"


def test_places_that_cannot_be(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    (tmp_path / "folder").mkdir()
    with pytest.raises(
        NotWritten,
        match=rf"cannot write {tmp_path}/file/a/b.png: {tmp_path}/file is a file, no folder; name another place",
    ):
        write_atomically(tmp_path / "file/a/b.png", b"x")
    with pytest.raises(NotWritten, match=rf"{tmp_path}/file is a file, no folder"):
        make_folder(tmp_path / "file/a")
    with pytest.raises(NotWritten, match=rf"cannot write {tmp_path}/folder: it is a folder; name a file"):
        write_atomically(tmp_path / "folder", b"x")
    with pytest.raises(NotWritten, match=r"its name has 304 bytes .* choose a shorter one"):
        write_atomically(tmp_path / ("n" * 300 + ".png"), b"x")
    write_atomically(tmp_path / ("n" * 250 + ".png"), b"x")
    assert sorted(p.name[:6] for p in tmp_path.iterdir()) == ["file", "folder", "nnnnnn"]


def test_errors_about_other_files_are_left_as_they_are(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError), whole_file(tmp_path / "a.png"):
        (tmp_path / "source.png").read_bytes()
    with pytest.raises(ValueError, match="of another kind"), whole_file(tmp_path / "b" / "a.png"):
        raise ValueError("of another kind")
    assert list(tmp_path.iterdir()) == []


def test_a_link_or_a_copy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a").write_bytes(b"a")
    link_or_copy(tmp_path / "a", tmp_path / "b/c")
    assert (tmp_path / "b/c").samefile(tmp_path / "a")

    def other_disk(*_: object) -> None:
        raise OSError(errno.EXDEV, "other disk")

    monkeypatch.setattr(write.os, "link", other_disk)
    link_or_copy(tmp_path / "a", tmp_path / "b/c")
    assert not (tmp_path / "b/c").samefile(tmp_path / "a")
    assert (tmp_path / "b/c").read_bytes() == b"a"


@pytest.mark.parametrize("asked", [True, False])
def test_room_is_taken_before_anything_is_mapped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, asked: bool) -> None:
    """A page that finds no room when it is first written to ends the process with a signal."""
    taken = []

    def mapped(*arguments: object, **more: object) -> None:
        raise AssertionError("mapped before its room was taken")

    def full(handle: int, *size: object) -> int:
        taken.append(size)
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(write.os, "posix_fallocate", full, raising=False)
    monkeypatch.setattr(write.os, "write", full)
    if not asked:
        monkeypatch.delattr(write.os, "posix_fallocate")
    monkeypatch.setattr(mmap, "mmap", mapped)
    with pytest.raises(NotWritten, match=r"the disk is full: .* up to 2\.4 MB are needed"):
        scratch_array(tmp_path, np.float32, (10, 100, 200, 3))
    assert taken
    monkeypatch.undo()
    array = scratch_array(tmp_path, np.uint8, (3, 5))
    array[1, 2] = 7
    assert array.sum() == 7
    assert list(tmp_path.iterdir()) == []


WRITERS = """
import resource, sys
from pathlib import Path
import numpy as np, pyarrow as pa
from posegaussian.stages.network.card import Card
from posegaussian.storage.archive import checkpoints
from posegaussian.storage.readers import images
from posegaussian.storage.model.errors import UserError
from posegaussian.storage.exporters import contact_sheet, frames, images_layout, video
from posegaussian.storage.formats.splat_ply import write_splats
from posegaussian.storage.model.splats import Splats
root, random = Path(sys.argv[1]), np.random.default_rng(0)
noise = random.integers(0, 256, (96, 96, 3), dtype=np.uint8)
n = 900
splats = Splats(*(random.random(s, np.float32) for s in ((n, 3), (n, 3), (n, 4), (n,), (n, 1, 3))))
pixels = lambda: random.integers(0, 256, (96, 96, 3), dtype=np.uint8)
sheet = contact_sheet.Sheet(None); sheet.begin(); sheet.add_novel("a", noise, noise)
writers = {
    "a.png": lambda f: images.write_png(f, noise),
    "sheet.png": lambda f: contact_sheet.write_sheet(f, sheet),
    "a.exr": lambda f: images.write_exr(f, random.random((96, 96, 3), np.float32)),
    "frames/a/000000.png": lambda f: frames.write_frames(root / "frames", ["a"], [0], [0.0], [("a", 0, noise, None)]),
    "a.mp4": lambda f: video.write_video(f, (pixels() for _ in range(8)), 30),
    "a.ply": lambda f: write_splats(f, splats),
    "checkpoints/00000001.checkpoint": lambda f: checkpoints.write_checkpoint(
        root / "checkpoints", 1, noise.tobytes(), {}
    ),
}
for file in writers:
    old = root / file
    if old.suffix:
        old.parent.mkdir(exist_ok=True, parents=True)
        old.write_bytes(b"old")
before = sorted(p for p in root.rglob("*") if p.is_file())
resource.setrlimit(resource.RLIMIT_FSIZE, (16384, 16384))
for file, write in writers.items():
    try:
        write(root / file)
        print(file, "was written without a word")
    except UserError as e:
        assert "larger than files may become here" in str(e), (file, str(e))
    assert sorted(p for p in root.rglob("*") if p.is_file()) == before, (file, sorted(root.rglob("*")))
    assert not (root / file).suffix or (root / file).read_bytes() == b"old", file
print("all asked")
"""


def test_no_writer_calls_a_short_file_done(tmp_path: Path) -> None:
    """Files may not grow beyond 16 kB: the libraries' own writers meet what they meet on a full disk."""
    done = subprocess.run([sys.executable, "-c", WRITERS, str(tmp_path)], capture_output=True, text=True, check=False)
    assert (done.stdout, done.returncode) == ("all asked\n", 0), done.stdout + done.stderr[-2000:]
