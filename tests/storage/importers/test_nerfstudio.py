"""The nerfstudio importer: OpenGL poses, intrinsics in head or frames, instants, masks and depth, and sentences."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from posegaussian.storage.importers.cameras import rotation_matrix
from posegaussian.storage.importers.find import find_capture
from posegaussian.storage.model.capture import Capture
from posegaussian.storage.model.errors import UserError
from posegaussian.storage.readers.images import write_png
from posegaussian.storage.readers.sources import open_source
from tests.support import import_capture


def pose(v: int) -> list[list[float]]:
    """Camera to world with x right, y up, z backwards: columns are the camera's axes and its place."""
    r = rotation_matrix(import_capture.RODRIGUES[v])
    right, down, forward = r
    centre = -r.T @ import_capture.TRANSLATION[v]
    return np.vstack([np.column_stack([right, -down, -forward, centre]), [0, 0, 0, 1]]).tolist()


def intrinsics(v: int) -> dict[str, float]:
    k, d = import_capture.K[v], import_capture.DISTORTION[v]
    return {
        "fl_x": k[0, 0], "fl_y": k[1, 1], "cx": k[0, 2] + 0.5, "cy": k[1, 2] + 0.5,
        "k1": d[0], "k2": d[1], "p1": d[2], "p2": d[3],
    }  # fmt: skip


def transforms(name: str = "images/{cam}/{n:06d}.png") -> dict[str, Any]:
    """Three cameras, three frames."""
    frames = [
        {"file_path": name.format(cam=c, n=n), "transform_matrix": pose(v), **intrinsics(v)}
        for n in range(3)
        for v, c in enumerate(import_capture.NAMES)
    ]
    return {"camera_model": "OPENCV", "w": 64, "h": 48, "frames": frames}


def write(base: Path, data: dict[str, Any], name: str = "transforms.json") -> Path:
    import_capture.dump(base / name, data)
    return base


@pytest.fixture
def base(tmp_path: Path) -> Path:
    import_capture.pictures(tmp_path / "images")
    return write(tmp_path, transforms())


def find(base: Path, **options: object) -> Capture:
    return find_capture("nerfstudio", base, options)


def test_the_known_point_lands_where_arithmetic_says(base: Path) -> None:
    capture = find(base)
    assert capture.rig.names == import_capture.NAMES
    np.testing.assert_allclose(  # centres half a pixel from OpenCV's; float64 rounding of ~60 px
        import_capture.imported_pixels(capture.rig), import_capture.known_pixels() + 0.5, atol=1e-11
    )
    assert [int(p[0, 0, 0]) for p in open_source(capture, "pictures").read(2, [0, 2])] == [2, 22]
    assert any("direction: camera to world; all cameras look at one point" in n for n in capture.notes)


def test_principal_points_of_the_other_pixel_centre(base: Path) -> None:
    right = find(base).rig
    data = transforms()
    for f in data["frames"]:
        f["cx"] -= 0.5
        f["cy"] -= 0.5
    moved = find(write(base, data), pixel_center="integer").rig
    np.testing.assert_allclose(moved.intrinsics, right.intrinsics, atol=1e-13)


