"""The people_snapshot importer: a pickle of Python 2, arrays with a row a frame, streams that differ by one."""

from __future__ import annotations

import os
import pickle
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from posegaussian.storage.importers.find import find_capture
from posegaussian.storage.model.capture import Capture
from posegaussian.storage.model.errors import UserError
from posegaussian.storage.model.joint_sets import joint_set
from posegaussian.storage.readers.sources import open_source
from tests.support import ring
from tests.support.video_clips import counted, counting_clip

FRAMES = 4
SIDE = 48
OPENPOSE = (
    "Nose Neck RShoulder RElbow RWrist LShoulder LElbow LWrist RHip RKnee RAnkle LHip LKnee LAnkle REye LEye REar LEar"
)
CAMERA = {
    "camera_t": np.zeros(3),
    "camera_rt": np.zeros(3),
    "camera_f": np.array([90.0, 91.0]),
    "camera_c": np.array([24.0, 23.5]),
    "camera_k": np.array([-0.1, 0.05, 1e-3, -2e-3, 0.01]),
    "width": SIDE,
    "height": SIDE,
}


def mask(n: int) -> np.ndarray:
    return ring.mask(0, n, 1, (SIDE, SIDE)).astype(np.int8)


def keypoints(n: int) -> np.ndarray:
    """[18, 3] (x, y, score)."""
    return np.array([[1.5 * j, 2.0 * j + n, 0.5] for j in range(18)])


def write(base: Path, masks: int = FRAMES, camera: Any = CAMERA) -> None:
    base.mkdir(parents=True, exist_ok=True)
    counting_clip(base / "male-1-casual.mp4", FRAMES, (SIDE, SIDE))
    (base / "camera.pkl").write_bytes(pickle.dumps(camera, 2))
    with h5py.File(base / "masks.hdf5", "w") as f:
        f.create_dataset("masks", data=np.stack([mask(n) for n in range(masks)]), compression="lzf")
    with h5py.File(base / "keypoints.hdf5", "w") as f:
        f["keypoints"] = np.stack([keypoints(n).ravel() for n in range(FRAMES)])
    (base / "reconstructed_poses.hdf5").write_bytes(b"not read")


@pytest.fixture
def base(tmp_path: Path) -> Path:
    write(tmp_path)
    return tmp_path


def find(base: Path, **options: object) -> Capture:
    return find_capture("people_snapshot", base, options)


def test_camera_pictures_masks_and_joints_are_those_of_the_files(base: Path) -> None:
    capture = find(base)
    assert (capture.rig.names, capture.numbers.tolist(), capture.frame_rate) == (("male-1-casual",), [0, 1, 2, 3], 30)
    np.testing.assert_allclose(capture.rig.intrinsics[0], [[90, 0, 24.5], [0, 91, 24], [0, 0, 1]], atol=1e-12)
    np.testing.assert_array_equal(capture.rig.distortion[0, :5], CAMERA["camera_k"])
    np.testing.assert_array_equal(capture.rig.world_to_camera[0], np.eye(4))
    assert [counted(p) for p in open_source(capture, "pictures").read(0, [1, 3])] == [1, 3]
    for n, found in zip([0, 3], open_source(capture, "masks").read(0, [0, 3]), strict=True):
        np.testing.assert_array_equal(found, 255 * mask(n).astype(int))
    joints = open_source(capture, "joints").read(0, 2)
    for name, (x, y, score) in zip(joint_set("coco17").names, joints[0], strict=True):
        expected = keypoints(2)[OPENPOSE.split().index(name)]
        np.testing.assert_allclose((x, y, score), [*(expected[:2] + 0.5), 0.5], err_msg=name)
    assert any("one camera only" in n for n in capture.notes)


def test_files_of_python_2_are_read(base: Path) -> None:
    """Its pickles name numpy.core and hold numbers of arrays as texts; see also the tests of the pickles themselves."""
    raw = pickle.dumps(CAMERA, 2).replace(b"cnumpy._core.", b"cnumpy.core.")
    (base / "camera.pkl").write_bytes(raw)
    np.testing.assert_allclose(find(base).rig.intrinsics[0, 0, 0], 90)


def test_streams_that_differ_by_a_frame(base: Path) -> None:
    write(base, masks=FRAMES - 1)
    capture = find(base)
    assert "masks.hdf5 has 3 frames, the video 4; both are taken to begin together" in capture.notes
    assert [list(s.numbers) for s in (*capture.streams("masks"), *capture.joints) if s] == [[0, 1, 2], [0, 1, 2, 3]]
    write(base, masks=FRAMES + 1)
    assert list(capture.pictures[0].numbers) == list(find(base).streams("masks")[0].numbers)  # type: ignore[union-attr]
    for name in ("masks.hdf5", "keypoints.hdf5"):
        (base / name).unlink()
    assert (find(base).masks, find(base).joints) == ((), ())


def test_wrong_files_get_a_sentence(base: Path) -> None:
    for change, said in (
        ({"camera_c": CAMERA["camera_c"] / 4}, "are for pictures of another size"),
        ({"camera_f": np.array([0.1, 0.1])}, "focal length fx = 0.1 px"),
        ({"camera_f": np.zeros(3)}, "camera_f has 3 numbers, expected 2"),
        ({"camera_rt": np.full(3, 1e3)}, "rotation vector has the length"),
        ({"camera_t": np.full(3, 1e300)}, "translation"),
        ({"camera_k": "x"}, "camera_k 'x' is not made of numbers"),
        ({"width": np.nan}, "width and height are"),
        ({"width": os.system}, "it asks for 'posix.system'"),
    ):
        write(base, camera={**CAMERA, **change})
        with pytest.raises(UserError, match=said):
            find(base)
    write(base, camera={"camera_f": 1})
    with pytest.raises(UserError, match=r"camera.pkl has no camera_c, camera_k"):
        find(base)
    write(base)
    with h5py.File(base / "masks.hdf5", "w") as f:
        f["masks"] = np.zeros((FRAMES, SIDE, SIDE - 8), np.int8)
    with pytest.raises(UserError, match=r"masks in .* have the shape \(4, 48, 40\); \[frames, 48, 48\] is expected"):
        find(base)
    write(base)
    with h5py.File(base / "keypoints.hdf5", "w") as f:
        f["keypoints"] = np.zeros((FRAMES, 75))
    with pytest.raises(UserError, match=r"keypoints.hdf5 have the shape \(4, 75\); \[frames, 54\] is expected"):
        find(base)
    (base / "other.mp4").write_bytes((base / "male-1-casual.mp4").read_bytes())
    with pytest.raises(UserError, match="holds 2 videos"):
        find(base)
