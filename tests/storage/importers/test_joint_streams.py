"""Which joint set a number of joints means, and which frames joints are of."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
import pytest

from posegaussian.storage.formats.joint_files import read_openpose
from posegaussian.storage.importers.joint_streams import coco_joints, guess_joint_set, picture_joints
from posegaussian.storage.model.capture import Stream
from posegaussian.storage.model.errors import SourceError
from tests.support import import_capture
from tests.support.import_capture import NAMES

WHERE = Path("walk/cam1.json")


@pytest.mark.parametrize(
    ("joints", "hint", "id"),
    [
        (17, "keypoints", "coco17"),
        (17, "lifted_H36M", "h36m17"),
        (25, "openpose", "body_25"),
        (25, "openpose_body25b", "body_25b"),
        (33, "25b", "blazepose33"),
        (26, "", "halpe26"),
        (24, "h36m", "smpl24"),
    ],
)
def test_joints_are_counted_and_a_hint_decides_between_two(joints: int, hint: str, id: str) -> None:
    assert guess_joint_set(joints, None, hint, WHERE) == id


def test_what_is_given_must_fit() -> None:
    assert guess_joint_set(17, "h36m17", "", WHERE) == "h36m17"
    with pytest.raises(SourceError, match="holds 17 joints a person; joint_set halpe26 has 26"):
        guess_joint_set(17, "halpe26", "", WHERE)
    with pytest.raises(
        SourceError, match=r"holds 18 joints a person, which no known joint set has \(coco17: 17, .*panoptic19: 19\)"
    ):
        guess_joint_set(18, None, "", WHERE)


def streams(kind: Literal["images", "video"], numbers: tuple[int, ...]) -> list[Stream]:
    """Pictures of three cameras."""
    return [Stream(kind, (), numbers, (64, 48))] * 3


def folders(base: Path, numbers: tuple[int, ...], names: tuple[str, ...] = NAMES) -> dict[str, dict[int, Path]]:
    """OpenPose joints, the person of instant i in the i-th number."""
    found: dict[str, dict[int, Path]] = {n: {} for n in names}
    for v, name in enumerate(names):
        for i, n in enumerate(numbers):
            found[name][n] = base / name / f"{n:012d}_keypoints.json"
            people = import_capture.people(v) + np.array([i, 0, 0])
            import_capture.dump(found[name][n], {"people": [{"pose_keypoints_2d": people.reshape(-1).tolist()}]})
    return found


def joints_of(found: dict[str, dict[int, Path]], pictures: list[Stream]) -> tuple[tuple[Stream | None, ...], list[str]]:
    return picture_joints("openpose", read_openpose, NAMES, found, pictures, None, "joints")


@pytest.mark.parametrize("names", [NAMES, NAMES[1:]])
def test_joints_beside_pictures_that_are_one_off_are_refused(tmp_path: Path, names: tuple[str, ...]) -> None:
    """Every one would be another moment's; a camera without joints changes nothing of that."""
    found = folders(tmp_path, (1, 2, 3), names)
    with pytest.raises(
        SourceError,
        match=rf"camera {names[0]}: its 2D joints are frames 1-3, its pictures 0-2: as many, and 1 off in every camera;"
        " number 2D joints as their pictures are",
    ):
        joints_of(found, streams("images", (0, 1, 2)))
    joints_of(found, streams("images", (1, 2, 3)))
    joints_of(found, streams("images", (0, 1, 2, 3)))


def test_joints_of_videos_that_are_counted_from_1_go_with_frames_one_to_one(tmp_path: Path) -> None:
    """The law: whatever they are counted from, they are the same joints."""
    for first in (0, 1, 40):
        found = folders(tmp_path / str(first), tuple(range(first, first + 3)))
        joints, said = joints_of(found, streams("video", (0, 1, 2)))
        for v, stream in enumerate(joints):
            assert stream is not None
            assert stream.numbers == (0, 1, 2)
            for i, file in enumerate(stream.files):
                seen = read_openpose(file.path).joints[0, 0, 0]
                assert seen == pytest.approx(import_capture.people(v)[0, 0] + i + 0.5)
        assert any("2D joints: one a frame in every camera, numbered from" in n for n in said) == (first > 0)


def coco(base: Path, numbers: tuple[int, ...]) -> dict[str, Path]:
    """COCO joints, a file a camera."""
    out = {}
    for v, name in enumerate(NAMES):
        person = import_capture.people(v)[:17].reshape(-1).tolist()
        out[name] = base / f"{name}.json"
        named = [{"id": n, "file_name": f"{n:06d}.png"} for n in numbers]
        import_capture.dump(
            out[name],
            {"images": named, "annotations": [{"id": n, "image_id": n, "keypoints": person} for n in numbers]},
        )
    return out


def test_coco_joints_that_are_one_off_are_refused(tmp_path: Path) -> None:
    found = coco(tmp_path, (1, 2, 3, 4))
    with pytest.raises(
        SourceError, match="its 2D joints are frames 1-4, its pictures 0-3: as many, and 1 off in every"
    ):
        coco_joints(NAMES, found, False, streams("images", (0, 1, 2, 3)), None)
    joints, _ = coco_joints(NAMES, found, False, streams("images", (1, 2, 3)), None)
    assert [s.numbers for s in joints if s is not None] == [(1, 2, 3)] * 3


def test_joints_of_no_picture_are_said_at_once(tmp_path: Path) -> None:
    sentence = ["no joint belongs to a picture: joints are of frames 0, 3-4, pictures 107-108; number them alike"]
    pictures = streams("images", (107, 108))
    assert coco_joints(NAMES, coco(tmp_path / "coco", (0, 3, 4)), False, pictures, None) == ((), sentence)
    assert joints_of(folders(tmp_path, (0, 3, 4)), pictures) == ((), sentence)