def with_times(data: dict[str, Any], times: list[float]) -> dict[str, Any]:
    for at, f in enumerate(data["frames"]):
        f["time"] = times[at // 3]
    return data


@pytest.mark.parametrize(
    ("name", "label", "numbers"),
    [("images/{cam}/{n:06d}.png", None, [0, 1, 2]), ("images/{n:06d}_{cam}.png", "camera_label", [0, 1, 2])],
)
def test_times_and_labels_tell_instants_and_cameras(
    tmp_path: Path, name: str, label: str | None, numbers: list[int]
) -> None:
    data = with_times(transforms(name), [0.0, 0.4, 1.0])
    for at, f in enumerate(data["frames"]):
        if label:
            f[label] = import_capture.NAMES[at % 3]
        path = tmp_path / f["file_path"]
        path.parent.mkdir(parents=True, exist_ok=True)
        write_png(path, np.full((48, 64, 3), 10 * (at // 3) + at % 3, np.uint8))
    capture = find(write(tmp_path, data))
    assert capture.rig.names == import_capture.NAMES
    assert capture.numbers.tolist() == numbers
    assert [int(p[0, 0, 0]) for p in open_source(capture, "pictures").read(1, numbers)] == [1, 11, 21]


def test_names_that_contradict_the_times_count_from_zero(tmp_path: Path) -> None:
    """Frame 0 of one camera is filmed when another films frame 1."""
    data = with_times(transforms(), [0.0, 0.5, 1.0])
    import_capture.pictures(tmp_path / "images", frames=(0, 1, 2, 3))
    for at, f in enumerate(data["frames"]):
        if at % 3 == 1:
            f["file_path"] = f"images/cam2/{at // 3 + 1:06d}.png"
    capture = find(write(tmp_path, data))
    assert capture.numbers.tolist() == [0, 1, 2]
    assert [int(p[0, 0, 0]) for p in open_source(capture, "pictures").read(1, [0, 1, 2])] == [11, 21, 31]


def test_blender_scenes_have_an_angle_no_endings_and_alpha(tmp_path: Path) -> None:
    rgba = np.zeros((48, 64, 4), np.uint8)
    rgba[10:20, 10:20] = [90, 80, 70, 200]
    for split, views in (("train", (0, 1)), ("test", (2,))):
        (tmp_path / split).mkdir()
        frames = []
        for v in views:
            write_png(tmp_path / split / f"r_{v}.png", rgba)
            frames.append({"file_path": f"./{split}/r_{v}", "rotation": 0.0, "transform_matrix": pose(v)})
        write(tmp_path, {"camera_angle_x": 0.9, "frames": frames}, f"transforms_{split}.json")
    capture = find(tmp_path, moment=True)
    assert capture.rig.names == ("r_0", "r_1", "r_2")
    assert capture.held_out == ("r_2",)
    focal = 0.5 * 64 / np.tan(0.45)
    np.testing.assert_allclose(capture.rig.intrinsics[0], [[focal, 0, 32], [0, focal, 24], [0, 0, 1]], rtol=1e-14)
    mask = next(iter(open_source(capture, "masks").read(1, [0])))
    np.testing.assert_array_equal(mask, rgba[..., 3])


def test_masks_and_depth_are_those_the_file_names(base: Path) -> None:
    data = transforms()
    for at, f in enumerate(data["frames"]):
        f["mask_path"], f["depth_file_path"] = f"m/{at}.png", f"d/{at}.png"
        (base / "m").mkdir(exist_ok=True)
        (base / "d").mkdir(exist_ok=True)
        write_png(base / "m" / f"{at}.png", np.full((48, 64), 200 + at, np.uint8))
        cv2.imwrite(str(base / "d" / f"{at}.png"), np.full((48, 64), 2000 + at, np.uint16))
    capture = find(write(base, data))
    assert [int(m[0, 0]) for m in open_source(capture, "masks").read(1, [0, 1, 2])] == [201, 204, 207]
    depth = list(open_source(capture, "depth_maps").read(2, [0, 2]))
    np.testing.assert_allclose([d[0, 0] for d in depth], [2.002, 2.008], rtol=1e-6)  # float32
    scaled = find(base, scale=0.5)  # a thousandth of a unit that is half a metre
    np.testing.assert_allclose([d[0, 0] for d in open_source(scaled, "depth_maps").read(2, [0])], [1.001], rtol=1e-6)
    np.testing.assert_allclose(scaled.rig.centres, capture.rig.centres / 2, atol=1e-15)


def test_an_applied_scale_is_undone(base: Path) -> None:
    before = find(base).rig
    data = transforms()
    data["applied_scale"] = 0.05
    for f in data["frames"]:
        for row in f["transform_matrix"][:3]:
            row[3] *= 0.05
    np.testing.assert_allclose(find(write(base, data)).rig.centres, before.centres, atol=1e-14)
    np.testing.assert_allclose(find(base, scale=20).rig.centres, before.centres, atol=1e-14)
    del data["applied_scale"]
    with pytest.raises(UserError, match=r"cameras lie up to 0\.\d+ units apart; metres would be between 0.2 and 20"):
        find(write(base, {**data, "frames": shrunk(data["frames"])}))


def shrunk(frames: list[dict[str, Any]]) -> list[dict[str, Any]]:
    out = copy.deepcopy(frames)
    for f in out:
        for row in f["transform_matrix"][:3]:
            row[3] *= 0.1
    return out


def test_opencv_poses_in_the_place_of_opengl_ones_are_seen() -> None:
    """Axes of OpenCV read as OpenGL's: every camera looks backwards, away from the subject."""
    from posegaussian.storage.importers.evidence import check_direction
    from tests.storage.importers.test_colmap import ring

    rotations, t = ring(8)
    centres = -np.einsum("vji,vj->vi", rotations, t)
    with pytest.raises(UserError, match=r"looks straight away from one point.*OpenCV: y down, z forward; OpenGL: y up"):
        check_direction([str(v) for v in range(8)], np.diag([1.0, -1, -1]) @ rotations, centres, "camera to world")


def test_a_camera_that_moves_is_refused(tmp_path: Path) -> None:
    """D-NeRF: another place at every instant."""
    rng = np.random.default_rng(3)
    frames = []
    (tmp_path / "train").mkdir()
    for n in range(8):
        matrix = np.array(pose(0))
        matrix[:3, 3] += rng.uniform(-2, 2, 3)
        frames.append({"file_path": f"./train/r_{n:03d}", "time": n / 7, "transform_matrix": matrix.tolist()})
        write_png(tmp_path / "train" / f"r_{n:03d}.png", np.zeros((48, 64, 3), np.uint8))
    write(tmp_path, {"camera_angle_x": 0.9, "frames": frames}, "transforms_train.json")
    with pytest.raises(UserError, match="no camera stands still: one camera that moves"):
        find(tmp_path)


def test_paths_in_full_below_the_capture_are_those_relative_to_it(base: Path) -> None:
    relative = find(base).to_json()
    data = transforms()
    for f in data["frames"]:
        f["file_path"] = str(base.resolve() / f["file_path"])
    assert find(write(base, data)).to_json() == relative


def test_a_picture_that_is_not_there_is_named_with_what_this_layout_can_do(tmp_path: Path) -> None:
    """The option images, which colmap has, is none of its own."""
    write(tmp_path, transforms("{cam}_{n:06d}.png"))
    with pytest.raises(UserError, match=r"such as cam1_000000\.png, in .*; put it there, or correct its file_path$"):
        find(tmp_path)
    for name in import_capture.NAMES:
        write_png(tmp_path / f"{name}_000000.png", np.zeros((48, 64, 3), np.uint8))
    with pytest.raises(UserError, match=r"image cam1_000001\.png of the model is not in .*; put it there, or correct"):
        find(tmp_path)


def change(**values: Any):
    def apply(data: dict[str, Any]) -> None:
        data["frames"][4].update(values)

    return apply


WRONG: dict[str, tuple[Any, str]] = {
    "fisheye": (
        lambda d: d.update(camera_model="OPENCV_FISHEYE"),
        "'OPENCV_FISHEYE' is no case of OpenCV's",
    ),
    "k4": (change(k4=0.1), r"transforms\.json, frame 4: k4 is of the eighth power"),
    "head and frame": (lambda d: d.update(fl_x=99.0), "fl_x is 70 here and 99 in the file's head"),
    "climbs": (change(file_path="../../etc/passwd.png"), "frame 4: image '../../etc/passwd.png' does not lie below"),
    "mask climbs": (change(mask_path="/etc/passwd"), "image '/etc/passwd' does not lie below"),
    "twice": (change(file_path="images/cam1/000000.png"), r"image images/cam1/000000\.png is there twice"),
    "transposed": (change(transform_matrix=np.array(pose(1)).T.tolist()), "is it transposed?"),
    "mirrored": (change(transform_matrix=(np.array(pose(1)) @ np.diag([1, 1, -1, 1.0])).tolist()), "or mirrored"),
    "far": (change(transform_matrix=[[1, 0, 0, 1e300], [0, 1, 0, 0], [0, 0, 1, 0]]), "must be finite and within"),
    "no number": (change(fl_y="wide"), "frame 4: fl_y: 'wide' is not a finite number"),
    "no focal length": (
        lambda d: [f.pop(k) for f in d["frames"] for k in ("fl_x", "fl_y")],
        "neither fl_x nor",
    ),
    "focal": (lambda d: [f.update(fl_x=1e12) for f in d["frames"]], "focal length fx = 1e"),
    "no frames": (lambda d: d.update(frames=[]), "has no list of frames"),
    "moves": (change(transform_matrix=pose(0)), "camera cam2 moves"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_input_gets_a_sentence(base: Path, case: str) -> None:
    spoil, sentence = WRONG[case]
    data = transforms()
    spoil(data)
    with pytest.raises(UserError, match=sentence):
        find(write(base, data))
