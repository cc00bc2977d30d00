"""The videos importer: Kalibr's chain, Metashape's XML and RealityCapture's table, each with its own conventions."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from posegaussian.storage.importers.find import find_capture
from posegaussian.storage.model.capture import Capture
from posegaussian.storage.model.errors import UserError
from posegaussian.storage.readers.sources import open_source
from tests.support import ring
from tests.support.import_capture import project
from tests.support.video_clips import counted, counting_clip

NAMES = ("cam0", "cam1", "cam2")
FRAMES = 3
W, H = ring.SIZE


def films(base: Path) -> None:
    base.mkdir(parents=True, exist_ok=True)
    for name in NAMES:
        counting_clip(base / f"{name}.mp4", FRAMES, ring.SIZE)


def kalibr(base: Path, change: Callable[[dict[str, Any]], None] = lambda _: None) -> None:
    """Each camera from the one before: points of camera n-1 to camera n. Four coefficients, no k3."""
    data: dict[str, Any] = {}
    for v, name in enumerate(NAMES):
        k = ring.intrinsics(v)
        data[name] = {
            "camera_model": "pinhole",
            "intrinsics": [float(x) for x in (k[0, 0], k[1, 1], k[0, 2], k[1, 2])],
            "distortion_model": "radtan",
            "distortion_coeffs": ring.DISTORTION[:4].tolist(),
            "resolution": list(ring.SIZE),
            "rostopic": f"/{name}/image",
        }
        if v:
            data[name]["T_cn_cnm1"] = (ring.pose(v) @ np.linalg.inv(ring.pose(v - 1))).tolist()
    change(data)
    lines = [f"{n}:\n" + "".join(f"  {k}: {v}\n" for k, v in camera.items()) for n, camera in data.items()]
    (base / "camchain.yaml").write_text("".join(lines))


def metashape(base: Path, scale: float = 0.5, change: Callable[[str], str] = lambda t: t) -> None:
    """Camera to world in units of `scale` m; the middle of the picture is 0, p1 and p2 are OpenCV's p2 and p1."""
    sensors, cameras = [], []
    k1, k2, p1, p2, k3 = ring.DISTORTION
    for v, name in enumerate(NAMES):
        k = ring.intrinsics(v)
        cx, cy = k[0, 2] + 0.5 - W / 2, k[1, 2] + 0.5 - H / 2
        own = f"<f>{k[1, 1]}</f><cx>{cx}</cx><cy>{cy}</cy><b1>{k[0, 0] - k[1, 1]}</b1>"
        lens = f"<k1>{k1}</k1><k2>{k2}</k2><k3>{k3}</k3><p1>{p2}</p1><p2>{p1}</p2>"
        size = f'<resolution width="{W}" height="{H}"/>'
        sensors.append(
            f'<sensor id="{v}" label="x" type="frame">{size}<calibration type="frame" class="initial">{size}<f>9</f>'
            f'</calibration><calibration type="frame" class="adjusted">{size}{own}{lens}</calibration></sensor>'
        )
        to_world = np.linalg.inv(ring.pose(v))
        to_world[:3, 3] /= scale
        numbers = " ".join(repr(float(x)) for x in to_world.ravel())
        cameras.append(
            f'<camera id="{v}" sensor_id="{v}" component_id="0" label="{name}">'
            f"<transform>{numbers}</transform></camera>"
        )
    text = (
        f'<?xml version="1.0"?><document version="1.5.0"><chunk><sensors>{"".join(sensors)}</sensors><components>'
        f'<component id="0"><transform><scale>{scale}</scale></transform></component></components>'
        f'<cameras>{"".join(cameras)}<camera id="9" sensor_id="0" label="lost"/></cameras></chunk></document>'
    )
    (base / "cameras.xml").write_text(change(text))


def angles(v: int) -> tuple[float, float, float]:
    """(heading, pitch, roll) degrees of a camera; the matrix's entries are Rz(-h) Rx(p) Ry(r) written out."""
    m = np.linalg.inv(ring.pose(v))[:3, :3] @ np.diag([1, -1, -1])
    pitch = np.arcsin(m[2, 1])
    heading = np.arctan2(m[0, 1], m[1, 1])
    roll = np.arctan2(-m[2, 0], m[2, 2])
    return tuple(np.degrees([heading, pitch, roll]).tolist())  # type: ignore[return-value]


