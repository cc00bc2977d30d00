"""The colmap importer: text and binary alike, cameras out of images, unit and direction, sentences."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from posegaussian.storage.formats.colmap_model import MODELS, ColmapCamera, read_model
from posegaussian.storage.importers import posed_images
from posegaussian.storage.importers.cameras import rotation_matrix
from posegaussian.storage.importers.colmap import opencv_camera
from posegaussian.storage.importers.find import find_capture
from posegaussian.storage.model.capture import Capture
from posegaussian.storage.model.errors import UserError
from posegaussian.storage.readers.images import write_png
from posegaussian.storage.readers.sources import open_source
from tests.support import colmap_files, import_capture
from tests.support.pycolmap_process import ask
from tests.support.video_clips import counting_clip


def made(base: Path, form: str = "text", model: colmap_files.Model | None = None, at: str = "sparse/0") -> Path:
    import_capture.pictures(base / "images")
    colmap_files.WRITE[form](base / at, model or colmap_files.rig())
    return base


@pytest.fixture
def base(tmp_path: Path) -> Path:
    return made(tmp_path)


def find(base: Path, **options: object) -> Capture:
    return find_capture("colmap", base, options)


@pytest.mark.parametrize("form", ["text", "binary"])
@pytest.mark.parametrize("at", ["sparse/0", "sparse", "."])
def test_the_known_point_lands_where_arithmetic_says(tmp_path: Path, form: str, at: str) -> None:
    capture = find(made(tmp_path, form, at=at))
    assert capture.rig.names == import_capture.NAMES
    np.testing.assert_allclose(  # the project's centres lie half a pixel from OpenCV's; float64 rounding of ~60 px
        import_capture.imported_pixels(capture.rig), import_capture.known_pixels() + 0.5, atol=1e-11
    )
    pictures = open_source(capture, "pictures")
    assert [int(p[0, 0, 0]) for p in pictures.read(2, [0, 1, 2])] == [2, 12, 22]  # frames that COLMAP never saw, too
    assert any("unit: taken as metres" in n for n in capture.notes)
    assert any("points: 120 observations land 0.00 px" in n for n in capture.notes)
    assert any("direction: world to camera" in n for n in capture.notes)
    assert any("m apart" in n for n in capture.notes)


def test_pycolmap_reads_the_same_values(tmp_path: Path) -> None:
    """And the other way round: what pycolmap writes, with its files of rigs and frames, is read the same."""
    made(tmp_path / "a", "text", at="sparse/0")
    first = str(tmp_path / "a" / "sparse" / "0")
    for form in ("text", "binary"):
        (tmp_path / form).mkdir()
    theirs = ask("content", folder=first)
    ask("written", folder=first, text=str(tmp_path / "text"), binary=str(tmp_path / "binary"))
    for form in ("text", "binary"):
        ours = read_model(tmp_path / form)
        assert ours.form == form
        assert (tmp_path / form / ("rigs.txt" if form == "text" else "rigs.bin")).is_file()
        assert {i.name for i in ours.images} == set(theirs["images"])
        for image in ours.images:
            other = theirs["images"][image.name]
            pose = np.array(other["pose"])
            # text has 17 digits, and pycolmap normalises the quaternion
            np.testing.assert_allclose(image.rotation, pose[:, :3], atol=1e-14)
            np.testing.assert_allclose(image.translation, pose[:, 3], atol=1e-14)
            np.testing.assert_allclose(ours.cameras[image.camera].params, other["params"], rtol=1e-15)
            assert len(image.pixels) == 40
        assert len(ours.points) == 40
        for key, place in ours.points.items():
            np.testing.assert_allclose(place, theirs["points"][str(key)][:3], atol=1e-15)


@pytest.mark.parametrize("form", ["text", "binary"])
def test_a_rig_of_pycolmap_is_read_by_its_images_poses(tmp_path: Path, form: str) -> None:
    poses = [
        np.column_stack([rotation_matrix(import_capture.RODRIGUES[v]), import_capture.TRANSLATION[v]]).tolist()
        for v in range(3)
    ]
    folder = tmp_path / "sparse" / "0"
    folder.mkdir(parents=True)
    params = [colmap_files.opencv_params(v) for v in range(3)]
    ask("rig", folder=str(folder), form=form, names=import_capture.NAMES, params=params, poses=poses)
    import_capture.pictures(tmp_path / "images")
    capture = find(tmp_path)
    np.testing.assert_allclose(  # poses went through two products of float64 motions
        import_capture.imported_pixels(capture.rig), import_capture.known_pixels() + 0.5, atol=1e-10
    )


def test_every_model_number_is_the_one_pycolmap_has() -> None:
    assert {name: [number, count] for number, (name, count) in MODELS.items()} == ask("models")


PARAMS = {
    "SIMPLE_PINHOLE": (70.0, 31.5, 24.0),
    "PINHOLE": (70.0, 71.0, 31.5, 24.0),
    "SIMPLE_RADIAL": (70.0, 31.5, 24.0, -0.05),
    "RADIAL": (70.0, 31.5, 24.0, -0.05, 0.1),
    "OPENCV": (70.0, 71.0, 31.5, 24.0, -0.05, 0.1, 1e-3, -2e-3),
    "FULL_OPENCV": (70.0, 71.0, 31.5, 24.0, -0.05, 0.1, 1e-3, -2e-3, 0.02, 0.1, -0.05, 0.01),
}


def test_camera_models_project_as_pycolmap_does() -> None:
    import cv2

    place = np.array([[0.2, -0.15, 1.0], [-0.4, 0.3, 1.0], [0.0, 0.0, 2.0]])
    theirs = ask("projected", cameras=PARAMS, points=place.tolist())
    for model, params in PARAMS.items():
        intrinsics, distortion = opencv_camera(ColmapCamera(model, (64, 48), params), "here")
        ours = cv2.projectPoints(place, np.zeros(3), np.zeros(3), intrinsics, distortion)[0].reshape(-1, 2)
        np.testing.assert_allclose(ours, theirs[model], atol=1e-9)  # the same formula in another order


@pytest.mark.parametrize("model", sorted({n for n, _ in MODELS.values()} - set(PARAMS)))
def test_models_that_opencv_has_not_are_refused_by_name(model: str) -> None:
    with pytest.raises(UserError, match=f"camera model {model} is no case of OpenCV's"):
        opencv_camera(ColmapCamera(model, (64, 48), (1.0,) * 16), "here")


def many_frames(name: str, shift: float = 0.0, frames: int = 3) -> colmap_files.Model:
    """Every camera's images of several frames, named by a pattern; the camera wanders by `shift` a frame."""
    one = colmap_files.rig()
    images = [
        i._replace(
            name=name.format(cam=import_capture.NAMES[v], n=n),
            translation=(i.translation[0] + shift * n, *i.translation[1:]),
            seen=(),
        )
        for v, i in enumerate(one.images)
        for n in range(frames)
    ]
    return one._replace(images=images)


