"""Joint files: what the formats say, what is missing, and what is refused."""

from __future__ import annotations

import json

import numpy as np
import pytest

from posegaussian.storage.formats.joint_files import frame_number, read_coco, read_openpose, read_trc
from posegaussian.storage.model.errors import SourceError


@pytest.mark.parametrize(
    ("name", "number"),
    [
        ("000012.jpg", 12),
        ("cam01.0003.json", 3),
        ("cam01_000000000007_keypoints.json", 7),
        ("frame_5_keypoints2d.json", 5),
        ("x.png", None),
        ("cam2/00.png", 0),
    ],
)
def test_frame_number(name, number):
    assert frame_number(name) == number


def test_empty_people_are_no_people(tmp_path):
    for people in ([], [{}], [{"pose_keypoints_2d": []}], [{"person_id": [-1], "pose_keypoints_2d": None}]):
        (tmp_path / "a.json").write_text(json.dumps({"people": people}))
        assert len(read_openpose(tmp_path / "a.json").joints) == 0


def test_a_joint_that_is_not_finite_is_missing(tmp_path):
    (tmp_path / "a.json").write_text('{"people": [{"pose_keypoints_2d": [1, NaN, 0.5, 2, 3, 1.5]}]}')
    joints = read_openpose(tmp_path / "a.json").joints
    assert np.isfinite(joints).all()
    assert joints[0, :, 2].tolist() == [0, 1]
    assert joints[0, 1, :2].tolist() == [2.5, 3.5]


def test_visibility_counts_as_score(tmp_path):
    data = {
        "images": [{"id": 1, "file_name": "000004.jpg"}],
        "annotations": [{"image_id": 1, "keypoints": [0, 0, 0, 5, 6, 1, 7, 8, 2]}],
    }
    (tmp_path / "a.json").write_text(json.dumps(data))
    assert read_coco(tmp_path / "a.json")[4].joints[0, :, 2].tolist() == [0, 1, 1]


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("{", "not valid JSON"),
        ("[]", "no list 'people'"),
        ('{"people": [3]}', "no list 'people' of objects"),
        ('{"people": [{"pose_keypoints_2d": [1, 2]}]}', "2 numbers"),
        ('{"people": [{"pose_keypoints_2d": ["a", 2, 3]}]}', "not a list of numbers"),
        (
            '{"people": [{"pose_keypoints_2d": [1, 2, 1]}, {"pose_keypoints_2d": [1, 2, 1, 1, 2, 1]}]}',
            "different numbers of joints",
        ),
    ],
)
def test_broken_openpose_files_are_refused(tmp_path, text, sentence):
    (tmp_path / "a.json").write_text(text)
    with pytest.raises(SourceError, match=rf"a\.json.*{sentence}"):
        read_openpose(tmp_path / "a.json")


HEADER = (
    "PathFileType\t4\t(X/Y/Z)\ta.trc\nDataRate\tNumFrames\tUnits\n60\t2\t{unit}\n"
    "Frame#\tTime\tHip\t\t\tKnee\t\t\t\n\t\tX1\tY1\tZ1\tX2\tY2\tZ2\n"
)


@pytest.mark.parametrize(("unit", "factor"), [("m", 1), ("mm", 1e-3), ("cm", 1e-2)])
def test_trc_units_axes_and_gaps(tmp_path, unit, factor):
    (tmp_path / "a.trc").write_text(
        HEADER.format(unit=unit) + "1\t0.0\t1\t2\t3\t\t\t\n2\t0.1\t1\t2\t3\t4\t5\tnan\n\n4\t0.2\t1\t2\t3\t4\t5\t6\n"
    )
    trc = read_trc(tmp_path / "a.trc")
    assert (trc.markers, trc.rate, trc.numbers.tolist()) == (("Hip", "Knee"), 60, [0, 1, 3])
    joints = trc.joints(["Knee", "Hip"], "yzx")  # file x is world Y, file y world Z, file z world X
    np.testing.assert_allclose(joints[0], [[0, 0, 0, 0], [3 * factor, 1 * factor, 2 * factor, 1]])
    assert joints[1][0].tolist() == [0, 0, 0, 0]
    np.testing.assert_allclose(joints[3][0], [6 * factor, 4 * factor, 5 * factor, 1])
    np.testing.assert_allclose(trc.joints(["Hip"], "xyz")[0], [[factor, 2 * factor, 3 * factor, 1]])


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "not a TRC file"),
        (HEADER.format(unit="inch") + "1\t0\t1\n", "unit 'inch' is not one of m, mm, cm"),
        (HEADER.format(unit="m") + "1\t0\tabc\n", "line 6: could not convert"),
        (HEADER.format(unit="m") + "2\t0\t1\t2\t3\n1\t0\t1\t2\t3\n", "frame numbers must ascend"),
        (HEADER.format(unit="m") + "\n", "found 0 frames"),
    ],
)
def test_broken_trc_files_are_refused(tmp_path, text, sentence):
    (tmp_path / "a.trc").write_text(text)
    with pytest.raises(SourceError, match=sentence):
        read_trc(tmp_path / "a.trc")
