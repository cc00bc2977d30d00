"""The pose2sim importer: half a pixel, what is found by itself, and a sentence for everything wrong."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from posegaussian.storage.importers.find import find_capture
from posegaussian.storage.model.capture import Capture
from posegaussian.storage.model.crop import Crop
from posegaussian.storage.model.errors import CalibrationError, SourceError, UserError
from posegaussian.storage.readers.sources import open_source
from tests.support import import_capture
from tests.support.video_clips import counted, counting_clip


def table(v: int, name: str, **changes: str) -> str:
    fields = {
        "size": str(list(map(float, import_capture.SIZE))),
        "matrix": str(import_capture.K[v].tolist()),
        "distortions": str(import_capture.DISTORTION[v].tolist()),
        "rotation": str(import_capture.RODRIGUES[v].tolist()),
        "translation": str(import_capture.TRANSLATION[v].tolist()),
        "fisheye": "false",
        **changes,
    }
    return f"[{name}]\n" + "".join(f"{k} = {x}\n" for k, x in fields.items() if x)


def write_calibration(
    base: Path, names: tuple[str, ...] = ("int_cam1_img", "int_cam2_img", "int_cam10_img"), **changes: str
) -> Path:
    path = base / "calib" / "Calib.toml"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("".join(table(v, n, **changes) for v, n in enumerate(names)) + "[metadata]\nerror = 0.0\n")
    return path


@pytest.fixture
def base(tmp_path):
    (tmp_path / "videos").mkdir()
    for name in import_capture.NAMES:
        counting_clip(tmp_path / "videos" / f"{name}.mp4", 6, import_capture.SIZE)
    write_calibration(tmp_path)
    return tmp_path


def write_joints(base: Path, folder: str = "pose/25b", frames: int = 6) -> None:
    for v, name in enumerate(import_capture.NAMES):
        for n in range(frames):
            body = {"people": [{"person_id": [-1], "pose_keypoints_2d": import_capture.people(v).reshape(-1).tolist()}]}
            import_capture.dump(base / folder / f"{name}_json" / f"{name}.{n:04d}.json", body)


def find(base: Path, **options: object) -> Capture:
    return find_capture("pose2sim", base, options)


def test_everything_is_half_a_pixel_further(base):
    write_joints(base)
    capture = find(base)
    np.testing.assert_allclose(
        import_capture.imported_pixels(capture.rig), import_capture.known_pixels() + 0.5, atol=1e-11
    )  # float64 rounding of ~60 px
    joints = open_source(capture, "joints")
    assert joints.joint_set == "body_25b"
    for v in range(3):
        found = joints.read(v, 2)
        assert found.shape == (1, 25, 3)
        np.testing.assert_allclose(found[0, 0, :2], import_capture.imported_pixels(capture.rig)[v], atol=1e-11)
        assert found[0, 3, 2] == 0
        assert found[0, 4, 2] == 0.75


def test_cameras_are_named_after_videos_in_natural_order(base):
    (base / "Config.toml").write_text("[project]\nframe_rate = 60\n")
    (base / "notes.txt").write_text("extra files are ignored")
    capture = find(base)
    assert capture.rig.names == import_capture.NAMES
    assert capture.frame_rate == 30
    np.testing.assert_array_equal(capture.numbers, range(6))
    pictures = open_source(capture, "pictures")
    assert pictures.size(0) == import_capture.SIZE
    assert [counted(p) for p in pictures.read(1, [1, 4])] == [1, 4]
    assert json.loads(json.dumps(capture.to_json())) == json.loads(
        json.dumps(Capture.from_json(json.loads(json.dumps(capture.to_json()))).to_json())
    )


@pytest.mark.parametrize(
    "names",
    [import_capture.NAMES, ("cameras.1", "cameras.2", "cameras.10"), ("1", "2", "10"), ("cam_1", "cam_2", "cam_10")],
)
def test_tables_are_matched_by_name_and_index(base, names):
    write_calibration(base, names)
    np.testing.assert_allclose(
        import_capture.imported_pixels(find(base).rig), import_capture.known_pixels() + 0.5, atol=1e-11
    )


def test_rotation_as_a_matrix_is_the_same(base):
    from posegaussian.storage.importers.cameras import rotation_matrix

    by_vector = find(base).rig
    text = "".join(
        table(v, n, rotation=str(rotation_matrix(import_capture.RODRIGUES[v]).tolist()))
        for v, n in enumerate(import_capture.NAMES)
    )
    (base / "calib" / "Calib.toml").write_text(text)
    np.testing.assert_allclose(find(base).rig.world_to_camera, by_vector.world_to_camera, atol=1e-14)


def test_rodrigues_is_opencv_s():
    import cv2

    from posegaussian.storage.importers.cameras import rotation_matrix

    for vector in [*import_capture.RODRIGUES, np.zeros(3), np.array([1e-9, 0, 0]), np.array([0, np.pi, 0])]:
        np.testing.assert_allclose(rotation_matrix(vector), cv2.Rodrigues(vector)[0], atol=1e-14)


def test_a_size_mismatch_says_both_sizes_and_the_setting(base):
    counting_clip(base / "videos" / "cam2.mp4", 6, (32, 32))
    with pytest.raises(
        CalibrationError,
        match=r"camera cam2: pictures are 32x32 px, the calibration is for 64x48 px; that is another shape",
    ) as refused:
        find(base)
    copied = yaml.safe_load("\n".join(line for line in str(refused.value).splitlines() if line.startswith(" ")))
    assert copied == {"frames": {"crop": {"cam2": {"scale": 2, "offset": [0, -8]}}}}
    capture = find(base, crop={"cam2": {"scale": 2, "offset": [0, -8]}})
    assert capture.pictures[1].size == (32, 32)
    assert tuple(capture.rig.size[1]) == import_capture.SIZE
    assert capture.crops == {"cam2": Crop(scale=2, offset=(0, -8))}
    with pytest.raises(CalibrationError, match=r"frames\.crop names cam3, but"):
        find(base, crop={"cam3": {"scale": 2}})


def test_a_shorter_video_keeps_the_longest(base):
    counting_clip(base / "videos" / "cam2.mp4", 4, import_capture.SIZE)
    capture = find(base)
    assert len(capture.numbers) == 6
    assert open_source(capture, "pictures").numbers(1).tolist() == [0, 1, 2, 3]
    assert "camera cam2 lacks pictures of 2 frames (4-5)" in capture.notes
    with pytest.raises(SourceError, match="not 5"):
        list(open_source(capture, "pictures").read(1, [5]))


def test_trc_is_taken_when_there_is_one(base):
    from posegaussian.storage.model.joint_sets import JOINT_SETS

    names = JOINT_SETS["trc21"].names
    world = np.arange(63).reshape(21, 3) * 0.01
    row = "\t".join(str(x) for p in world for x in (p[1] * 1000, p[2] * 1000, p[0] * 1000))
    header = (
        "PathFileType\t4\t(X/Y/Z)\ta.trc\nDataRate\tNumMarkers\tUnits\n30\t21\tmm\n"
        f"Frame#\tTime\t{(chr(9) * 3).join(names)}\n\t\tX1\n"
    )
    (base / "a.trc").write_text(f"{header}1\t0.0\t{row}\n2\t0.1\t\n")
    capture = find(base)
    joints = open_source(capture, "joints3d")
    assert joints.joint_set == "trc21"
    np.testing.assert_allclose(joints.read(0), np.column_stack([world, np.ones(21)]), atol=1e-15)
    assert not joints.read(1).any()
    assert not joints.read(5).any()
    (base / "b.trc").write_text((base / "a.trc").read_text())
    capture = find(base)
    assert capture.joints3d is None
    assert any("2 TRC files fit, none is used" in n for n in capture.notes)
    assert find(base, trc="b.trc").has("joints3d")
    (base / "b.trc").unlink()
    (base / "a.trc").write_text("odd")
    assert any("3D joints are left out" in n and "not a TRC file" in n for n in find(base).notes)


def test_joints_by_choice(base):
    write_joints(base, "pose/25b")
    write_joints(base, "pose/second", frames=4)
    with pytest.raises(
        SourceError, match=r"several folders hold joints: pose/25b, pose/second; choose one with the option joints"
    ):
        find(base)
    capture = find(base, joints="pose/second")
    assert open_source(capture, "joints").joint_set == "body_25"
    assert "camera cam1 lacks 2D joints of 2 frames (4-5)" in capture.notes
    assert open_source(capture, "joints").read(0, 5).shape == (0, 25, 3)
    assert open_source(find(base, joints="pose/second", joint_set="body_25b"), "joints").joint_set == "body_25b"
    with pytest.raises(SourceError, match="joint_set coco17 has 17"):
        find(base, joints="pose/second", joint_set="coco17")


def test_a_camera_may_have_no_joints(base):
    write_joints(base)
    for p in (base / "pose/25b/cam2_json").iterdir():
        p.unlink()
    capture = find(base)
    assert "camera cam2 has no 2D joints" in capture.notes
    assert open_source(capture, "joints").read(1, 0).shape == (0, 25, 3)


WRONG = {
    "no video": (lambda b: [p.unlink() for p in (b / "videos").iterdir()], "no video in"),
    "unreadable video": (lambda b: (b / "videos/cam1.mp4").write_text("x"), r"cannot read video .*cam1\.mp4"),
    "no calibration": (lambda b: (b / "calib/Calib.toml").unlink(), "no calibration in"),
    "broken calibration": (lambda b: (b / "calib/Calib.toml").write_text("[a\n"), r"Calib\.toml cannot be read"),
    "two calibrations": (
        lambda b: (b / "other.toml").write_text(table(0, "cam1")),
        r"several calibrations fit: calib/Calib\.toml, other\.toml",
    ),
    "video without calibration": (
        lambda b: write_calibration(b, ("cam1", "cam2")),
        r"cam10\.mp4 has no calibration in Calib\.toml, which holds cam1, cam2",
    ),
    "nothing matches": (lambda b: write_calibration(b, ("left", "right")), r"cam1\.mp4 has no calibration"),
    "NaN": (lambda b: write_calibration(b, translation="[0.1, nan, 3.0]"), "camera cam1: world_to_camera holds nan"),
    "fisheye": (lambda b: write_calibration(b, fisheye="true"), "camera cam1: fisheye = true"),
    "no extrinsics": (lambda b: write_calibration(b, rotation=""), "camera cam1: its calibration has no rotation"),
    "mirrored": (
        lambda b: write_calibration(b, rotation="[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]]"),
        "determinant -1",
    ),
    "skew": (
        lambda b: write_calibration(b, matrix="[[70.0, 3.0, 30.0], [0.0, 70.0, 20.0], [0.0, 0.0, 1.0]]"),
        "skew 3 px",
    ),
    "text": (lambda b: write_calibration(b, matrix='"K"'), "matrix 'K' is not made of numbers"),
    "wrong count": (lambda b: write_calibration(b, translation="[1.0, 2.0]"), "translation has 2 numbers, expected 3"),
    "bad size": (lambda b: write_calibration(b, size="[64.5, 48.0]"), "positive whole numbers"),
    "thin prism": (
        lambda b: write_calibration(b, distortions=str([0.0] * 8 + [0.1] * 4)),
        "12 distortion coefficients",
    ),
    "two rates": (
        lambda b: counting_clip(b / "videos/cam2.mp4", 6, import_capture.SIZE, rate=25),
        "camera cam1 runs at 30 frames/s and camera cam2 at 25",
    ),
    "one name twice": (
        lambda b: counting_clip(b / "videos/cam1.mkv", 6, import_capture.SIZE),
        r"two videos would be camera cam1: cam1\.mkv and cam1\.mp4",
    ),
    "two folders": (lambda b: counting_clip(b / "cam1.mp4", 6, import_capture.SIZE), None),
    "broken joints": (
        lambda b: import_capture.dump(b / "pose/cam1_json/cam1.0000.json", {"people": [{"pose_keypoints_2d": [1, 2]}]}),
        "not .x, y, score. triples",
    ),
    "one table for two": (
        lambda b: (
            counting_clip(b / "videos/view1.mp4", 6, import_capture.SIZE),
            write_calibration(b, ("1", "2", "10")),
        ),
        "fits two videos, view1 and cam1",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_input_gets_a_sentence(base, case):
    change, sentence = WRONG[case]
    change(base)
    if sentence is None:
        assert find(base).rig.names == import_capture.NAMES  # the folder named videos goes before others
        return
    with pytest.raises(UserError, match=sentence):
        find(base)


def test_wrong_sources_and_options(base, tmp_path_factory):
    with pytest.raises(SourceError, match="no such folder"):
        find(base / "nowhere")
    with pytest.raises(SourceError, match="is empty"):
        find(tmp_path_factory.mktemp("empty"))
    with pytest.raises(SourceError, match="give the capture's folder"):
        find(base / "videos" / "cam1.mp4")
    with pytest.raises(SourceError, match=r"colour.*known are"):
        find(base, colour="red")
    with pytest.raises(SourceError, match=r"option calibration: no such file"):
        find(base, calibration="nope.toml")
    with pytest.raises(SourceError, match="no pictures of a camera named cam7"):
        find(base, cameras=["cam7"])
    with pytest.raises(SourceError, match="unknown layout 'dng'"):
        find_capture("dng", base, {})


def test_some_cameras_or_one(base):
    capture = find(base, cameras=["cam10"])
    assert capture.rig.names == ("cam10",)
    assert any("one camera only" in n for n in capture.notes)
    assert find(base, cameras=["cam2", "cam1"]).rig.names == ("cam2", "cam1")


def test_odd_but_valid_rigs_are_told(base):
    (base / "videos" / "cam10.mp4").unlink()
    write_calibration(base)
    assert "calibration int_cam10_img has no video and is left out" in find(base).notes
    for factor in (200, 1000):
        text = "".join(
            table(v, n, translation=str((import_capture.TRANSLATION[v] * factor).tolist()))
            for v, n in enumerate(import_capture.NAMES)
        )
        (base / "calib" / "Calib.toml").write_text(text)
        if factor == 200:
            assert any("millimetres" in n for n in find(base).notes)
        else:
            with pytest.raises(
                CalibrationError, match=r"camera cam1: its translation holds 3000 m, .* is it in millimetres"
            ):
                find(base)


def test_a_changed_file_is_noticed(base):
    capture = find(base)
    counting_clip(base / "videos" / "cam1.mp4", 9, import_capture.SIZE)
    with pytest.raises(SourceError, match=r"cam1\.mp4 changed since it was imported"):
        list(open_source(capture, "pictures").read(0, [0]))
    (base / "videos" / "cam2.mp4").unlink()
    with pytest.raises(SourceError, match=r"cam2\.mp4 cannot be read any more"):
        list(open_source(capture, "pictures").read(1, [0]))