@pytest.mark.parametrize("name", ["{cam}/{n:06d}.png", "{n:06d}/{cam}.png", "{cam}_{n:06d}.png"])
def test_names_and_poses_tell_camera_and_frame(tmp_path: Path, name: str) -> None:
    colmap_files.write_text(tmp_path / "sparse" / "0", many_frames(name))
    for v, cam in enumerate(import_capture.NAMES):
        for n in range(3):
            path = tmp_path / "images" / name.format(cam=cam, n=n)
            path.parent.mkdir(parents=True, exist_ok=True)
            write_png(path, np.full((48, 64, 3), 10 * n + v, np.uint8))
    capture = find(tmp_path)
    assert capture.rig.names == import_capture.NAMES
    np.testing.assert_allclose(
        import_capture.imported_pixels(capture.rig), import_capture.known_pixels() + 0.5, atol=1e-11
    )
    assert [int(p[0, 0, 0]) for p in open_source(capture, "pictures").read(1, [0, 1, 2])] == [1, 11, 21]


def test_poses_that_wander_a_little_are_averaged_and_more_is_refused(tmp_path: Path) -> None:
    made(tmp_path, model=many_frames("{cam}/{n:06d}.png", 1e-3))
    centres = find(tmp_path).rig.centres
    for v in range(3):  # the middle one of three poses on a line
        expected = -rotation_matrix(import_capture.RODRIGUES[v]).T @ (import_capture.TRANSLATION[v] + [1e-3, 0, 0])
        np.testing.assert_allclose(centres[v], expected, atol=1e-12)
    colmap_files.write_text(tmp_path / "sparse" / "0", many_frames("{cam}/{n:06d}.png", 0.5))
    with pytest.raises(UserError, match=r"camera cam\d+ moves: .*Cameras must stand still while people move"):
        find(tmp_path)


