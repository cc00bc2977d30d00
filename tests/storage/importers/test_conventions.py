"""One wrong convention at a time, for the layouts whose files anybody may write: each is refused, said, or harmless.

The tests of data sets and calibration formats have their own, of the same kind.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import pytest

from posegaussian.storage.importers.find import find_capture
from posegaussian.storage.model.capture import Capture
from posegaussian.storage.model.errors import CalibrationError
from tests.storage.importers.test_easymocap import matrix
from tests.storage.importers.test_pose2sim import table
from tests.support import colmap_files, import_capture, ring
from tests.support.video_clips import counting_clip

NUMBERS = (1, 2, 10)
"""Of cameras: as texts 10 comes before 2."""
W, H = ring.SIZE


class Written(NamedTuple):
    """A camera as it is to be written, in the layout's own convention but for what is wrong on purpose."""

    name: str
    k: np.ndarray
    """[3, 3] px, pixel centres at integers."""
    d: np.ndarray
    """[4] k1 k2 p1 p2."""
    pose: np.ndarray
    """[4, 4] world to camera, metres."""


def right(between: str = "") -> list[Written]:
    names = [f"cam{between}{n}" for n in NUMBERS]
    return [Written(n, ring.intrinsics(v), ring.DISTORTION[:4], ring.pose(v)) for v, n in enumerate(names)]


