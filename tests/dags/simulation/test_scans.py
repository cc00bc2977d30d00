"""A folder of scans becomes sequences: which, how they are filmed, and what one that is broken costs the others."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from posegaussian.dags.cli.app import app
from posegaussian.dags.simulation.scans import ScanRig, body_parameters, chosen, find_scans, scene_of
from posegaussian.dags.simulation.simulate import stage_scene
from posegaussian.storage.archive.store import Archive
from posegaussian.storage.model.errors import ConfigError, SourceError
from posegaussian.storage.readers.images import write_png

RIG = ScanRig(cameras=6, held_out=2, size=96, height=1.8, up="y")


def scan(folder: Path, name: str, height: float = 0.7, broken: bool = False) -> None:
    """A box with a picture, `height` of the file's units high, y up."""
    place = folder / name
    place.mkdir(parents=True)
    corners = [(x, y, z) for y in (0, height) for x, z in ((-0.1, -0.1), (0.1, -0.1), (0.1, 0.1), (-0.1, 0.1))]
    faces = ["5 6 2 1", "6 7 3 2", "7 8 4 3", "8 5 1 4", "8 7 6 5", "1 2 3 4"]
    lines = ["mtllib material0.mtl", *(f"v {x} {y} {z}" for x, y, z in corners), "vt 0 0", "vt 1 0", "vt 1 1", "vt 0 1"]
    lines += ["f " + " ".join(f"{v}/{i}" for i, v in enumerate(f.split(), 1)) for f in faces]
    (place / f"{name}.obj").write_text("v 0 0 oops" if broken else "\n".join(lines))
    (place / "material0.mtl").write_text("newmtl a\nmap_Kd material0.png\n")
    write_png(place / "material0.png", np.random.default_rng(0).integers(40, 250, (16, 16, 3), np.uint8))


def test_scans_are_found_by_name_and_parts_of_them_by_their_order(tmp_path: Path) -> None:
    for name in ("0002", "0000", "0001"):
        scan(tmp_path, name)
    (tmp_path / "notes").mkdir()
    found = find_scans(tmp_path)
    assert list(found) == ["0000", "0001", "0002"]
    assert chosen(list(found), "1:") == ["0001", "0002"]
    assert chosen(list(found), ":-1") == ["0000", "0001"]
    assert chosen(list(found), None) == list(found)
    every = [f"{n:04d}" for n in range(526)]
    assert (chosen(every, "gps_train"), chosen(every, "gps_val")) == (every[:426], every[426:])
    for part in ("7:9", "all", "1", "1:2:3"):
        with pytest.raises(SourceError, match=f"scans --part {part}: it is none of the 3 scans"):
            chosen(list(found), part)
    (tmp_path / "0001" / "again.obj").write_text("")
    with pytest.raises(SourceError, match="0001 holds 2 OBJ files"):
        find_scans(tmp_path)
    with pytest.raises(SourceError, match="holds no OBJ file"):
        find_scans(tmp_path / "notes")
    with pytest.raises(SourceError, match="is no folder"):
        find_scans(tmp_path / "nowhere")


def test_parameters_of_a_body_model_are_no_joints_and_that_is_said(tmp_path: Path) -> None:
    """Beside the scans as THuman2.0 has them, or in a scan's own folder; nothing of them is opened."""
    folder = tmp_path / "THuman2.0_Release"
    for name in ("0000", "0001"):
        scan(folder, name)
    found = find_scans(folder)
    assert body_parameters(folder, found) == []
    for name in found:
        place = tmp_path / "THuman2.0_smplx" / name
        place.mkdir(parents=True)
        (place / "smplx_param.pkl").write_bytes(b"no pickle")
    (told,) = body_parameters(folder, found)
    assert told.startswith(
        f"{tmp_path}/THuman2.0_smplx/0000/smplx_param.pkl and 1 more: parameters of SMPL-X hold angles"
    )
    assert "estimated in the films instead: posegaussian models fetch blazepose" in told
    (folder / "0001" / "smplx_param.pkl").write_bytes(b"")
    assert "and 1 more" in body_parameters(folder, {"0001": found["0001"]})[0]


def test_every_scan_is_brought_to_one_height_and_cameras_stand_around_its_middle(tmp_path: Path) -> None:
    for name, height in (("small", 0.58), ("large", 180.0)):
        scan(tmp_path, name, height)
        staged = stage_scene(scene_of(find_scans(tmp_path)[name], RIG), tmp_path)
        vertices = staged.take.actors[0].mesh.vertices
        assert np.ptp(vertices[:, 2]) == pytest.approx(1.8)
        assert staged.sources == 6
        assert len(staged.written) == 8
        assert np.linalg.norm(staged.written.centres[:, :2], axis=1) == pytest.approx(2.0)
        assert staged.written.centres[:, 2] == pytest.approx(0.9)


def test_cameras_that_cannot_be_are_refused(tmp_path: Path) -> None:
    scan(tmp_path, "a")
    with pytest.raises(ConfigError, match="scans: "):
        scene_of(find_scans(tmp_path)["a"], ScanRig(cameras=4, held_out=9, size=96, height=1.8, up="y"))
    with pytest.raises(ConfigError, match=r"scans: .*up"):
        scene_of(find_scans(tmp_path)["a"], ScanRig(cameras=4, held_out=0, size=96, height=1.8, up="upwards"))


def test_one_command_films_all_and_a_broken_one_costs_itself_alone(tmp_path: Path) -> None:
    """Filmed once; what is there is kept, and what failed is said and tried again."""
    folder, archive = tmp_path / "scans", tmp_path / "archive"
    for name, broken in (("0000", False), ("0001", True), ("0002", False)):
        scan(folder, name, broken=broken)
    (folder / "0000" / "smplx_param.pkl").write_bytes(b"")
    words = ["scans", str(folder), "--cameras", "4", "--size", "64", "--data-set", "Twindom", "--archive", str(archive)]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 1, done.output
    told = " ".join(done.output.split())
    assert "0001.obj: line 1" in told
    assert "2 scans in" in told
    assert "1 scan could not be filmed" in told
    assert "parameters of SMPL-X hold angles and no joints" in told
    assert Archive.open(str(archive)).names() == ["0000", "0002"]
    assert Archive.open(str(archive)).sequence("0002").capture.data_set == "Twindom"
    again = " ".join(CliRunner().invoke(app, [*words, "--part", "0:1"]).output.split())
    assert "scan 1 of 1: 0000, which is there" in again
    assert "next: posegaussian run" in again
