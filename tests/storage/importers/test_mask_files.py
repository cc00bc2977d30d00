"""Which files are a camera's masks, and what is said where masks are not found."""

from __future__ import annotations

from pathlib import Path

import pytest

from posegaussian.storage.importers.find import find_capture
from posegaussian.storage.model.errors import UserError
from tests.storage.importers import test_pose2sim, test_videos
from tests.storage.importers.test_masks import FRAMES, NAMES, check, films, find, folders, masks, said
from tests.support import import_capture, ring

NONE = "there are no masks: a run cuts the person out where it can (frames.matte)"


def test_files_that_lie_where_masks_do_and_are_none_are_said(tmp_path: Path) -> None:
    base = films(tmp_path / "videos")
    assert said(test_videos.find(base), "mask") == [NONE]
    (base / "masks").mkdir()
    (base / "masks" / "cam0.mp4").write_bytes((base / "cam0.mp4").read_bytes())
    (base / "masks" / ".DS_Store").write_bytes(b"x")
    (told,) = said(test_videos.find(base), "none is read as a mask")
    assert told.startswith("masks holds 1 files, such as masks/cam0.mp4, and none")
    assert "-start_number 0" in told
    base = folders(tmp_path / "flat")
    (base / "mask").mkdir()
    ring.write_mask(base / "mask" / "cam1_000000.png", 0, 0)
    (told,) = said(find(base), "none is read as a mask")
    assert "masks are read as masks/CAM/000000.png" in told


def test_a_layout_without_masks_says_which_has_them(tmp_path: Path) -> None:
    films(tmp_path)
    test_pose2sim.write_calibration(tmp_path, test_videos.NAMES)
    masks(tmp_path)
    (told,) = said(find_capture("pose2sim", tmp_path, {}), "none is read as a mask")
    assert "by the layout pose2sim; the layouts images and videos read masks/CAM/000000.png" in told


@pytest.mark.parametrize("place", ["Masks", "mask", "matte", "mask_cihp", "silhouettes"])
def test_pictures_in_folders_of_cameras_names_that_are_not_read_are_named(tmp_path: Path, place: str) -> None:
    """Whatever the folder is called; the law: a command that is said makes masks of them."""
    base = masks(folders(tmp_path / "a capture"))
    (base / "masks").rename(base / place)
    capture = find(base)
    assert NONE in capture.notes
    (told,) = said(capture, "not read")
    assert told.startswith(f"{place} holds pictures in folders of cameras' names and is not read: masks are read from")
    assert f"mv '{base / place}' '{base / 'masks'}'" in told
    assert not said(capture, "none is read as a mask")
    (base / place).rename(base / "masks")
    check(find(base), {0: 0, 2: 2})


def test_folders_that_are_read_or_hold_no_camera_s_pictures_are_not_named(tmp_path: Path) -> None:
    base = folders(tmp_path)
    import_capture.pictures(base / "normals", ("nobody",))
    ring.write_picture(base / "overview.png", 0, 0)
    (base / "images").rename(tmp_path / "elsewhere")
    (base / "images").symlink_to(tmp_path / "elsewhere")
    capture = find(base)
    assert NONE in capture.notes
    assert not said(capture, "not read")
    assert NONE not in find(masks(base)).notes


def test_a_folder_that_a_layout_without_masks_does_not_read_is_not_to_be_renamed(tmp_path: Path) -> None:
    films(tmp_path)
    test_pose2sim.write_calibration(tmp_path, test_videos.NAMES)
    (masks(tmp_path) / "masks").rename(tmp_path / "matte")
    capture = find_capture("pose2sim", tmp_path, {})
    assert NONE in capture.notes
    assert not said(capture, "rename")


@pytest.mark.parametrize("frames", [FRAMES, (7,)], ids=["several frames", "one frame"])
def test_several_masks_a_frame_are_refused_as_such(tmp_path: Path, frames: tuple[int, ...]) -> None:
    base = folders(tmp_path, frames)
    for name in NAMES:
        for n in frames:
            for person in (0, 1, 7):
                ring.write_mask(base / "masks" / name / f"{n:06d}_{person}.png", 0, 0)
    said_so = f"masks/{NAMES[0]}: {frames[0]:06d}_0.png, {frames[0]:06d}_1.png look like several masks of one frame"
    with pytest.raises(UserError, match=said_so) as refused:
        find(base)
    names = " ".join(f"{frames[0]:06d}_{person}.png" for person in (0, 1, 7))
    assert f"convert {names} -evaluate-sequence max" in str(refused.value)


def test_masks_behind_their_camera_s_number_are_one_a_frame(tmp_path: Path) -> None:
    """The number of a camera or a take, before that of a frame, is alike in all of them."""
    base = folders(tmp_path)
    for v, name in enumerate(NAMES):
        for n in FRAMES:
            ring.write_mask(base / "masks" / name / f"take0012_{n}.png", v, n)
    check(find(base), {0: 0, 2: 2})


def test_masks_of_two_cameras_in_one_folder_are_not_taken_for_several_a_frame(tmp_path: Path) -> None:
    base = folders(tmp_path)
    for v, name in enumerate(NAMES):
        for n in FRAMES:
            ring.write_mask(base / "masks" / NAMES[0] / f"{name}_{n:06d}.png", v, n)
    with pytest.raises(UserError, match="two files are frame 0 in"):
        find(base)