def realitycapture(base: Path, change: Callable[[str], str] = lambda t: t) -> None:
    """One focal length a camera, that of v's fx."""
    k1, k2, p1, p2, k3 = ring.DISTORTION
    rows = ["#name,x,y,alt,heading,pitch,roll,f,px,py,k1,k2,k3,k4,t1,t2"]
    for v, name in enumerate(NAMES):
        k = ring.intrinsics(v)
        place = [
            *ring.centre(v), *angles(v), k[0, 0] * 36 / W, (k[0, 2] + 0.5 - W / 2) / W, (k[1, 2] + 0.5 - H / 2) / W,
            k1, k2, k3, 0, p1, p2,
        ]  # fmt: skip
        rows.append(",".join([f"D:\\shots\\{name}.png", *(repr(float(x)) for x in place)]))
    (base / "cameras.csv").write_text(change("\n".join(rows) + "\n"))


def write(base: Path) -> None:
    films(base)
    kalibr(base)


@pytest.fixture
def base(tmp_path: Path) -> Path:
    write(tmp_path)
    return tmp_path


def find(base: Path, **options: object) -> Capture:
    return find_capture("videos", base, options)


def test_a_chain_of_kalibr(base: Path) -> None:
    """The world is that of camera 0, so the point is put there first."""
    capture = find(base)
    assert capture.rig.names == NAMES
    point = ring.pose(0)[:3, :3] @ ring.POINT + ring.pose(0)[:3, 3]
    for v in range(3):
        m = capture.rig.world_to_camera[v]
        np.testing.assert_allclose(m, ring.pose(v) @ np.linalg.inv(ring.pose(0)), atol=1e-6)
        landed = project(capture.rig.intrinsics[v], ring.DISTORTION, m[:3, :3], m[:3, 3], point)
        four = np.append(ring.DISTORTION[:4], 0)
        np.testing.assert_allclose(landed, ring.seen(v, ring.POINT, four) + 0.5, atol=1e-6)
    np.testing.assert_array_equal(capture.rig.distortion[:, :5], [np.append(ring.DISTORTION[:4], 0)] * 3)
    assert [counted(p) for p in open_source(capture, "pictures").read(2, [0, 2])] == [0, 2]
    assert "calibration: camchain.yaml, Kalibr camchain.yaml" in capture.notes
    kalibr(base, lambda d: d["cam1"].update(distortion_model="none"))
    assert not find(base).rig.distortion[1].any()


def test_metashape(tmp_path: Path) -> None:
    films(tmp_path)
    metashape(tmp_path)
    capture = find(tmp_path)
    ring.check_cameras(capture, (0, 1, 2))
    np.testing.assert_allclose(capture.rig.distortion[0, :5], ring.DISTORTION)
    assert "unit: 0.5 m, as the file says" in capture.notes
    metashape(tmp_path, change=lambda t: t.replace("<scale>0.5</scale>", ""))
    ring.check_cameras(find(tmp_path, scale=0.5), (0, 1, 2))
    ring.check_cameras(
        find(tmp_path, distance=f"cam0,cam2,{np.linalg.norm(ring.centre(0) - ring.centre(2))}"), (0, 1, 2)
    )
    assert any("cameras.xml says no unit" in n for n in find(tmp_path).notes)


def test_realitycapture(tmp_path: Path) -> None:
    films(tmp_path)
    realitycapture(tmp_path)
    capture = find(tmp_path)
    for v in range(3):
        np.testing.assert_allclose(capture.rig.world_to_camera[v], ring.pose(v), atol=1e-6)
        k = ring.intrinsics(v)
        expected = [[k[0, 0], 0, k[0, 2] + 0.5], [0, k[0, 0], k[1, 2] + 0.5], [0, 0, 1]]
        np.testing.assert_allclose(capture.rig.intrinsics[v], expected, atol=1e-6)
    np.testing.assert_allclose(capture.rig.distortion[0, :5], ring.DISTORTION)
    assert any("cameras.csv says no unit" in n for n in capture.notes)


def test_a_hint_can_be_pasted_whatever_cameras_are_called(tmp_path: Path) -> None:
    films(tmp_path)
    metashape(tmp_path, change=lambda t: t.replace("<scale>0.5</scale>", "").replace('label="cam', 'label="my cam '))
    for v in range(3):
        (tmp_path / f"cam{v}.mp4").rename(tmp_path / f"my cam {v}.mp4")
    (told,) = [n for n in find(tmp_path).notes if "says no unit" in n]
    words = shlex.split(told[told.index("--option") :])
    assert words[:2] == ["--option", "distance=my cam 0,my cam 2,METRES"]


def test_which_calibration(base: Path) -> None:
    metashape(base)
    with pytest.raises(UserError, match=r"holds 2 calibrations \(camchain.yaml, cameras.xml\); name one with --option"):
        find(base)
    ring.check_cameras(find(base, calibration="cameras.xml"), (0, 1, 2))
    (base / "notes.xml").write_text("<a/>")
    with pytest.raises(UserError, match=r"notes.xml is of no format that is read: Kalibr"):
        find(base, calibration="notes.xml")
    (base / "cam2.mp4").rename(base / "other.mp4")
    notes = find(base, calibration="cameras.xml").notes
    assert "other has no calibration in cameras.xml and is left out" in notes


