"""The llff importer: columns down, right, backward; rows in the order of texts; a walk, and sentences."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from posegaussian.storage.importers.cameras import rotation_matrix
from posegaussian.storage.importers.find import find_capture
from posegaussian.storage.model.capture import Capture
from posegaussian.storage.model.errors import UserError
from posegaussian.storage.readers.images import write_png
from posegaussian.storage.readers.sources import open_source
from tests.support import import_capture, ring
from tests.support.video_clips import counting_clip

ORDER = ("cam1", "cam10", "cam2")
"""Of the names as texts."""


def row(v: int, size: tuple[float, float] = import_capture.SIZE) -> np.ndarray:
    """[17] of a camera: [down | right | backward | place | h w f] row by row, near, far."""
    r = rotation_matrix(import_capture.RODRIGUES[v])
    right, down, forward = r
    centre = -r.T @ import_capture.TRANSLATION[v]
    matrix = np.column_stack([down, right, -forward, centre, [size[1], size[0], 70.0 + v]])
    return np.concatenate([matrix.reshape(-1), [1.0, 9.0]])


def poses(names: tuple[str, ...] = ORDER) -> np.ndarray:
    return np.stack([row(import_capture.NAMES.index(n)) for n in names])


@pytest.fixture
def base(tmp_path: Path) -> Path:
    np.save(tmp_path / "poses_bounds.npy", poses())
    import_capture.pictures(tmp_path / "images")
    return tmp_path


def find(base: Path, **options: object) -> Capture:
    return find_capture("llff", base, options)


def expected(v: int) -> np.ndarray:
    """Where the known point lands, our centres: no distortion, the principal point in the middle."""
    k = np.array([[70.0 + v, 0, 32.0], [0, 70.0 + v, 24.0], [0, 0, 1]])
    rotation = rotation_matrix(import_capture.RODRIGUES[v])
    return import_capture.project(k, np.zeros(4), rotation, import_capture.TRANSLATION[v], import_capture.POINT)


def test_the_known_point_lands_where_arithmetic_says(base: Path) -> None:
    capture = find(base)
    assert capture.rig.names == ORDER
    pixels = import_capture.imported_pixels(capture.rig)
    for own, name in enumerate(ORDER):
        v = import_capture.NAMES.index(name)
        np.testing.assert_allclose(pixels[own], expected(v), atol=1e-11)  # float64 rounding of ~60 px
        assert int(next(iter(open_source(capture, "pictures").read(own, [1])))[0, 0, 0]) == 10 + v
    assert any("names sorted as texts have cam10 behind cam1" in n for n in capture.notes)
    assert any("unit: taken as metres" in n for n in capture.notes)


@pytest.mark.parametrize("folder", [".", "videos"])
def test_videos_as_dynerf_has_them(tmp_path: Path, folder: str) -> None:
    np.save(tmp_path / "poses_bounds.npy", poses())
    (tmp_path / folder).mkdir(exist_ok=True)
    for name in ORDER:
        counting_clip(tmp_path / folder / f"{name}.mp4", 4, import_capture.SIZE, rate=30)
    capture = find(tmp_path)
    assert (capture.rig.names, len(capture.numbers), capture.frame_rate) == (ORDER, 4, 30)


def test_world_to_camera_in_the_place_of_camera_to_world_is_refused(tmp_path: Path) -> None:
    def of(matrix: np.ndarray) -> np.ndarray:
        """[17] of a pose [3, 4] with columns right, down, forward, place."""
        right, down, forward, place = matrix.T
        rows = np.column_stack([down, right, -forward, place, [ring.SIZE[1], ring.SIZE[0], 70.0]])
        return np.concatenate([rows.reshape(-1), [1.0, 9.0]])

    for v in range(3):
        ring.write_picture(tmp_path / "images" / f"cam{v}.png", v, 0)
    to_world = [np.linalg.inv(ring.pose(v))[:3] for v in range(3)]
    np.save(tmp_path / "poses_bounds.npy", np.stack([of(m) for m in to_world]))
    rig = find(tmp_path, moment=True).rig
    np.testing.assert_allclose(rig.world_to_camera, [ring.pose(v) for v in range(3)], atol=1e-9)
    np.save(tmp_path / "poses_bounds.npy", np.stack([of(ring.pose(v)[:3]) for v in range(3)]))
    with pytest.raises(UserError, match="the poses were written in the other direction"):
        find(tmp_path, moment=True)


def test_a_walk_is_refused_unless_it_is_an_instant(tmp_path: Path) -> None:
    rows = np.stack([row(0) for _ in range(10)])
    rows[:, 3] += 0.1 * np.arange(10)
    np.save(tmp_path / "poses_bounds.npy", rows)
    (tmp_path / "images").mkdir()
    for n in range(10):
        write_png(tmp_path / "images" / f"IMG_{n:04d}.png", np.zeros((48, 64, 3), np.uint8))
    with pytest.raises(UserError, match="one camera that was carried through a scene"):
        find(tmp_path)
    assert len(find(tmp_path, moment=True).rig) == 10


def opengl(rows: np.ndarray) -> np.ndarray:
    """[right | up | backward] in the place of [down | right | backward]."""
    out = rows.copy()
    m = out[:, :15].reshape(-1, 3, 5)
    m[:, :, :2] = np.stack([m[:, :, 1], -m[:, :, 0]], axis=2)
    return out


def test_axes_of_another_order_turn_the_picture_and_nothing_else(base: Path) -> None:
    """Provably harmless to where cameras stand and look; the picture's turn shows in `inspect`."""
    right = find(base).rig
    np.save(base / "poses_bounds.npy", opengl(poses()))
    turned = find(base).rig
    np.testing.assert_allclose(turned.centres, right.centres, atol=1e-12)
    np.testing.assert_allclose(turned.rotations[:, 2], right.rotations[:, 2], atol=1e-12)


WRONG = {
    "rows": (poses()[:2], "has 2 rows, and there are 3 cameras"),
    "columns": (poses()[:, :15], r"shape \(3, 15\); \[cameras, 17\]"),
    "not finite": (np.where(np.arange(17) == 3, np.nan, poses()), "row 0 holds a number that is not finite"),
    "millimetres": (np.where(np.isin(np.arange(17), (3, 8, 13)), 1000 * poses(), poses()), "metres would be between"),
    "mirrored": (np.where(np.isin(np.arange(17), (0, 5, 10)), -poses(), poses()), "or mirrored"),
    "far": (np.where(np.arange(17) == 3, 1e300, poses()), "must be finite and within"),
    "focal": (np.where(np.arange(17) == 14, 1e12, poses()), "focal length fx"),
    "size": (np.where(np.arange(17) == 4, 48.5, poses()), "must be whole numbers"),
    "pickle": (np.array({"a": 1}, dtype=object), "arrays of objects are pickles"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_input_gets_a_sentence(base: Path, case: str) -> None:
    array, sentence = WRONG[case]
    np.save(base / "poses_bounds.npy", array, allow_pickle=True)
    with pytest.raises(UserError, match=sentence):
        find(base)
