"""The images importer: both pixel conventions, all joint files, and a sentence for everything wrong."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from posegaussian.storage.importers.cameras import rotation_matrix
from posegaussian.storage.importers.find import find_capture
from posegaussian.storage.model.capture import Capture
from posegaussian.storage.model.errors import UserError
from posegaussian.storage.readers.images import write_exr, write_png
from posegaussian.storage.readers.sources import open_source
from tests.support import import_capture


def cameras(pixel_center: str = "integer", **first: object) -> dict[str, object]:
    entries = [
        {
            "name": n,
            "width": 64,
            "height": 48,
            "K": import_capture.K[v].tolist(),
            "R": rotation_matrix(import_capture.RODRIGUES[v]).tolist(),
            "t": import_capture.TRANSLATION[v].tolist(),
            "distortion": import_capture.DISTORTION[v].tolist(),
        }
        for v, n in enumerate(import_capture.NAMES)
    ]
    entries[0] |= first
    return {"pixel_center": pixel_center, "frame_rate": 24, "cameras": entries}


@pytest.fixture
def base(tmp_path):
    import_capture.pictures(tmp_path / "images")
    import_capture.dump(tmp_path / "cameras.json", cameras())
    return tmp_path


def find(base: Path, **options: object) -> Capture:
    return find_capture("images", base, options)


def coco(v: int, prefix: str = "", **more: object) -> dict[str, list[object]]:
    """Frames 0 and 1 with one person of 17 joints, frame 2 with none; a box around the known point."""
    u, w = import_capture.known_pixels()[v]
    people = [
        {
            "id": 10 * v + n,
            "image_id": 10 * v + n,
            "keypoints": import_capture.people(v)[:17].reshape(-1).tolist(),
            "bbox": [u - 4, w - 5, 10, 12],
            "score": 0.9,
        }
        for n in range(2)
    ]
    return {
        "images": [{"id": 10 * v + n, "file_name": f"{prefix}{n:06d}.png"} for n in range(3)],
        "annotations": people,
        **more,
    }


def test_everything_is_half_a_pixel_further(base):
    for v, name in enumerate(import_capture.NAMES):
        import_capture.dump(base / "joints" / f"{name}.json", coco(v))
    capture = find(base)
    assert (capture.frame_rate, capture.rig.names) == (24, import_capture.NAMES)
    np.testing.assert_allclose(
        import_capture.imported_pixels(capture.rig), import_capture.known_pixels() + 0.5, atol=1e-11
    )  # float64 rounding of ~60 px
    joints = open_source(capture, "joints")
    assert joints.joint_set == "coco17"
    for v in range(3):
        pixel = import_capture.imported_pixels(capture.rig)[v]
        np.testing.assert_allclose(joints.read(v, 1)[0, 0], [*pixel, 0.75], atol=1e-11)
        np.testing.assert_allclose(joints.boxes(v, 1), [[*(pixel - [4, 5]), *np.add(pixel, [6, 7]), 0.9]], atol=1e-11)
        assert joints.read(v, 2).shape == (0, 17, 3)


def test_half_centres_are_taken_as_they_are(base):
    import_capture.dump(base / "cameras.json", cameras("half"))
    import_capture.dump(base / "joints" / "cam1.json", coco(0, pixel_center="half"))
    capture = find(base)
    np.testing.assert_allclose(import_capture.imported_pixels(capture.rig), import_capture.known_pixels(), atol=1e-11)
    joints = open_source(capture, "joints")
    np.testing.assert_allclose(joints.read(0, 0)[0, 0, :2], import_capture.known_pixels()[0], atol=0)
    np.testing.assert_allclose(joints.boxes(0, 0)[0, :2], import_capture.known_pixels()[0] - [4, 5], atol=1e-13)
    assert joints.read(1, 0).shape == (0, 17, 3)
    assert "camera cam2 has no 2D joints" in capture.notes


def test_one_coco_file_for_all_views(base):
    parts = [coco(v, f"images/{n}/") for v, n in enumerate(import_capture.NAMES)]
    import_capture.dump(
        base / "joints.json", {k: [item for p in parts for item in p[k]] for k in ("images", "annotations")}
    )
    joints = open_source(find(base), "joints")
    for v in range(3):
        np.testing.assert_allclose(joints.read(v, 1)[0, 0, :2], import_capture.known_pixels()[v] + 0.5, atol=1e-11)


def test_openpose_folders(base):
    for v, name in enumerate(import_capture.NAMES):
        for n in range(3):
            flat = import_capture.people(v).reshape(-1).tolist()
            import_capture.dump(
                base / "joints" / name / f"{name}_{n:012d}_keypoints.json",
                {"people": [{"pose_keypoints_2d": flat}, {}, {"pose_keypoints_2d": []}, {"pose_keypoints_2d": flat}]},
            )
    joints = open_source(find(base), "joints")
    assert joints.joint_set == "body_25"
    assert joints.read(2, 2).shape == (2, 25, 3)
    np.testing.assert_allclose(joints.read(2, 2)[1, 0, :2], import_capture.known_pixels()[2] + 0.5, atol=1e-11)


CIRCLED, SQUARED, ARABIC = "\u2460\u2461\u2462", ("cam1\u00b2", "cam2\u00b2", "cam10\u00b2"), "\u0661\u0662\u0663"


@pytest.mark.parametrize("names", [CIRCLED, SQUARED, ARABIC])
def test_digits_that_are_no_numbers_are_names_as_any(tmp_path: Path, names: Sequence[str]) -> None:
    data = cameras()
    for entry, name in zip(data["cameras"], names, strict=True):  # type: ignore[call-overload]
        entry["name"] = name
    import_capture.pictures(tmp_path / "images", tuple(names))
    import_capture.dump(tmp_path / "cameras.json", data)
    assert find(tmp_path).rig.names == tuple(names)


def test_numbers_come_from_file_names(base):
    import_capture.pictures(base / "images", frames=(3, 12, 20))
    for p in base.glob("images/*/00000[0-2].png"):
        p.unlink()
    capture = find(base)
    assert capture.numbers.tolist() == [3, 12, 20]
    with pytest.raises(UserError, match="no pictures of frame 4"):
        list(open_source(capture, "pictures").read(0, [3, 4]))


def write(path: Path, values: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    (write_png if values.dtype == np.uint8 else write_exr)(path, values)


def change(base: Path, **first: object) -> None:
    import_capture.dump(base / "cameras.json", cameras(**first))


WRONG = {
    "no pixel_center": (
        lambda b: import_capture.dump(b / "cameras.json", {"cameras": []}),
        "pixel_center: Field required",
    ),
    "another pixel_center": (
        lambda b: import_capture.dump(b / "cameras.json", cameras("corner")),
        "pixel_center: Input should be 'integer' or 'half'",
    ),
    "no file": (lambda b: (b / "cameras.json").unlink(), r"cannot read .*cameras\.json"),
    "no JSON": (lambda b: (b / "cameras.json").write_text("{"), r"cameras\.json:1:2: not valid JSON"),
    "no cameras": (
        lambda b: import_capture.dump(b / "cameras.json", {"pixel_center": "half", "cameras": []}),
        "names no cameras",
    ),
    "no K": (lambda b: change(b, K=None), "cameras.0.K: Input should be a valid list"),
    "NaN": (lambda b: change(b, t=[float("nan"), 0, 0]), "camera cam1: world_to_camera holds nan"),
    "K of 4": (lambda b: change(b, K=[1, 2, 3, 4]), "K has 4 numbers, expected 9"),
    "not rigid": (lambda b: change(b, R=[[2, 0, 0], [0, 1, 0], [0, 0, 1]]), "rotation is off a rigid one by 3"),
    "negative focal length": (
        lambda b: change(b, K=[[-70, 0, 30], [0, 70, 20], [0, 0, 1]]),
        r"focal lengths \(-70, 70\)",
    ),
    "duplicate": (lambda b: change(b, name="cam2"), "camera name 'cam2' occurs 2 times"),
    "bad name": (
        lambda b: (change(b, name="a:b"), (b / "images/cam1").rename(b / "images/a:b")),
        "cannot name a folder",
    ),
    "size": (lambda b: change(b, width=128), r"camera cam1: pictures are 64x48 px, the calibration is for 128x48 px"),
    "no camera for a folder": (
        lambda b: import_capture.pictures(b / "images", ("extra",)),
        r"images/extra have no camera in .*cameras\.json.*; add it there, or .* --option cameras=cam1,cam2,cam10$",
    ),
    "no pictures": (lambda b: [p.unlink() for p in b.glob("images/*/*")], "no pictures in"),
    "depth size": (
        lambda b: write(b / "depth/cam1/000000.exr", np.ones((3, 3), np.float32)),
        "depth .* is 3x3 px, its picture is 64x48",
    ),
    "joints two ways": (
        lambda b: (
            import_capture.dump(b / "joints.json", coco(0)),
            import_capture.dump(b / "joints/cam1.json", coco(0)),
        ),
        r"joints as joints\.json and as joints/NAME\.json",
    ),
    "joints without list": (
        lambda b: import_capture.dump(b / "joints/cam1.json", {"images": []}),
        r"cam1\.json has no list 'annotations'",
    ),
    "joints of odd convention": (
        lambda b: import_capture.dump(b / "joints/cam1.json", coco(0, pixel_center="edge")),
        "pixel_center is 'edge'",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_input_gets_a_sentence(base, case):
    change_it, sentence = WRONG[case]
    change_it(base)
    with pytest.raises(UserError, match=sentence):
        find(base)


def test_a_camera_without_pictures_is_told(base):
    for p in (base / "images/cam2").iterdir():
        p.unlink()
    capture = find(base)
    assert capture.rig.names == ("cam1", "cam10")
    assert "camera cam2 has no pictures and is left out" in capture.notes


def test_equal_sources_have_equal_digests(base):
    one, two = find(base), find(base)
    assert one.rig.digest == two.rig.digest
    assert one.pictures[0].digest([0, 1]) == two.pictures[0].digest([0, 1])
    write_png(base / "images/cam1/000001.png", np.full((48, 64, 3), 9, np.uint8))
    assert one.pictures[0].digest([0, 2]) == find(base).pictures[0].digest([0, 2])
    assert one.pictures[0].digest([0, 1]) != find(base).pictures[0].digest([0, 1])
    assert json.dumps(one.to_json()) != json.dumps(find(base).to_json())


def test_cameras_held_out_are_those_that_the_layout_marks_or_the_option_names(base):
    assert find(base).held_out == ()
    import_capture.dump(base / "cameras.json", cameras(held_out=True))
    marked = find(base)
    assert marked.held_out == ("cam1",)
    assert "held out, for metrics alone: cam1; views.held_out overrules it" in marked.notes
    for given in ("cam10,cam2", ["cam2", "cam10"]):
        assert find(base, held_out=given).held_out == ("cam2", "cam10")
    with pytest.raises(UserError, match="option held_out: there is no camera cam3; there are cam1, cam2, cam10"):
        find(base, held_out="cam3")
    with pytest.raises(UserError, match="no camera is left as a source"):
        find(base, held_out="cam1,cam2,cam10")
    assert find(base, cameras="cam2,cam10").held_out == ()


def subject_masks(base: Path, white: int, black: int) -> None:
    """A subject of 20 x 30 px in the middle of every picture."""
    for name in import_capture.NAMES:
        for picture in sorted((base / "images" / name).iterdir()):
            mask = np.full((48, 64), black, np.uint8)
            mask[9:39, 22:42] = white
            (base / "masks" / name).mkdir(parents=True, exist_ok=True)
            write_png(base / "masks" / name / f"{picture.stem}.png", mask)


@pytest.mark.parametrize(("white", "black"), [(255, 0), (1, 0), (0, 255), (0, 1)])
def test_masks_that_mark_the_background_are_named_at_once(base, white, black):
    """Whatever they are written in: 0 and 255, or 0 and 1, which are read as the same."""
    subject_masks(base, white, black)
    capture = find(base)
    assert any("mark the background" in n for n in capture.notes) == (white < black)
    assert any("hold only 0 and 1" in n for n in capture.notes) == (max(white, black) == 1)
    assert int(next(iter(open_source(capture, "masks").read(0, [0])))[20, 30]) == (0 if white < black else 255)


def in_units(base: Path, metre: float) -> Path:
    """The same capture, lengths in units of which a metre has so many: poses, and depth maps and true depth of 3 m."""
    data = cameras()
    for v, entry in enumerate(data["cameras"]):  # type: ignore[arg-type, var-annotated]
        entry["t"] = (metre * import_capture.TRANSLATION[v]).tolist()
        for kind in ("depth_maps", "depth"):
            write(base / kind / entry["name"] / "000001.exr", np.full((48, 64), 3 * metre, np.float32))
    import_capture.dump(base / "cameras.json", data)
    return base


@pytest.mark.parametrize("option", ["scale=0.01", "distance"])
@pytest.mark.parametrize("metre", [100.0, 0.5])
def test_a_unit_that_the_user_says_holds_for_poses_and_depth(base: Path, metre: float, option: str) -> None:
    """The law: whatever unit a capture is written in, it is the same capture."""
    exact = find(in_units(base, 1.0))
    apart = float(np.linalg.norm(exact.rig.centres[0] - exact.rig.centres[2]))
    given = {"scale": 1 / metre} if option != "distance" else {"distance": f"cam1,cam10,{apart}"}
    capture = find(in_units(base, metre), **given)
    np.testing.assert_allclose(capture.rig.world_to_camera, exact.rig.world_to_camera, atol=1e-12)
    for kind in ("depth_maps", "depth"):
        for v in range(3):
            (depth,) = open_source(capture, kind).read(v, [1])
            np.testing.assert_allclose(depth, 3, rtol=1e-6)
    (told,) = (n for n in capture.notes if n.startswith("unit:"))
    assert f"{1 / metre:g} m, as" in told
    assert "unit: metres, as the layout has it" in exact.notes


def test_depth_maps_of_a_unit_of_their_own_and_options_that_contradict(base: Path) -> None:
    in_units(base, 100.0)
    (depth,) = open_source(find(base, scale=0.01, depth_scale=0.02), "depth_maps").read(0, [1])
    np.testing.assert_allclose(depth, 6, rtol=1e-6)
    with pytest.raises(UserError, match="options scale and distance both say the unit"):
        find(base, scale=0.01, distance="cam1,cam10,2")


def test_a_little_skew_is_left_out_and_said_and_more_is_refused(base: Path) -> None:
    """By the px that it moves the picture's edge by, not by a share of the focal length."""
    for skew, said in ((1e-6, False), (0.02, True), (1.0, True)):
        change(base, K=(import_capture.K[0] + skew * np.eye(3, k=1) * [[1], [0], [0]]).tolist())
        capture = find(base)
        np.testing.assert_array_equal(capture.rig.intrinsics[:, 0, 1], 0)
        told = [
            n for n in capture.notes if n.startswith("skew of cam1 is left out: it moves a picture's edge by up to")
        ]
        assert bool(told) == said, skew
    change(base, K=(import_capture.K[0] + 1.5 * np.eye(3, k=1) * [[1], [0], [0]]).tolist())
    with pytest.raises(UserError, match=r"camera cam1: skew 1.5 px must be 0, or move .* at most 0\.5 px.* by 0\.7 px"):
        find(base)
