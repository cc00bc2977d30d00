"""Law: importing what `write_capture` wrote gives back every value."""

from __future__ import annotations

import numpy as np
import pytest

from posegaussian.storage.exporters.images_layout import write_capture
from posegaussian.storage.importers.cameras import rotation_matrix
from posegaussian.storage.importers.find import find_capture
from posegaussian.storage.model.cameras import Rig, rigid
from posegaussian.storage.readers.sources import open_source

F, V, H, W = 3, 2, 13, 17
NUMBERS = [4, 5, 9]


@pytest.fixture
def rng():
    return np.random.default_rng(11)


def rig_of(rng: np.random.Generator, size: np.ndarray) -> Rig:
    intrinsics = np.tile(np.eye(3), (V, 1, 1))
    intrinsics[:, [0, 1], [0, 1]] = rng.uniform(20, 30, (V, 2))
    intrinsics[:, :2, 2] = rng.uniform(5, 9, (V, 2))
    pose = np.stack([rigid(rotation_matrix(rng.normal(size=3)), rng.normal(size=3)) for _ in range(V)])
    return Rig(("cam a", "cam-b"), intrinsics, rng.normal(scale=0.01, size=(V, 8)), pose, size)


@pytest.mark.parametrize("hdr", [False, True])
@pytest.mark.parametrize("people", [None, 2])
def test_round_trip(tmp_path, rng, hdr, people):
    rig = rig_of(rng, np.array([[W, H], [W - 4, H - 2]]))
    color = (
        rng.normal(size=(F, V, H, W, 3)).astype(np.float16) if hdr else rng.integers(0, 256, (F, V, H, W, 3), np.uint8)
    )
    mask = rng.integers(0, 256, (F, V, H, W), np.uint8)
    depth = rng.uniform(0, 5, (F, V, H, W)).astype(np.float32)
    joints = rng.uniform(0, 1, (F, V, *(() if people is None else (people,)), 17, 3)) * [W, H, 1]
    joints[0, 0, ..., 5, :] = 0
    write_capture(tmp_path, rig, color, mask, joints, depth, frame_rate=29.97, numbers=NUMBERS)
    capture = find_capture("images", tmp_path, {})
    assert capture.frame_rate == 29.97
    assert capture.numbers.tolist() == NUMBERS
    assert capture.rig.names == rig.names
    np.testing.assert_array_equal(capture.rig.size, rig.size)
    for key in ("intrinsics", "distortion", "world_to_camera"):
        np.testing.assert_allclose(getattr(capture.rig, key), getattr(rig, key), rtol=0, atol=1e-12)
    for v in range(V):
        w, h = rig.size[v]
        for kind, array in (("pictures", color), ("masks", mask), ("depth", depth)):
            back = list(open_source(capture, kind).read(v, NUMBERS))
            np.testing.assert_array_equal(back, array[:, v, :h, :w])
            assert back[0].dtype == array.dtype
        for f, n in enumerate(NUMBERS):
            np.testing.assert_array_equal(
                open_source(capture, "joints").read(v, n), joints[f, v][None] if people is None else joints[f, v]
            )


def test_only_what_is_given_is_written(tmp_path, rng):
    write_capture(tmp_path, rig_of(rng, np.array([[W, H]] * V)), np.zeros((F, V, H, W, 3), np.uint8))
    capture = find_capture("images", tmp_path, {})
    assert capture.numbers.tolist() == [0, 1, 2]
    assert not any(capture.has(k) for k in ("masks", "joints", "joints3d", "depth"))
    with pytest.raises(Exception, match="the capture has no masks"):
        open_source(capture, "masks")


def test_arrays_smaller_than_the_rig_are_refused(tmp_path, rng):
    with pytest.raises(ValueError, match="do not cover 3 frames of 20x13 px of camera cam a"):
        write_capture(tmp_path, rig_of(rng, np.array([[20, H]] * V)), np.zeros((F, V, H, W, 3), np.uint8))
