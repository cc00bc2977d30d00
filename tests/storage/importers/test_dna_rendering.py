"""The dna_rendering importer: poses inverted, cameras in the order of numbers, masks, joints, and sentences."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import pytest

from posegaussian.storage.importers.find import find_capture
from posegaussian.storage.model.capture import Capture
from posegaussian.storage.model.errors import UserError
from posegaussian.storage.readers.sources import open_source
from tests.support import ring

CAMERAS = {"2": 0, "10": 1, "48": 2}
"""Camera of the ring by id: as texts they would come 10, 2, 48."""
FRAMES = 3
JOINTS = 133


def points(n: int) -> np.ndarray:
    """[133, 3] metres, joints of a person at instant n."""
    random = np.random.default_rng(7)
    return ring.PLACE + random.uniform(-0.35, 0.35, (JOINTS, 3)) + [0, 0, 0.02 * n]


def pixels(v: int, n: int) -> np.ndarray:
    """[133, 3] (u, v, score) of these in a camera; joint 4 is not seen."""
    out = np.array([[*ring.seen(v, p), 0.9] for p in points(n)])
    out[4] = [1, 2, 0.1]
    return out


def encoded(kind: str, picture: np.ndarray) -> np.ndarray:
    return np.asarray(cv2.imencode(kind, picture)[1]).ravel()


def write(base: Path) -> None:
    base.mkdir(parents=True, exist_ok=True)
    with h5py.File(base / "0012_01.smc", "w") as main, h5py.File(base / "0012_01_annots.smc", "w") as annots:
        main.attrs["actor_id"], main.attrs["age"] = "0012", 33
        for name, v in CAMERAS.items():
            group = "Camera_5mp" if int(name) < 48 else "Camera_12mp"
            for n in range(FRAMES):
                grey = np.full((ring.SIZE[1], ring.SIZE[0], 3), ring.level(v, n), np.uint8)
                main[f"{group}/{name}/color/{n}"] = encoded(".jpg", grey)
                annots[f"Mask/{name}/mask/{n}"] = encoded(".png", np.repeat(ring.mask(v, n)[..., None], 3, axis=2))
            of = f"Camera_Parameter/{int(name):02d}"
            annots[f"{of}/K"], annots[f"{of}/D"] = ring.intrinsics(v), ring.DISTORTION
            annots[f"{of}/RT"] = np.linalg.inv(ring.pose(v))
            annots[f"{of}/Color_Calibration"] = np.eye(3)
            annots[f"Keypoints_2D/{int(name):02d}"] = np.stack([pixels(v, n) for n in range(FRAMES)])
        scored = [np.column_stack([points(n), np.ones(JOINTS)]) for n in range(FRAMES)]
        annots["Keypoints_3D/keypoints3d"] = np.stack(scored)


@pytest.fixture
def base(tmp_path: Path) -> Path:
    write(tmp_path)
    return tmp_path


def find(base: Path, **options: object) -> Capture:
    return find_capture("dna_rendering", base, options)


def change(base: Path, edit: Callable[[Any], object], file: str = "0012_01_annots.smc") -> None:
    with h5py.File(base / file, "r+") as f:
        edit(f)


def put(place: str, value: Any) -> Callable[[Any], object]:
    def edit(f: Any) -> None:
        if place in f:
            del f[place]
        f[place] = value

    return edit


def test_cameras_pictures_masks_and_joints_are_those_of_the_files(base: Path) -> None:
    capture = find(base)
    assert (capture.rig.names, capture.numbers.tolist(), capture.frame_rate) == (("02", "10", "48"), [0, 1, 2], 15)
    ring.check_cameras(capture, (0, 1, 2))
    ring.check_pictures(capture, (0, 1, 2), {0: 0, 2: 2})
    ring.check_masks(capture, (0, 1, 2), {1: 1})
    joints = open_source(capture, "joints")
    assert joints.joint_set == "coco17"
    for v in range(3):
        found = joints.read(v, 2)
        np.testing.assert_allclose(found[0, :, :2], pixels(v, 2)[:17, :2] + 0.5, atol=1e-6)
        np.testing.assert_allclose(found[0, :, 2], pixels(v, 2)[:17, 2])
    assert any(n.startswith("points: 144 observations land 0.00 px") for n in capture.notes)
    assert not any("33" in n or "age" in n for n in capture.notes)
    kept = Capture.from_json(capture.to_json())
    ring.check_pictures(kept, (0, 1, 2), {1: 1})


def test_views_come_into_step(base: Path) -> None:
    """View 1 is a frame late: its frame 2 is shown as 1."""
    moved = find(base).in_step([0, -1, 0])
    picture = next(iter(open_source(moved, "pictures").read(1, [2])))
    assert abs(int(picture[5, 5, 0]) - ring.level(1, 1)) <= 2
    np.testing.assert_allclose(open_source(moved, "joints").read(1, 2)[0, 0, :2], pixels(1, 1)[0, :2] + 0.5, atol=1e-6)


def test_a_wrong_convention_shows_in_the_joints(base: Path) -> None:
    """World to camera, millimetres, intrinsics of another size or another camera, and p1 with p2."""
    of = "Camera_Parameter/10"
    swapped = ring.DISTORTION[[0, 1, 3, 2, 4]]
    for place, value, said in (
        (f"{of}/RT", ring.pose(1), "camera 10: the file's points land .* px from where its images saw them"),
        (f"{of}/K", 2 * ring.intrinsics(1), "intrinsics"),
        (
            f"{of}/K",
            ring.intrinsics(1) * np.array([[1.5, 1, 1], [1, 1.5, 1], [1, 1, 1]]),
            "camera 10: the file's points",
        ),
    ):
        write_again(base)
        change(base, put(place, value))
        with pytest.raises(UserError, match=said):
            find(base)
    write_again(base)
    in_mm = np.linalg.inv(ring.pose(1))
    in_mm[:3, 3] *= 1000
    change(base, put(f"{of}/RT", in_mm))
    with pytest.raises(UserError, match=r"millimetres|m apart"):
        find(base)
    write_again(base)
    change(base, put(f"{of}/D", swapped))
    assert np.abs(ring.seen(1, points(0)[0]) - ring.seen(1, points(0)[0], swapped)).max() < 0.2  # harmless
    find(base)


def write_again(base: Path) -> None:
    for p in base.glob("*.smc"):
        p.unlink()
    write(base)


def test_parts_that_are_missing_are_said(base: Path) -> None:
    change(base, lambda f: f.__delitem__("Camera_Parameter/48"))
    change(base, lambda f: f.__delitem__("Camera_5mp/2/color/1"), "0012_01.smc")
    capture = find(base)
    assert capture.rig.names == ("02", "10")
    assert "camera 48 has no calibration in 0012_01_annots.smc and is left out" in capture.notes
    assert "camera 02 lacks pictures of 1 frames (1)" in capture.notes
    change(base, lambda f: f.__delitem__("Keypoints_2D"))
    assert find(base).joints == ()
    change(base, lambda f: f.__delitem__("Mask"))
    assert "there are no masks: a run cuts the person out where it can (frames.matte)" in find(base).notes


def test_masks_of_jpeg_are_cut_at_half(base: Path) -> None:
    for n in range(FRAMES):
        change(base, put(f"Mask/2/mask/{n}", encoded(".jpg", np.repeat(ring.mask(0, n)[..., None], 3, axis=2))))
    ring.check_masks(find(base), (0, 1, 2), {0: 0})
    assert {*np.unique(next(iter(open_source(find(base), "masks").read(0, [0]))))} == {0, 255}


def test_several_takes(base: Path) -> None:
    for p in list(base.glob("*.smc")):
        p.with_name(p.name.replace("0012_01", "0012_09")).write_bytes(p.read_bytes())
    with pytest.raises(UserError, match=r"2 takes; choose one with --option take=NAME; there are 0012_01, 0012_09"):
        find(base)
    assert len(find(base, take="0012_09").rig) == 3
    with pytest.raises(UserError, match="option take: there is no 7; there are 0012_01"):
        find(base, take="7")


def test_broken_files_get_a_sentence(base: Path, tmp_path: Path) -> None:
    outside = tmp_path / "outside.h5"
    with h5py.File(outside, "w") as f:
        f["K"] = np.eye(3)
    k = "Camera_Parameter/10/K"
    virtual = h5py.VirtualLayout((3, 3), "f8")
    virtual[...] = h5py.VirtualSource(str(outside), "K", (3, 3))

    def replaced(make: Callable[[Any], object]) -> Callable[[Any], None]:
        def edit(f: Any) -> None:
            del f[k]
            make(f)

        return edit

    for edit, said in (
        (put(k, np.eye(4)), r"Camera_Parameter/10/K has the shape \(4, 4\); \(3, 3\) is expected"),
        (put(k, np.full((3, 3), np.nan)), "camera 10: intrinsics holds nan|finite|nan"),
        (put(k, "text"), "numbers are expected"),
        (put(k, h5py.ExternalLink(str(outside), "K")), "is a link to another place; links are not followed"),
        (put(k, h5py.SoftLink("/Camera_Parameter/02/K")), "is a link to another place"),
        (replaced(lambda f: f.create_virtual_dataset(k, virtual)), "has its numbers in other files"),
        (replaced(lambda f: f.create_dataset(k, (3, 3), "f8", external=[(str(outside), 0, 72)])), "in other files"),
        (replaced(lambda f: f.create_group(k)), "is a group, an array is expected"),
        (put("Camera_Parameter/10/RT", np.full((4, 4), 1e300)), "camera 10"),
        (put("Mask/2/mask/0", np.zeros(9, np.uint8)), "mask Mask/2/mask/0 of .*: its 9 bytes are no whole JPEG or PNG"),
        (put("Mask/2/mask/0", encoded(".png", np.zeros((9, 9), np.uint8))), "camera 02: masks are 9x9 px"),
        (put("Keypoints_2D/10", np.zeros((3, 5, 3))), r"Keypoints_2D/10 has the shape \(3, 5, 3\)"),
        (lambda f: (f.__delitem__("Keypoints_3D/keypoints3d"),
                    f.create_dataset("Keypoints_3D/keypoints3d", (10**9, 133, 3), "f8", chunks=(1, 133, 3))),
         r"takes \d+ bytes, at most"),
        (lambda f: f.__delitem__("Camera_Parameter"), "has no Camera_Parameter of the cameras"),
    ):  # fmt: skip
        write_again(base)
        change(base, edit)
        with pytest.raises(UserError, match=said):
            find(base)
    write_again(base)
    bomb = encoded(".png", np.zeros((9, 9), np.uint8))
    bomb[16:24] = [0, 1, 0, 0, 0, 1, 0, 0]
    change(base, put("Camera_5mp/2/color/0", bomb), "0012_01.smc")
    with pytest.raises(UserError, match=r"picture Camera_5mp/2/color/0 of .*0012_01.smc: it says it is 65536x65536 px"):
        find(base)
    write_again(base)
    path = base / "0012_01.smc"
    path.write_bytes(path.read_bytes()[:2000])
    with pytest.raises(UserError, match=r"cannot read take .*0012_01\.smc: .*damaged or cut off"):
        find(base)
    path.unlink()
    (base / "0012_01_annots.smc").rename(path)
    with pytest.raises(UserError, match=r"there is no 0012_01_annots\.smc beside 0012_01\.smc"):
        find(base)