def walk(names: str, count: int = 12) -> colmap_files.Model:
    one = colmap_files.rig()
    images = [
        one.images[0]._replace(name=names.format(n), translation=(0.2 * n, 0.0, 3.0), seen=()) for n in range(count)
    ]
    return one._replace(images=images)


def test_a_walk_of_one_camera_is_refused_unless_it_is_an_instant(tmp_path: Path) -> None:
    colmap_files.write_text(tmp_path / "sparse" / "0", walk("frame_{:05d}.png"))
    for n in range(12):
        (tmp_path / "images").mkdir(exist_ok=True)
        write_png(tmp_path / "images" / f"frame_{n:05d}.png", np.zeros((48, 64, 3), np.uint8))
    with pytest.raises(UserError, match="one camera that was carried through a scene"):
        find(tmp_path)
    capture = find(tmp_path, moment=True)
    assert len(capture.rig) == 12
    assert capture.numbers.tolist() == [0]


@pytest.mark.parametrize("stem", ["cam{}", "GX{}0042"])
def test_one_picture_a_camera_is_an_instant_and_videos_go_before_it(tmp_path: Path, stem: str) -> None:
    names = [stem.format(v + 1) for v in range(3)]
    colmap_files.write_binary(tmp_path / "sparse" / "0", colmap_files.rig([f"{n}.png" for n in names]))
    (tmp_path / "images").mkdir()
    for n in names:
        write_png(tmp_path / "images" / f"{n}.png", np.zeros((48, 64, 3), np.uint8))
    capture = find(tmp_path)
    assert capture.rig.names == tuple(names)
    assert capture.numbers.tolist() == [0]
    (tmp_path / "videos").mkdir()
    for n in names:
        counting_clip(tmp_path / "videos" / f"{n}.mp4", 5, import_capture.SIZE, rate=25)
    capture = find(tmp_path)
    assert (len(capture.numbers), capture.frame_rate) == (5, 25)
    np.testing.assert_allclose(
        import_capture.imported_pixels(capture.rig), import_capture.known_pixels() + 0.5, atol=1e-11
    )
    (tmp_path / "videos" / f"{names[1]}.mp4").unlink()
    with pytest.raises(UserError, match=f"camera {names[1]} has none; add it, or set the option pictures"):
        find(tmp_path)
    assert len(find(tmp_path, pictures="images").numbers) == 1


def test_the_unit_is_asked_for_or_given(tmp_path: Path) -> None:
    made(tmp_path, model=colmap_files.rig(unit=0.001))
    with pytest.raises(UserError, match=r"cameras lie up to \d+ units apart; metres would be.*--option distance=cam1,"):
        find(tmp_path)
    by_scale = find(tmp_path, scale=0.001).rig
    np.testing.assert_allclose(import_capture.imported_pixels(by_scale), import_capture.known_pixels() + 0.5, atol=1e-9)
    metres = float(np.linalg.norm(by_scale.centres[0] - by_scale.centres[2]))
    by_distance = find(tmp_path, distance=f"cam1,cam10,{metres!r}").rig
    np.testing.assert_allclose(by_distance.centres, by_scale.centres, atol=1e-12)
    with pytest.raises(UserError, match="both say the unit"):
        find(tmp_path, scale=1, distance="cam1,cam2,3")
    with pytest.raises(UserError, match="there is no camera cam7; there are cam1, cam2, cam10"):
        find(tmp_path, distance="cam1,cam7,3")


def camera_to_world(model: colmap_files.Model) -> colmap_files.Model:
    images = []
    for v, i in enumerate(model.images):
        centre = -rotation_matrix(import_capture.RODRIGUES[v]).T @ import_capture.TRANSLATION[v]
        w, *xyz = i.quaternion
        images.append(i._replace(quaternion=(w, *(-x for x in xyz)), translation=tuple(centre.tolist())))
    return model._replace(images=images)


def other_params(model: colmap_files.Model, change: dict[int, float]) -> colmap_files.Model:
    cameras = {
        k: c._replace(params=tuple(change.get(j, 0.0) + p for j, p in enumerate(c.params)))
        for k, c in model.cameras.items()
    }
    return model._replace(cameras=cameras)


