"""A stranger's archive: whatever its names, links and descriptions say, no command reads, writes or deletes beside
it, and each says why."""

from __future__ import annotations

import json
import os
import shutil
import time
from collections.abc import Callable, Iterable
from pathlib import Path

import pytest
from typer.testing import CliRunner

from posegaussian.dags.cli.app import app
from posegaussian.storage.archive.records import ATTRIBUTES, write_record
from posegaussian.storage.model.errors import UserError
from tests.support.pipeline import NAME, Pipeline

Spoil = Callable[[Path, Path], object]
"""Of the archive's folder, and of a folder beside it that nobody may touch."""

READING = ("status", "plan", "why", "accept", "export", "run", "gc", "reshard", "verify", "repair")
"""Commands that look at a sequence; `verify --repair` last, because it mends."""


def arguments(command: str, out: Path) -> list[str]:
    return {
        "status": ["status"],
        "failed": ["status", "--failed"],
        "plan": ["plan"],
        "why": ["why", NAME, "depth"],
        "accept": ["accept", NAME, "depth", "--reason", "none"],
        "export": ["export", NAME, "--frames", str(out / "frames")],
        "sheet": ["export", NAME, "--sheet", str(out / "sheet.png")],
        "run": ["run"],
        "work": ["run", "--force", "metrics"],
        "gc": ["gc", "--apply"],
        "reshard": ["reshard", NAME, "--frames", "3"],
        "tradeoff": ["tradeoff", "--knob", "depth.method", "--levels", "depth.method=hull,sgbm", "--output", str(out)],
        "simulate": ["simulate", "single_pair", "--sequence", "filmed"],
        "verify": ["verify"],
        "repair": ["verify", "--repair"],
    }[command]


def say(archive: Pipeline, command: str, out: Path) -> tuple[int, str]:
    """Exit status and all that was said; an error that is no sentence fails the test."""
    done = CliRunner().invoke(app, [*arguments(command, out), *archive.options])
    if isinstance(done.exception, UserError):
        return 2, done.output + str(done.exception)
    assert done.exception is None or isinstance(done.exception, SystemExit), f"{command}: {done.exception!r}"
    return done.exit_code, done.output


def state(folder: Path) -> dict[str, tuple[int, bytes]]:
    """Every file of a folder with time and content."""
    return {
        str(p.relative_to(folder)): (p.lstat().st_mtime_ns, p.read_bytes() if p.is_file() else b"")
        for p in sorted(folder.rglob("*"))
    }


@pytest.fixture
def archive(finished: Pipeline, tmp_path: Path) -> Pipeline:
    return finished.copy(tmp_path / "home/archive")


@pytest.fixture
def outside(tmp_path: Path) -> Path:
    """What must stay as it is: a folder two above every sequence, where climbing names lead."""
    (tmp_path / "out").mkdir()  # exports
    folder = tmp_path / "home/outside"
    (folder / "c/0").mkdir(parents=True)
    (folder / "canary").write_text("mine")
    (folder / "canary.json").write_text("{}")
    (folder / "c/0/0").write_text("mine")
    then = time.time() - 1e6
    for p in [*folder.rglob("*"), folder]:
        os.utime(p, (then, then))
    return folder


def assert_refused(archive: Pipeline, outside: Path, tmp_path: Path, commands: Iterable[str], *phrases: str) -> None:
    for command in commands:
        before = state(outside)
        status, said = say(archive, command, tmp_path / "out")
        assert state(outside) == before, f"{command} changed what is not in the archive: {said}"
        assert status in (1, 2), f"{command} went on: {said}"
        flat = " ".join(said.split())
        assert any(p in flat for p in phrases), f"{command} does not say {phrases}: {said}"


def receipt(root: Path, **changes: object) -> Path:
    """A receipt of another camera path beside those there are, with some entries changed;
    an old one, without a checksum."""
    file = next((root / NAME / "_receipts/rendering").rglob("p000000.json"))
    data = json.loads(file.read_bytes())
    del data["checksum"]
    output = data["outputs"][0]
    output |= {k: v for k, v in changes.items() if k in output}
    output["files"][0] |= {k: v for k, v in changes.items() if k in output["files"][0]}
    data |= {k: v for k, v in changes.items() if k in data}
    target = root / NAME / "_receipts/rendering/arc-01234567/p000000.json"
    target.parent.mkdir(exist_ok=True)
    target.write_text(json.dumps(data))
    return target