def films(folder: Path, cameras: Sequence[Written]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for c in cameras:
        counting_clip(folder / f"{c.name}.mp4", 2, ring.SIZE)


def pictures(base: Path, cameras: Sequence[Written]) -> None:
    for v, c in enumerate(cameras):
        ring.write_picture(base / "images" / c.name / "000000.png", v, 0)


def images(base: Path, cameras: Sequence[Written]) -> None:
    pictures(base, cameras)
    listed = [
        {"name": c.name, "width": W, "height": H, "K": c.k.tolist(), "distortion": c.d.tolist()}
        | {"R": c.pose[:3, :3].tolist(), "t": c.pose[:3, 3].tolist()}
        for c in cameras
    ]
    (base / "cameras.json").write_text(json.dumps({"pixel_center": "integer", "frame_rate": 30, "cameras": listed}))


def easymocap(base: Path, cameras: Sequence[Written]) -> None:
    pictures(base, cameras)
    head = "%YAML:1.0\n---\nnames:\n" + "".join(f'  - "{c.name}"\n' for c in cameras)
    (base / "intri.yml").write_text(
        head + "".join(matrix(f"K_{c.name}", c.k) + matrix(f"dist_{c.name}", c.d[None]) for c in cameras)
    )
    turns = {c.name: cv2.Rodrigues(c.pose[:3, :3])[0] for c in cameras}
    poses = [matrix(f"R_{c.name}", turns[c.name]) + matrix(f"T_{c.name}", c.pose[:3, 3:]) for c in cameras]
    (base / "extri.yml").write_text(head + "".join(poses))


def tables(cameras: Sequence[Written], name: Callable[[int], str]) -> str:
    out = []
    for v, c in enumerate(cameras):
        turn = cv2.Rodrigues(c.pose[:3, :3])[0].ravel()
        fields = {"matrix": c.k, "distortions": c.d, "rotation": turn, "translation": c.pose[:3, 3]}
        texts = {key: str(value.tolist()) for key, value in fields.items()}
        out.append(table(v, name(v), cam_id=str(NUMBERS[v]), **texts))
    return "".join(out)


def pose2sim(base: Path, cameras: Sequence[Written]) -> None:
    films(base / "videos", cameras)
    (base / "Calib.toml").write_text(tables(cameras, lambda v: f"int_{cameras[v].name}_img"))


def caliscope(base: Path, cameras: Sequence[Written]) -> None:
    films(base, cameras)
    (base / "camera_array.toml").write_text(tables(cameras, lambda v: f"cameras.{NUMBERS[v]}"))


def nerfstudio(base: Path, cameras: Sequence[Written]) -> None:
    pictures(base, cameras)
    frames = []
    for c in cameras:
        own = dict(zip(("k1", "k2", "p1", "p2"), c.d.tolist(), strict=True))
        own |= {"fl_x": c.k[0, 0], "fl_y": c.k[1, 1], "cx": c.k[0, 2] + 0.5, "cy": c.k[1, 2] + 0.5}
        pose = (np.linalg.inv(c.pose) @ np.diag([1, -1, -1, 1])).tolist()
        frames.append({"file_path": f"images/{c.name}/000000.png", "transform_matrix": pose, **own})
    data = {"camera_model": "OPENCV", "w": W, "h": H, "frames": frames}
    (base / "transforms.json").write_text(json.dumps(data))


def colmap(base: Path, cameras: Sequence[Written]) -> None:
    pictures(base, cameras)
    made = {}
    listed = []
    for v, c in enumerate(cameras):
        params = (c.k[0, 0], c.k[1, 1], c.k[0, 2] + 0.5, c.k[1, 2] + 0.5, *c.d)
        made[v + 1] = colmap_files.Camera(colmap_files.OPENCV, ring.SIZE, tuple(map(float, params)))
        turn = colmap_files.quaternion(cv2.Rodrigues(c.pose[:3, :3])[0].ravel())
        place = tuple(c.pose[:3, 3].tolist())
        listed.append(colmap_files.Image(turn, place, v + 1, f"{c.name}/000000.png"))
    colmap_files.WRITE["text"](base / "sparse" / "0", colmap_files.Model(made, listed, np.zeros((0, 3))))


LAYOUTS = {f.__name__: f for f in (images, easymocap, pose2sim, caliscope, nerfstudio, colmap)}
every_layout = pytest.mark.parametrize("layout", LAYOUTS)


def read(base: Path, layout: str, change: Callable[[Written], Written] = lambda c: c, order: int = 1) -> Capture:
    """What is imported of cameras that are each changed in the same way, written in order or the other way round."""
    cameras = [change(c) for c in right("_" if layout == "caliscope" else "")]
    base.mkdir()
    if layout == "caliscope":
        order = 1  # tables go by their numbers
    LAYOUTS[layout](base, cameras[::order])
    return find_capture(layout, base, {})


def landed(capture: Capture) -> np.ndarray:
    """[V, 2] px of the known point."""
    rig = capture.rig
    return np.stack(
        [
            import_capture.project(rig.intrinsics[v], rig.distortion[v], m[:3, :3], m[:3, 3], ring.POINT)
            for v, m in enumerate(rig.world_to_camera)
        ]
    )


def expected() -> np.ndarray:
    return np.stack(
        [import_capture.project(c.k, c.d, c.pose[:3, :3], c.pose[:3, 3], ring.POINT) + 0.5 for c in right()]
    )


@every_layout
def test_the_right_convention_agrees_with_arithmetic(layout: str, tmp_path: Path) -> None:
    capture = read(tmp_path / "a", layout)
    assert [n.removeprefix("cam").removeprefix("_") for n in capture.rig.names] == ["1", "2", "10"]
    np.testing.assert_allclose(landed(capture), expected(), atol=1e-6)


@every_layout
def test_cameras_go_by_name_and_not_by_their_order_in_the_file(layout: str, tmp_path: Path) -> None:
    capture = read(tmp_path / "a", layout, order=-1)
    by_name = dict(zip(capture.rig.names, landed(capture), strict=True))
    for name, place in zip([c.name for c in right("_" if layout == "caliscope" else "")], expected(), strict=True):
        np.testing.assert_allclose(by_name[name], place, atol=1e-6)


@every_layout
def test_camera_to_world_in_the_place_of_world_to_camera_is_refused(layout: str, tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match="the poses were written in the other direction"):
        read(tmp_path / "a", layout, lambda c: c._replace(pose=np.linalg.inv(c.pose)))


@every_layout
def test_millimetres_are_refused(layout: str, tmp_path: Path) -> None:
    def in_mm(c: Written) -> Written:
        pose = c.pose.copy()
        pose[:3, 3] *= 1000
        return c._replace(pose=pose)

    with pytest.raises(
        CalibrationError, match=r"at most 1000 m are plausible|is it in millimetres|metres would be between"
    ):
        read(tmp_path / "a", layout, in_mm)


@every_layout
@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_intrinsics_of_another_size_are_refused_or_said(layout: str, factor: float, tmp_path: Path) -> None:
    def scaled(c: Written) -> Written:
        return c._replace(k=np.diag([factor, factor, 1]) @ c.k)

    try:
        said = read(tmp_path / "a", layout, scaled).notes
    except CalibrationError as e:
        said = (str(e),)
    assert any("for pictures of another size" in n for n in said), said
    assert not any("for pictures of another size" in n for n in read(tmp_path / "b", layout).notes)


@every_layout
def test_half_a_pixel_moves_everything_by_half_a_pixel_and_no_more(layout: str, tmp_path: Path) -> None:
    """No file shows it without points; it is the same in all cameras and all of a camera's pixels."""
    moved = read(tmp_path / "a", layout, lambda c: c._replace(k=c.k + np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])))
    np.testing.assert_allclose(landed(moved) - expected(), 0.5, atol=1e-6)


@every_layout
def test_tangential_coefficients_in_the_other_order_move_nothing_far(layout: str, tmp_path: Path) -> None:
    """2e-3 and less: nowhere over 1/600 of the longer side, as a person's picture hardly shows."""
    swapped = read(tmp_path / "a", layout, lambda c: c._replace(d=c.d[[0, 1, 3, 2]]))
    assert 0 < np.abs(landed(swapped) - expected()).max() < W / 600