def test_poses_of_the_other_direction_are_seen_by_the_points(tmp_path: Path) -> None:
    made(tmp_path, model=camera_to_world(colmap_files.rig()))
    with pytest.raises(UserError, match=r"camera cam\d+: the file's points land \d+ px from where"):
        find(tmp_path)


def ring(count: int) -> tuple[np.ndarray, np.ndarray]:
    """(world-to-camera rotations, translations) of cameras on a ring that look at (0, 0, 1), 3 m away."""
    rotations, translations = [], []
    for a in 2 * np.pi * np.arange(count) / count:
        centre = np.array([3 * np.cos(a), 3 * np.sin(a), 1.0])
        forward = np.array([-np.cos(a), -np.sin(a), 0.0])
        down = np.array([0.0, 0.0, -1.0])
        r = np.stack([np.cross(down, forward), down, forward])
        rotations.append(r)
        translations.append(-r @ centre)
    return np.array(rotations), np.array(translations)


def test_poses_of_the_other_direction_are_seen_without_points() -> None:
    from posegaussian.storage.importers.evidence import check_direction

    rotations, t = ring(8)
    centres = -np.einsum("vji,vj->vi", rotations, t)
    names = [f"cam{v}" for v in range(8)]
    assert "look at one point to 0 degrees" in check_direction(names, rotations, centres, "world to camera")[0]
    # what a reader of world to camera makes of camera to world
    with pytest.raises(UserError, match="the poses were written in the other direction"):
        check_direction(
            names, rotations.transpose(0, 2, 1), -np.einsum("vij,vj->vi", rotations, centres), "world to camera"
        )
    sideways = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]) @ rotations  # an odd rig, but no sign of a fault
    assert "no common point" in check_direction(names, sideways, centres, "world to camera")[0]
    # what a panorama's cameras look like, and inverted those of a ring
    (told,) = check_direction(names, rotations, 0 * centres, "world to camera")
    assert told.endswith("all cameras stand in one place")


def test_a_principal_point_of_another_pixel_centre_is_seen(tmp_path: Path) -> None:
    made(tmp_path, model=other_params(colmap_files.rig(), {2: -0.5, 3: -0.5}))
    told = find(tmp_path)
    assert any("the option pixel_center=integer moves them by half a pixel" in n for n in told.notes)
    right = find(tmp_path, pixel_center="integer")
    assert not any("pixel_center" in n for n in right.notes)
    np.testing.assert_allclose(
        import_capture.imported_pixels(right.rig), import_capture.known_pixels() + 0.5, atol=1e-11
    )


def test_tangential_coefficients_in_the_other_order_are_seen(tmp_path: Path) -> None:
    model = colmap_files.rig()
    swapped = {
        k: c._replace(params=(*c.params[:4], c.params[4], c.params[5], c.params[7] * 40, c.params[6] * 40))
        for k, c in model.cameras.items()
    }
    made(tmp_path, model=model._replace(cameras=swapped))
    assert any("that is much: are intrinsics and distortion right?" in n for n in find(tmp_path).notes)
    assert not any("that is much" in n for n in find(made(tmp_path)).notes)


def test_pictures_of_another_size_are_scaled_to_the_calibration(tmp_path: Path) -> None:
    made(tmp_path)
    import_capture.pictures(tmp_path / "images", size=(32, 24))
    capture = find(tmp_path)
    assert capture.crops["cam1"].scale == 2
    assert any("pictures are 32x24 px, the calibration is for 64x48 px" in n for n in capture.notes)


@pytest.mark.parametrize("name", ["{}.png", "{}"])
def test_masks_under_the_pictures_names(base: Path, name: str) -> None:
    """COLMAP appends .png to the whole name."""
    for v, cam in enumerate(import_capture.NAMES):
        for n in range(3):
            path = base / "masks" / cam / name.format(f"{n:06d}.png")
            path.parent.mkdir(parents=True, exist_ok=True)
            write_png(path, np.full((48, 64), 200 + 10 * n + v, np.uint8))
    masks = list(open_source(find(base), "masks").read(1, [0, 2]))
    assert [int(m[0, 0]) for m in masks] == [201, 221]


def rewrite(file: str, old: str, new: str, count: int = -1):
    def change(base: Path) -> None:
        path = base / "sparse" / "0" / file
        text = path.read_text()
        assert old in text
        path.write_text(text.replace(old, new, count))

    return change