def link(place: Path, to: Path) -> None:
    """A symbolic link in the place of a file or folder, which is moved to `to` and goes with it."""
    if place.exists():
        shutil.rmtree(to, ignore_errors=True)
        shutil.move(place, to)
    place.parent.mkdir(parents=True, exist_ok=True)
    place.symlink_to(to, target_is_directory=to.is_dir())


def pipe(place: Path) -> None:
    place.unlink()
    os.mkfifo(place)


NAMES: dict[str, Spoil] = {
    "path that climbs": lambda root, out: receipt(root, path="../../../outside"),
    "stage that climbs": lambda root, out: receipt(root, stage="../../../outside"),
    "absolute key": lambda root, out: receipt(root, key=str(out / "canary")),
    "key that climbs": lambda root, out: receipt(root, key="rendering/../../../outside/canary"),
    "key that climbs below its array": lambda root, out: receipt(
        root, array="rendering/a/color", key="rendering/a/color/c/../../../../../outside/canary"
    ),
    "array that climbs": lambda root, out: receipt(root, array="../../outside", key="../../outside/c/0/0"),
    "key of the record": lambda root, out: receipt(root, key="zarr.json"),
    "key of a description": lambda root, out: receipt(root, array="depth/depth", key="depth/depth/zarr.json"),
    "name of another type": lambda root, out: receipt(root, array=["depth"]),
}
LINKS: dict[str, Spoil] = {
    "sequence": lambda root, out: link(root / NAME, out / "there"),
    "record": lambda root, out: link(root / NAME / "zarr.json", out / "there.json"),
    "receipts": lambda root, out: link(root / NAME / "_receipts", out / "there"),
    "receipts of a stage": lambda root, out: link(root / NAME / "_receipts/depth", out / "there"),
    "receipt": lambda root, out: link(root / NAME / "_receipts/depth/p000000.json", out / "there.json"),
    "array": lambda root, out: link(root / NAME / "depth/depth", out / "there"),
    "group of arrays": lambda root, out: link(root / NAME / "depth", out / "there"),
    "shard": lambda root, out: link(root / NAME / "depth/depth/c.1.2.0.0", out / "there"),
    "table": lambda root, out: link(next((root / NAME / "metrics").rglob("p000001.parquet")), out / "there"),
    "leftover reshard": lambda root, out: link(root / "_reshard", out),
}


@pytest.mark.parametrize("what", NAMES)
def test_names_that_lead_out_are_refused_by_every_command(
    what: str, archive: Pipeline, outside: Path, tmp_path: Path
) -> None:
    NAMES[what](archive.root, outside)
    assert_refused(archive, outside, tmp_path, READING, "was not made by posegaussian", "names what no task writes")
    status, said = say(archive, "verify", tmp_path / "out")
    assert (status, "no faults" in said) == (0, True), f"--repair removes the receipt, and that alone: {said}"


@pytest.mark.parametrize("what", LINKS)
def test_links_are_followed_by_no_command(what: str, archive: Pipeline, outside: Path, tmp_path: Path) -> None:
    LINKS[what](archive.root, outside)
    assert_refused(archive, outside, tmp_path, READING, "is a symbolic link to")


def test_links_among_the_archives_own_folders_are_not_followed(
    archive: Pipeline, outside: Path, tmp_path: Path
) -> None:
    for n in range(25):
        (outside / f"old{n:02d}").mkdir()
    for name, commands in {
        "_runs": ("gc", "work", "failed"),
        "_variants": ("gc", "tradeoff"),
        "_cache": ("status",),
        "_captures": ("simulate",),
    }.items():
        shutil.rmtree(archive.root / name, ignore_errors=True)
        (archive.root / name).symlink_to(outside)
        assert_refused(archive, outside, tmp_path, commands, "is a symbolic link to")
        (archive.root / name).unlink()
    (archive.root / "ledger.parquet").unlink(missing_ok=True)
    (archive.root / "ledger.parquet").symlink_to(outside / "canary")
    assert_refused(archive, outside, tmp_path, ("status",), "is a symbolic link to")


def test_nothing_is_copied_or_filmed_through_a_link(archive: Pipeline, outside: Path, tmp_path: Path) -> None:
    for place in (archive.root / NAME / "_sources/pictures", archive.root / "_captures/filmed/images"):
        place.parent.mkdir(parents=True)
        place.symlink_to(outside)
    before = state(outside)
    for words in (
        ["import", "images", str(archive.folder), "--sequence", NAME, "--copy"],
        ["simulate", "single_pair", "--sequence", "filmed"],
    ):
        done = CliRunner().invoke(app, [*words, "--archive", str(archive.root)])
        assert isinstance(done.exception, UserError), done.output
        assert "is a symbolic link to" in str(done.exception)
        assert state(outside) == before


