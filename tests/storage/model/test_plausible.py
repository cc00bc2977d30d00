"""Numbers that no calibration and no detection has are refused, and the sentence says what they probably are."""

from __future__ import annotations

import json
import struct
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from posegaussian.dags.simulation.simulate import read_scene
from posegaussian.stages.camera_paths.path_file import read_path_file
from posegaussian.storage.formats.joint_files import frame_number, read_coco, read_openpose, read_trc
from posegaussian.storage.importers.joint_streams import trc_joints
from posegaussian.storage.model.crop import Crop
from posegaussian.storage.model.errors import CalibrationError, ConfigError, SourceError
from posegaussian.storage.model.plausible import check_rate, check_rotation_vector, check_time, unit_of
from posegaussian.storage.readers.images import picture_size, read_picture, write_png
from tests.fuzz.captures import trc
from tests.support.sample_captures import make_rig


def rig(part: str, at: tuple[int, ...], value: float) -> Any:
    whole = make_rig(2)
    changed = getattr(whole, part).copy()
    changed[at] = value
    return replace(whole, **{part: changed})


CAMERAS = {
    "focal length beyond all lenses": (
        "intrinsics",
        (1, 0, 0),
        1e12,
        "cam02: focal length fx = 1e\\+12 px is beyond 2 to 4000 px",
    ),
    "focal length in widths of the picture": (
        "intrinsics",
        (1, 1, 1),
        1.2,
        "fy = 1.2 px .* is it in millimetres, or in widths of the picture",
    ),
    "focal lengths of two units": ("intrinsics", (1, 0, 0), 3000.0, "differ more than 5 times"),
    "principal point of another picture": (
        "intrinsics",
        (1, 0, 2),
        960.0,
        "principal point cx = 960 px .* pictures of another size",
    ),
    "distortion in pixels": ("distortion", (1, 0), 1e308, "distortion k1 = 1e\\+308 is beyond 1000"),
    "tangential distortion": ("distortion", (1, 3), -50.0, "distortion p2 = -50 is beyond 10"),
    "translation in millimetres": (
        "world_to_camera",
        (1, 2, 3),
        3000.0,
        "its translation holds 3000 m, .* millimetres",
    ),
    "translation beyond numbers": ("world_to_camera", (1, 0, 3), -1e308, "its translation holds 1e\\+308 m"),
    "picture beyond all pictures": ("size", (1, 0), 10**9, "picture size .* whole numbers from 1 to 32768"),
    "picture without pixels": ("size", (1, 1), 0, "picture size .* whole numbers from 1 to 32768"),
}


@pytest.mark.parametrize("case", CAMERAS)
def test_a_camera_that_cannot_be_is_named_with_what_it_may_be(case: str) -> None:
    part, at, value, sentence = CAMERAS[case]
    make_rig(2).check()
    with pytest.raises(CalibrationError, match=sentence):
        rig(part, at, value).check()


def test_a_header_that_promises_more_than_memory_holds_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "a.png"
    write_png(file, np.zeros((4, 4, 3), np.uint8))
    raw = bytearray(file.read_bytes())
    raw[16:24] = struct.pack(">II", 9_000, 9_000)
    raw[29:33] = struct.pack(">I", zlib.crc32(raw[12:29]))
    file.write_bytes(raw)
    for read in (read_picture, picture_size):
        with pytest.raises(
            SourceError, match=r"a\.png: it says it is 9000x9000 px; at most 32768 px a side and 67108864 px in all"
        ):
            read(file)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"K": [[1e12, 0, 20], [0, 50, 15], [0, 0, 1]]}, "focal length fx = 1e.12 px"),
        ({"t": [0, 0, 4000]}, "its translation holds 4000 m"),
    ],
)
def test_a_camera_path_that_cannot_be_names_camera_and_file(
    tmp_path: Path, change: dict[str, Any], sentence: str
) -> None:
    camera = {
        "name": "a",
        "width": 40,
        "height": 30,
        "K": [[50, 0, 20], [0, 50, 15], [0, 0, 1]],
        "R": np.eye(3).tolist(),
        "t": [0, 0, 3],
        **change,
    }
    (tmp_path / "path.json").write_text(json.dumps({"pixel_center": "half", "cameras": [camera]}))
    with pytest.raises(CalibrationError, match=rf"camera 'a' of .*path\.json: {sentence}"):
        read_path_file(str(tmp_path / "path.json"), np.arange(3))