WRONG = {
    "climbs": (
        rewrite("images.txt", "cam2/000000.png", "../../etc/passwd.png"),
        r"image '\.\./\.\./etc/passwd\.png' does not lie below the folder",
    ),
    "absolute": (rewrite("images.txt", "cam2/000000.png", "/etc/passwd"), "does not lie below the folder"),
    "no camera": (rewrite("cameras.txt", "\n2 ", "\n7 "), r"images\.txt:4: image 'cam2/000000.png' is of camera 2"),
    "twice": (rewrite("images.txt", "cam2/", "cam1/"), r"images\.txt:4: image 'cam1/000000.png' is there twice"),
    "fisheye": (rewrite("cameras.txt", " OPENCV ", " OPENCV_FISHEYE "), "camera model OPENCV_FISHEYE is no case of"),
    "unknown model": (rewrite("cameras.txt", " OPENCV ", " PINHOL ", 1), r"cameras\.txt:2: unknown camera model"),
    "too few": (rewrite("cameras.txt", " OPENCV ", " FULL_OPENCV ", 1), "FULL_OPENCV has 12 parameters, 8 are given"),
    "no number": (rewrite("images.txt", "0.05 -0.1 3.0", "0.05 abc 3.0"), r"images\.txt:2: 'abc' is not a number"),
    "far": (rewrite("images.txt", "0.05 -0.1 3.0", "0.05 -0.1 1e300"), "must be finite and within"),
    "no rotation": (
        rewrite("images.txt", "0.05 -0.1 3.0 1", "0.05 -0.1 3.0 0.5 1"),
        r"images\.txt:2: '0\.5' is not a whole number",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_input_gets_a_sentence(base: Path, case: str) -> None:
    change, sentence = WRONG[case]
    change(base)
    with pytest.raises(UserError, match=sentence):
        find(base)


def test_every_cut_of_a_binary_model_gets_a_sentence(tmp_path: Path) -> None:
    folder = made(tmp_path, "binary") / "sparse" / "0"
    for file in ("cameras.bin", "images.bin"):
        raw = (folder / file).read_bytes()
        for end in range(0, len(raw), 41):
            (folder / file).write_bytes(raw[:end])
            with pytest.raises(UserError, match=file.replace(".", r"\.")):
                read_model(folder)
        (folder / file).write_bytes(raw + b"x")
        with pytest.raises(UserError, match="1 bytes follow the last of 3"):
            read_model(folder)
        (folder / file).write_bytes(raw)
    (folder / "images.bin").write_bytes((2**60).to_bytes(8, "little") + raw[8:])
    with pytest.raises(UserError, match=r"1152921504606846976 images in \d+ bytes"):
        read_model(folder)


def test_several_models_and_several_calibrations_of_a_camera(base: Path) -> None:
    colmap_files.write_text(base / "sparse" / "1", colmap_files.rig())
    with pytest.raises(UserError, match="several models fit: sparse/0, sparse/1"):
        find(base)
    assert len(find(base, model="sparse/1").rig) == 3
    model = many_frames("{cam}/{n:06d}.png")
    model.images[1] = model.images[1]._replace(camera=2)
    colmap_files.write_text(base / "sparse" / "1", model)
    with pytest.raises(UserError, match="different calibrations, but are one camera's"):
        find(base, model="sparse/1")


def test_images_that_would_be_one_camera_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "images").mkdir()
    for model in (colmap_files.rig(("a.png", "a.jpg", "b.png")), colmap_files.rig(("a.png", "x/a.png", "x_a.png"))):
        colmap_files.write_text(tmp_path / "sparse" / "0", model)
        with pytest.raises(UserError, match="would both be camera"):
            find(tmp_path, moment=True)
    monkeypatch.setattr(posed_images, "MOST_CAMERAS", 2)
    colmap_files.write_text(tmp_path / "sparse" / "0", colmap_files.rig())
    with pytest.raises(UserError, match="3 images of 3 cameras; a rig has at most 2"):
        find(tmp_path)


def test_cameras_without_pictures_are_left_out_and_said(base: Path) -> None:
    for p in (base / "images" / "cam10").iterdir():
        p.unlink()
    assert "camera cam10 is placed but has no pictures and is left out" in find(base).notes
    assert find(base, cameras="cam2").rig.names == ("cam2",)