def test_strays_are_not_looked_for_behind_links(archive: Pipeline, outside: Path, tmp_path: Path) -> None:
    (archive.root / NAME / "rendering/arc-01234567").mkdir()
    for place in ("rendering/arc-01234567/alpha", "depth/depth/c.9.9.0.0", "depth/depth/c"):
        (archive.root / NAME / place).symlink_to(outside)
        assert_refused(archive, outside, tmp_path, ("gc",), "is a symbolic link to")
        (archive.root / NAME / place).unlink()


def test_leases_lead_nowhere(archive: Pipeline, outside: Path, tmp_path: Path) -> None:
    lease = archive.root / NAME / "_receipts/_arrays.lease"
    lease.symlink_to(outside / "canary")
    assert_refused(archive, outside, tmp_path, ("gc", "work", "reshard"), "is a symbolic link to")
    lease.unlink()
    said = {
        "token": "../../../../outside/canary",
        "run": "r",
        "worker": "w",
        "host": "h",
        "boot": "b",
        "pid": 1,
        "started": 0.0,
        "since": 0.0,
        "until": 1.0,
    }
    lease.write_text(json.dumps(said))
    then = time.time() - 1e6
    os.utime(lease, (then, then))
    before = state(outside)
    assert say(archive, "gc", tmp_path)[0] == 0, "one that cannot be a lease ends by its age"
    assert state(outside) == before


@pytest.mark.parametrize(
    "place", ["zarr.json", "_receipts/depth/p000000.json", "depth/depth/zarr.json", "depth/depth/c.1.2.0.0"]
)
def test_a_pipe_in_place_of_a_file_is_not_waited_for(
    place: str, archive: Pipeline, outside: Path, tmp_path: Path
) -> None:
    pipe(archive.root / NAME / place)
    commands = ("verify", "sheet") if place == "depth/depth/zarr.json" else ("status", "gc", "verify")
    assert_refused(archive, outside, tmp_path, commands, "is neither a file nor a folder")


def test_a_camera_whose_name_climbs_is_refused_where_the_record_is_read(
    archive: Pipeline, outside: Path, tmp_path: Path
) -> None:
    file = archive.root / NAME / "zarr.json"
    record = json.loads(file.read_bytes())["attributes"][ATTRIBUTES]
    record["capture"]["rig"]["names"][0] = "../../outside/cam"
    write_record(archive.root / NAME, record)
    assert_refused(archive, outside, tmp_path, READING, "cannot name a folder")


def test_a_camera_whose_name_climbs_is_refused_at_import(person_folder: Path, tmp_path: Path) -> None:
    shutil.copytree(person_folder, tmp_path / "capture")
    file = tmp_path / "capture/cameras.json"
    cameras = json.loads(file.read_text())
    name = cameras["cameras"][0]["name"]
    cameras["cameras"][0]["name"] = f"../images/{name}"
    file.write_text(json.dumps(cameras))
    done = CliRunner().invoke(
        app, ["import", "images", str(tmp_path / "capture"), "--copy", "--archive", str(tmp_path / "archive")]
    )
    assert isinstance(done.exception, UserError), done.output
    assert not list((tmp_path / "archive").glob("*"))


def test_an_array_of_a_stranger_is_named_and_made_anew(archive: Pipeline, outside: Path, tmp_path: Path) -> None:
    file = archive.root / NAME / "depth/depth/zarr.json"
    meta = json.loads(file.read_bytes())
    meta["codecs"][0]["configuration"]["codecs"][1] = {"name": "numcodecs.pickle", "configuration": {}}
    del meta["attributes"]["checksum"]
    file.write_text(json.dumps(meta))
    assert_refused(
        archive,
        outside,
        tmp_path,
        ("sheet", "verify", "repair"),
        "does not describe an array as this program writes it",
        "numcodecs.pickle",
    )
    assert not file.exists()
    assert archive.ran() == {"depth": 3}
    assert say(archive, "verify", tmp_path)[0] == 0


def test_one_strangers_sequence_does_not_keep_the_others_from_running(
    archive: Pipeline, outside: Path, tmp_path: Path
) -> None:
    shutil.copytree(archive.root / NAME, archive.root / "theirs")
    file = archive.root / "theirs/_receipts/depth/p000000.json"
    file.unlink()
    file.symlink_to(outside / "canary.json")
    before = state(outside)
    status, said = say(archive, "work", tmp_path)
    assert status == 1, said
    assert "theirs" in said
    assert "is a symbolic link to" in " ".join(said.split())
    assert "3 done" in said
    assert state(outside) == before