@pytest.mark.parametrize("crop", [{"scale": 1e300}, {"scale": 1e-300}, {"offset": [1e308, 0]}])
def test_a_crop_that_no_picture_has(crop: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        Crop.model_validate(crop)


def test_numbers_of_a_scene_are_bounded_with_their_place(tmp_path: Path) -> None:
    (tmp_path / "s.yaml").write_text("seed: 3\nrig: {kind: ring, radius: 1.0e+300, roll: 1.0e+9}\n")
    with pytest.raises(ConfigError) as error:
        read_scene(tmp_path / "s.yaml")
    assert {line.partition("s.yaml")[2] for line in str(error.value).splitlines()} == {
        ":2:19 rig.radius: 1e+300 is beyond 100000; lengths are metres, angles degrees and times seconds",
        ":2:37 rig.roll: 1e+09 is beyond 100000; lengths are metres, angles degrees and times seconds",
    }


def test_a_rotation_vector_in_degrees_is_told() -> None:
    check_rotation_vector("cam1", np.array([0.0, 3.1, 0.4]))
    with pytest.raises(CalibrationError, match=r"cam1: the rotation vector has the length 90, .* degrees"):
        check_rotation_vector("cam1", np.array([0.0, 90.0, 0.0]))


@pytest.mark.parametrize("rate", [0.0, 1e-300, 1e9, np.inf, np.nan, -30.0])
def test_a_rate_that_no_camera_has(rate: float) -> None:
    check_rate("a.mp4", 29.97)
    with pytest.raises(SourceError, match=r"a\.mp4: .* frames/s are beyond 0.01 to 10000"):
        check_rate("a.mp4", rate)


@pytest.mark.parametrize("seconds", [np.nan, np.inf, 1.7e12])
def test_a_time_in_milliseconds_since_1970(seconds: float) -> None:
    check_time("t", 1.7e9)
    with pytest.raises(SourceError, match="is it in milli- or nanoseconds"):
        check_time("t", seconds)


@pytest.mark.parametrize(
    ("flat", "sentence"),
    [
        ([1e308, 5, 0.5], "holds the coordinate 1e\\+308 px"),
        ([-2e5, 5, 0.5], "at most 100000 are plausible"),
        ([10, 5, 640], "holds the confidence 640, .* the order"),
        ([10**25, 5, 0.5], "26 digits"),
    ],
)
def test_joints_beyond_every_picture_are_refused(tmp_path: Path, flat: list[float], sentence: str) -> None:
    file = tmp_path / "0_keypoints.json"
    file.write_text(json.dumps({"people": [{"pose_keypoints_2d": flat}]}))
    with pytest.raises(SourceError, match=sentence):
        read_openpose(file)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"bbox": [1, 2]}, "bbox"),
        ({"bbox": 5}, "bbox 5 is not a list"),
        ({"bbox": [1, 2, 3, "4"]}, "not made of four numbers"),
        ({"score": [1]}, "not made of numbers"),
        ({"keypoint_scores": 5}, "keypoint_scores 5 is not a list"),
        ({"keypoint_scores": ["a"]}, "not a list of numbers"),
        ({"keypoint_scores": [[1]]}, "not a list of numbers"),
        ({"image_id": [1]}, "image id"),
        ({"keypoints": {"a": 1}}, "not a list of numbers"),
    ],
)
def test_parts_of_coco_of_the_wrong_kind_are_named(tmp_path: Path, change: dict[str, Any], sentence: str) -> None:
    annotation = {
        "image_id": 1,
        "keypoints": [1, 2, 2],
        "bbox": [0, 0, 5, 5],
        "score": 0.5,
        "keypoint_scores": [0.25],
        **change,
    }
    (tmp_path / "a.json").write_text(
        json.dumps({"images": [{"id": 1, "file_name": "a/0.png"}], "annotations": [annotation]})
    )
    with pytest.raises(SourceError, match=sentence):
        read_coco(tmp_path / "a.json")


def test_a_trc_in_millimetres_that_says_metres_is_told(tmp_path: Path) -> None:
    file = tmp_path / "a.trc"
    trc(file)
    assert trc_joints(file, "yzx").options["joint_set"] == "trc21"
    text = file.read_text()
    file.write_text(text.replace("\tm\t", "\tmm\t"))
    with pytest.raises(
        SourceError, match=r"0\.05 to 10 m are plausible of a person; is the file's unit right. It may be metres"
    ):
        trc_joints(file, "yzx")
    file.write_text(text.replace("\t0.0400", "\t4e7"))
    with pytest.raises(SourceError, match=r"a marker lies 4e\+07 m from the origin, .* millimetres"):
        read_trc(file)
    file.write_text(text.replace("\n2\t", "\n1e300\t"))
    with pytest.raises(SourceError, match=r"line 7: .*301 digits"):
        read_trc(file)


def test_a_frame_number_beyond_64_bits_is_refused() -> None:
    assert frame_number("cam_1700000000123456789.png".replace("9.png", ".png")) == 170000000012345678
    with pytest.raises(SourceError, match="a frame number of 30 digits"):
        frame_number("9" * 30 + ".png")


@pytest.mark.parametrize(
    ("factor", "moved", "sentence"),
    [
        (
            1.0,
            (5000.0, -3000.0, 200.0),
            r"so the unit is right and the origin far off: subtract \(5000, -3000, 20[0-9]\) m",
        ),
        (2e3, (0.0, 0.0, 0.0), r"is it in millimetres\? Then cameras lie up to [0-9.]+ m apart: .* by 0\.001, or set"),
        (2.0, (1e4, 0.0, 0.0), "the unit is right"),
        (1e9, (0.0, 0.0, 0.0), "Divide it by 1000, or move the origin"),
    ],
)
def test_cameras_far_away_are_of_another_unit_or_of_another_origin(
    factor: float, moved: tuple[float, float, float], sentence: str
) -> None:
    """By how far they lie from one another, and by the rule itself the cameras are then accepted."""
    whole = make_rig(4)
    poses = whole.world_to_camera.copy()
    poses[:, :3, 3] = -np.einsum("vij,vj->vi", whole.rotations, factor * whole.centres + moved)
    with pytest.raises(CalibrationError, match=sentence):
        replace(whole, world_to_camera=poses).check()


def test_a_unit_is_proposed_only_where_cameras_then_lie_as_those_of_a_rig_do() -> None:
    assert unit_of(520) == (
        "centimetres or in millimetres? Then cameras lie up to 5.2 m or 0.52 m apart: multiply translations by 0.01 or"
        " 0.001, or set the option scale where the layout has it"
    )
    assert unit_of(5200).startswith("millimetres? Then cameras lie up to 5.2 m apart: multiply translations by 0.001,")
    assert unit_of(1e6) == unit_of(5.2) == ""