def test_wrong_conventions_and_broken_files_get_a_sentence(base: Path) -> None:
    def set_of(camera: str, **values: Any) -> Callable[[dict[str, Any]], None]:
        return lambda d: d[camera].update(values)

    millimetres = np.eye(4)
    millimetres[:3, 3] = 3e6
    for change, said in (
        (set_of("cam1", camera_model="omni"), "camera cam1: the model 'omni' with 'radtan' is not read"),
        (
            set_of("cam1", distortion_model="equidistant"),
            "'equidistant' is not read; calibrate with pinhole",
        ),
        (set_of("cam1", T_cn_cnm1=millimetres.tolist()), "is it in millimetres"),
        (set_of("cam1", T_cn_cnm1=np.full((4, 4), 1e300).tolist()), r"T_cn_cnm1 holds 1e\+300; it must be a pose"),
        (set_of("cam1", T_cn_cnm1=[1, 2]), "T_cn_cnm1 has 2 numbers, expected 16"),
        (set_of("cam0", intrinsics=[140, 142, 62, 49]), "are for pictures of another size"),
        (lambda d: d["cam2"].pop("T_cn_cnm1"), "camera cam2 has no T_cn_cnm1"),
    ):
        kalibr(base, change)
        with pytest.raises(UserError, match=said):
            find(base)
    (base / "camchain.yaml").write_text("camera_model: x\n")
    with pytest.raises(UserError, match="has no cameras cam0, cam1"):
        find(base)
    (base / "camchain.yaml").unlink()
    for text, said in (
        (lambda t: t.replace("<k3>", "<k4>0.1</k4><k3>"), "k4 = 0.1 and b2 = 0 px have no place in OpenCV's model"),
        (lambda t: t.replace("<scale>0.5</scale>", "<scale>-1</scale>"), "-1 m in a unit cannot be"),
        (lambda t: t.replace('label="cam1"', 'label="cam0"'), "two cameras are labelled cam0"),
        (lambda t: t.replace('sensor_id="1"', 'sensor_id="7"'), "camera cam1 has no sensor"),
        (lambda t: t.replace('component_id="0" label="cam1"', 'component_id="1" label="cam1"'), "of 2 components"),
        (lambda t: t.replace("<transform>", "<transform>x "), "is not made of numbers"),
        (lambda t: t[:-40], "cannot be read"),
    ):
        metashape(base, change=text)
        with pytest.raises(UserError, match=said):
            find(base)
    (base / "cameras.xml").unlink()
    for text, said in (
        (lambda t: t.replace(",0.0,0.001", ",0.5,0.001"), "k4 = 0.5 has no place in OpenCV's model"),
        (lambda t: t.replace("cam1.png,", "cam1.png,x"), "line 3: x is 'x"),
        (lambda t: t.replace("cam1", "cam0"), "camera 'cam0' needs a name of its own"),
        (lambda t: t.replace(",t1", ",t3"), "lacks the columns t1"),
        (lambda t: t.replace("cam", "shot"), "calibrates shot0, shot1, shot2, and there are cam0, cam1, cam2"),
    ):
        realitycapture(base, text)
        with pytest.raises(UserError, match=said):
            find(base)
    for p in base.glob("*.mp4"):
        p.unlink()
    kalibr(base)
    (base / "cameras.csv").unlink()
    with pytest.raises(UserError, match=r"no NAME\.mp4, videos/NAME\.mp4 or images"):
        find(base)


def test_poses_of_the_other_direction_are_found(tmp_path: Path) -> None:
    films(tmp_path)

    def inverted(text: str) -> str:
        for v in range(3):
            one, other = np.linalg.inv(ring.pose(v)), ring.pose(v)
            texts = [" ".join(repr(float(x)) for x in m.ravel()) for m in (one, other)]
            assert texts[0] in text
            text = text.replace(*texts)
        return text

    metashape(tmp_path, 1.0, inverted)
    with pytest.raises(UserError, match="the poses were written in the other direction"):
        find(tmp_path)


@pytest.mark.parametrize("folder", ["", "videos"])
def test_a_table_of_times_is_not_passed_over_in_silence(tmp_path: Path, folder: str) -> None:
    films(tmp_path / folder)
    kalibr(tmp_path)
    (tmp_path / folder / "timestamps.csv").write_text("cam_id,frame_time\n")
    (said,) = [n for n in find_capture("videos", tmp_path, {}).notes if "timestamps.csv" in n]
    assert said.startswith("timestamps.csv is not read by this layout, so frames are not matched by its times; the")
