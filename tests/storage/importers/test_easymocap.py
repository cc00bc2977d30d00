"""The easymocap importer: half a pixel for cameras, joints and boxes; masks; and a sentence for everything wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from posegaussian.storage.importers.cameras import rotation_matrix
from posegaussian.storage.importers.easymocap import read_opencv_yaml
from posegaussian.storage.importers.find import find_capture
from posegaussian.storage.model.capture import Capture
from posegaussian.storage.model.errors import CalibrationError, UserError
from posegaussian.storage.readers.images import write_png
from posegaussian.storage.readers.sources import open_source
from tests.support import import_capture
from tests.support.video_clips import counting_clip

NAMES = ("01", "02", "10")


def matrix(key: str, values: np.ndarray) -> str:
    values = np.atleast_2d(values)
    data = ", ".join(repr(float(x)) for x in values.reshape(-1))
    return f"{key}: !!opencv-matrix\n  rows: {values.shape[0]}\n  cols: {values.shape[1]}\n  dt: d\n  data: [{data}]\n"


def write_calibration(
    base: Path, names: tuple[str, ...] = NAMES, translation: np.ndarray = import_capture.TRANSLATION
) -> None:
    # names without quotes on purpose: 01 must stay "01"
    head = "%YAML:1.0\n---\nnames:\n" + "".join(f"  - {n}\n" for n in names)
    intri = "".join(
        matrix(f"K_{n}", import_capture.K[v])
        + matrix(f"D_{n}", import_capture.DISTORTION[v][:, None])
        + f"H_{n}: 48\nW_{n}: 64\n"
        for v, n in enumerate(names)
    )
    extri = "".join(
        matrix(f"R_{n}", import_capture.RODRIGUES[v][:, None]) + matrix(f"T_{n}", translation[v][:, None])
        for v, n in enumerate(names)
    )
    (base / "intri.yml").write_text(head + intri)
    (base / "extri.yml").write_text(head + extri)


def rename(file: Path, old: str, new: str) -> None:
    file.write_text(file.read_text().replace(old, new))


@pytest.fixture
def base(tmp_path):
    import_capture.pictures(tmp_path / "images", NAMES)
    write_calibration(tmp_path)
    return tmp_path


def find(base: Path, **options: object) -> Capture:
    return find_capture("easymocap", base, options)


def write_joints(base: Path) -> None:
    for v, name in enumerate(NAMES):
        u, w = import_capture.known_pixels()[v]
        for n in range(3):
            person = {
                "personID": 0,
                "bbox": [u - 4, w - 5, u + 6, w + 7, 0.9],
                "keypoints": import_capture.people(v).tolist(),
            }
            import_capture.dump(
                base / "annots" / name / f"{n:06d}.json",
                {"filename": f"images/{name}/{n:06d}.jpg", "annots": [person] if n else []},
            )


def test_everything_is_half_a_pixel_further(base):
    write_joints(base)
    capture = find(base)
    assert capture.rig.names == NAMES
    np.testing.assert_allclose(
        import_capture.imported_pixels(capture.rig), import_capture.known_pixels() + 0.5, atol=1e-11
    )  # float64 rounding of ~60 px
    joints = open_source(capture, "joints")
    assert joints.joint_set == "body_25"
    for v in range(3):
        pixel = import_capture.imported_pixels(capture.rig)[v]
        np.testing.assert_allclose(joints.read(v, 1)[0, 0], [*pixel, 0.75], atol=1e-11)
        np.testing.assert_allclose(joints.boxes(v, 1), [[*(pixel - [4, 5]), *np.add(pixel, [6, 7]), 0.9]], atol=1e-11)
        assert joints.read(v, 0).shape == (0, 25, 3)
        assert joints.boxes(v, 0).shape == (0, 5)


def test_the_parser_agrees_with_opencv(base):
    import cv2

    storage = cv2.FileStorage(str(base / "written.yml"), cv2.FILE_STORAGE_WRITE)
    values = {
        "K_a": import_capture.K[0],
        "T_a": np.array([[1e-20], [1e20], [-3.0]]),
        "bad": np.array([[np.nan, np.inf, 1.0]]),
    }
    for key, value in values.items():
        storage.write(key, value)
    storage.release()
    read = read_opencv_yaml(base / "written.yml")
    for key, value in values.items():
        np.testing.assert_array_equal(read[key], value)


def test_a_rotation_matrix_goes_before_the_vector(base):
    by_vector = find(base).rig
    with (base / "extri.yml").open("a") as f:
        f.write("".join(matrix(f"Rot_{n}", rotation_matrix(import_capture.RODRIGUES[v])) for v, n in enumerate(NAMES)))
    np.testing.assert_allclose(find(base).rig.world_to_camera, by_vector.world_to_camera, atol=1e-14)


def test_two_rotations_of_one_camera_that_differ_are_said(base):
    assert not any("different rotations" in n for n in find(base).notes)
    other = import_capture.RODRIGUES[1] + [0, 0.01, 0]
    with (base / "extri.yml").open("a") as f:
        f.write(matrix(f"Rot_{NAMES[0]}", rotation_matrix(import_capture.RODRIGUES[0])))
        f.write(matrix(f"Rot_{NAMES[1]}", rotation_matrix(other)))
    told = "camera 02: R_ and Rot_ are different rotations; Rot_ is taken, and EasyMocap itself reads R_"
    assert [n for n in find(base).notes if "different rotations" in n] == [told]


def test_videos_or_images(base):
    (base / "videos").mkdir()
    for name in NAMES:
        counting_clip(base / "videos" / f"{name}.mp4", 5, import_capture.SIZE, rate=25)
    assert len(find(base).numbers) == 3
    capture = find(base, pictures="videos")
    assert (len(capture.numbers), capture.frame_rate) == (5, 25)
    assert find(base, frame_rate=50).frame_rate == 50


@pytest.mark.parametrize("folder", ["mask", "masks"])
@pytest.mark.parametrize("top", [255, 1])
def test_soft_masks(base, folder, top):
    soft = np.zeros((48, 64), np.uint8)
    soft[10:20, 10:20] = top
    if top == 255:
        soft[9, 10:20] = 100
    for name in NAMES:
        (base / folder / name).mkdir(parents=True)
        for n in range(3):
            write_png(base / folder / name / f"{n:06d}.png", soft)
    masks = list(open_source(find(base), "masks").read(2, [0, 2]))
    np.testing.assert_array_equal(masks, np.stack([soft, soft]) * np.uint8(255 // top))


def test_masks_that_are_missing(base):
    import_capture.pictures(base / "masks", NAMES, frames=(0, 1))
    capture = find(base)
    assert "camera 01 lacks masks of 1 frames (2)" in capture.notes
    with pytest.raises(UserError, match="camera 01 has no masks of frame 2"):
        list(open_source(capture, "masks").read(0, [2]))
    for p in (base / "masks" / "02").iterdir():
        p.unlink()
    with pytest.raises(UserError, match="cameras 02 have no masks while others have"):
        find(base)


def test_frames_that_a_camera_lacks(base):
    (base / "images/02/000001.png").unlink()
    capture = find(base)
    assert "camera 02 lacks pictures of 1 frames (1)" in capture.notes
    assert open_source(capture, "pictures").numbers(1).tolist() == [0, 2]
    assert [int(p[0, 0, 0]) for p in open_source(capture, "pictures").read(1, [0, 2])] == [1, 21]
    with pytest.raises(UserError, match="camera 02 has no pictures of frame 1"):
        list(open_source(capture, "pictures").read(1, [1]))


WRONG = {
    "mask of another size": (
        lambda b: import_capture.pictures(b / "masks", NAMES, size=(32, 48)),
        r"mask .* is 32x48 px, its picture is 64x48 px",
    ),
    "no intri": (lambda b: (b / "intri.yml").unlink(), r"cannot read calibration .*intri\.yml: No such file"),
    "broken yaml": (lambda b: (b / "extri.yml").write_text("a: [1,"), r"extri\.yml:1:7: not valid YAML"),
    "bad matrix": (
        lambda b: (b / "intri.yml").write_text(
            "K_01: !!opencv-matrix\n  rows: 3\n  cols: 3\n  dt: d\n  data: [1, 2]\n"
        ),
        r"intri\.yml: not valid YAML",
    ),
    "camera without calibration": (
        lambda b: write_calibration(b, ("01", "02")),
        r"camera 10 has pictures but is not in .*intri\.yml, which names 01, 02",
    ),
    "no extrinsics": (
        lambda b: (b / "extri.yml").write_text("names: []\n"),
        r"camera 01: extri\.yml has no Rot_01 or R_01",
    ),
    "NaN": (
        lambda b: write_calibration(b, translation=import_capture.TRANSLATION * np.nan),
        "camera 01: world_to_camera holds nan",
    ),
    "calibrated twice": (
        lambda b: write_calibration(b, ("01", "01", "10")),
        r"intri\.yml:19:1: not valid YAML: 'K_01' is given twice",
    ),
    "named twice": (
        lambda b: rename(b / "intri.yml", "  - 01\n", "  - 01\n  - 01\n"),
        "camera name '01' occurs 2 times",
    ),
    "no pictures": (
        lambda b: import_capture.pictures(b / "images", NAMES, ()) or [p.unlink() for p in b.glob("images/*/*")],
        "no pictures in",
    ),
    "two sizes in a view": (
        lambda b: import_capture.pictures(b / "images", ("01",), (7,), (32, 32)),
        "one camera has one size",
    ),
    "another size": (
        lambda b: import_capture.pictures(b / "images", NAMES, size=(32, 32)),
        r"(?s)pictures are 32x32 px, the calibration is for 64x48 px.*scale: 2, offset: \[0, -8\]",
    ),
    "one frame twice": (
        lambda b: write_png(b / "images/01/1.png", np.zeros((48, 64), np.uint8)),
        "two files are frame 1",
    ),
    "no number": (
        lambda b: write_png(b / "images/01/first.png", np.zeros((48, 64), np.uint8)),
        r"first\.png holds no frame number",
    ),
    "no picture": (lambda b: (b / "images/01/000001.png").write_text("x"), r"cannot read picture .*000001\.png"),
    "joints of odd length": (
        lambda b: import_capture.dump(b / "annots/01/000001.json", {"annots": [{"keypoints": [[1, 2, 1]] * 7}]}),
        "holds 7 joints a person, which no known joint set has",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_input_gets_a_sentence(base, case):
    change, sentence = WRONG[case]
    change(base)
    with pytest.raises(UserError, match=sentence):
        find(base)


def test_calibration_without_camera(base):
    write_calibration(base, ("01", "02", "10"))
    for p in (base / "images/10").iterdir():
        p.unlink()
    assert "calibration 10 has no pictures and is left out" in find(base).notes
    with pytest.raises(CalibrationError, match=r"frames\.crop names 11, but the cameras are 01, 02"):
        find(base, crop={"11": {"scale": 2}})
