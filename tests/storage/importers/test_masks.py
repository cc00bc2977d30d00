"""Which mask belongs to which picture, what its values mean, and that none is passed over in silence."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from posegaussian.storage.importers.find import find_capture
from posegaussian.storage.model.capture import Capture
from posegaussian.storage.model.errors import UserError
from posegaussian.storage.readers.images import write_png
from posegaussian.storage.readers.sources import open_source
from tests.storage.importers import test_images, test_nerfstudio, test_videos
from tests.support import colmap_files, import_capture, ring

NAMES = import_capture.NAMES
FRAMES = (0, 1, 2)


def folders(base: Path, pictures: tuple[int, ...] = FRAMES) -> Path:
    """The layout `images`, without masks."""
    import_capture.pictures(base / "images", frames=pictures)
    import_capture.dump(base / "cameras.json", test_images.cameras())
    return base


def masks(base: Path, names: tuple[str, ...] = NAMES, numbers: tuple[int, ...] = FRAMES, value: int = 255) -> Path:
    """The mask of instant i under the i-th number."""
    for v, name in enumerate(names):
        for i, n in enumerate(numbers):
            ring.write_mask(base / "masks" / name / f"{n:06d}.png", v, i, value)
    return base


def find(base: Path) -> Capture:
    return find_capture("images", base, {})


def said(capture: Capture, about: str) -> list[str]:
    return [n for n in capture.notes if about in n]


def check(capture: Capture, instants: dict[int, int]) -> None:
    ring.check_masks(capture, range(3), instants)


@pytest.mark.parametrize(
    ("pictures", "numbers", "sentence"),
    [
        ((20, 21), (0, 1), "camera cam1: its masks are frames 0-1, its pictures 20-21: none fits; number"),
        ((0, 1, 2), (7,), "its masks are frames 7, its pictures 0-2: none fits; number masks as their pictures are"),
        ((1, 2, 3), (0, 1, 2), "its masks are frames 0-2, its pictures 1-3: as many, and 1 off in every camera"),
    ],
)
def test_masks_under_numbers_of_no_picture_are_refused(
    tmp_path: Path, pictures: tuple[int, ...], numbers: tuple[int, ...], sentence: str
) -> None:
    with pytest.raises(UserError, match=sentence):
        find(masks(folders(tmp_path, pictures), numbers=numbers))


def test_masks_of_no_picture_are_named(tmp_path: Path) -> None:
    capture = find(masks(folders(tmp_path), numbers=(0, 1, 2, 3, 7)))
    check(capture, {0: 0, 2: 2})
    assert len(said(capture, "masks of 2 frames (3, 7) belong to no picture and are left out")) == 3
    assert not said(find(masks(folders(tmp_path / "all"))), "masks")


def test_masks_of_one_camera_that_are_all_a_neighbours_are_refused(tmp_path: Path) -> None:
    masks(folders(tmp_path), NAMES[1:])
    masks(tmp_path, NAMES[:1], (1, 2, 3))
    sentence = f"camera {NAMES[0]}: its masks are frames 1-3, its pictures 0-2: as many, and 1 off throughout; number"
    with pytest.raises(UserError, match=sentence):
        find(tmp_path)


def films(base: Path) -> Path:
    test_videos.write(base)
    return base


def test_masks_of_videos_that_are_counted_from_1_go_with_frames_one_to_one(tmp_path: Path) -> None:
    """As ffmpeg writes them; the law: whatever they are counted from, they are the same masks."""
    for first in (0, 1, 40):
        base = films(tmp_path / str(first))
        capture = test_videos.find(masks(base, test_videos.NAMES, tuple(range(first, first + 3))))
        check(capture, {0: 0, 1: 1, 2: 2})
        (told,) = said(capture, "one to one") if first else [f"numbered from {first} where"]
        assert f"numbered from {first} where" in told


def test_masks_of_some_frames_of_a_video_keep_their_numbers(tmp_path: Path) -> None:
    """Two masks of three frames: which frames these are only their numbers tell."""
    capture = test_videos.find(masks(films(tmp_path), test_videos.NAMES, (1, 2)))
    check(capture, {1: 0, 2: 1})
    capture = test_videos.find(masks(films(tmp_path), test_videos.NAMES, (1, 2, 3, 4)))
    assert said(
        capture, "masks of 2 frames (3-4) belong to no picture and are left out; number masks as their pictures"
    )


def written(kind: str) -> Callable[[Path, np.ndarray], None]:
    """Writes a mask [h, w] of 0 and 255 in another way than grey of 8 bit."""

    def write(path: Path, mask: np.ndarray) -> None:
        none, full = np.zeros_like(mask), np.full_like(mask, 255)
        values = {
            "16 bit of 0 and 1": (mask > 0).astype(np.uint16),
            "16 bit": mask.astype(np.uint16) * 257,
            "green": np.dstack([none, mask // 2 + (mask > 0), none]),
            "black with alpha": np.dstack([none, none, none, mask]),
            "white with alpha": np.dstack([full, full, full, mask]),
            "two colours": np.dstack([none, np.where(np.arange(mask.shape[1]) < 12, mask, 0), np.where(
                np.arange(mask.shape[1]) < 12, 0, mask)]),
        }[kind]  # fmt: skip
        path.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(path), values)

    return write


@pytest.mark.parametrize(
    "kind", ["16 bit of 0 and 1", "16 bit", "green", "black with alpha", "white with alpha", "two colours"]
)
def test_legible_masks_are_read_whatever_channel_holds_them(tmp_path: Path, kind: str) -> None:
    folders(tmp_path)
    for v, name in enumerate(NAMES):
        for n in FRAMES:
            written(kind)(tmp_path / "masks" / name / f"{n:06d}.png", ring.mask(v, n))
    check(find(tmp_path), {0: 0, 1: 1, 2: 2})


def test_a_frame_without_the_subject_stays_empty_in_masks_of_alpha(tmp_path: Path) -> None:
    folders(tmp_path)
    for v, name in enumerate(NAMES):
        for n in FRAMES:
            seen = ring.mask(v, n) if n else np.zeros_like(ring.mask(v, n))
            written("white with alpha")(tmp_path / "masks" / name / f"{n:06d}.png", seen)
    source = open_source(find(tmp_path), "masks")
    assert [bool(m.any()) for m in source.read(0, FRAMES)] == [False, True, True]


def test_masks_that_hold_nothing_are_refused_and_those_of_one_camera_said(tmp_path: Path) -> None:
    masks(folders(tmp_path), value=0)
    with pytest.raises(UserError, match=r"masks hold nothing: all are 0 throughout, such as .*masks/cam1/000000\.png"):
        find(tmp_path)
    masks(tmp_path, NAMES[:2])
    assert said(find(tmp_path), "masks of cam10 hold nothing in the frames looked at")


def test_one_camera_without_masks_is_refused_with_the_ways_on_and_black_ones_are_a_way(tmp_path: Path) -> None:
    base = folders(tmp_path)
    masks(base, NAMES[:-1])
    with pytest.raises(UserError, match=f"cameras {NAMES[-1]} have no masks while others have") as refused:
        find(base)
    for way in (str(base / "masks" / NAMES[-1]), "black masks", "leave these cameras out", "frames.matte: person"):
        assert way in str(refused.value)
    masks(base, NAMES[-1:], value=0)
    assert said(find(base), "hold nothing")


def test_the_alpha_of_pictures_is_their_masks(tmp_path: Path) -> None:
    folders(tmp_path)
    for v, name in enumerate(NAMES):
        for n in FRAMES:
            colour = np.full((*ring.mask(v, n).shape, 3), 90, np.uint8)
            write_png(tmp_path / "images" / name / f"{n:06d}.png", np.dstack([colour, ring.mask(v, n)]))
    capture = find(tmp_path)
    check(capture, {0: 0, 1: 1, 2: 2})
    assert said(capture, "masks: the alpha of the pictures")
    import_capture.pictures(tmp_path / "images", NAMES[:1])
    capture = find(tmp_path)
    assert not capture.masks
    assert said(capture, "the alpha of the pictures of cam2, cam10 is not used as masks, as those of cam1 are opaque")


@pytest.mark.parametrize(
    ("name", "mask"),
    [
        ("{n:06d}/{cam}.png", "{cam}/{n:06d}.png"),
        ("{n:06d}/{cam}.png", "{n:06d}/{cam}.png"),
        ("{cam}/{n:06d}.png", "{cam}/{n:06d}.png.png"),
    ],
)
def test_masks_of_colmap_lie_under_the_pictures_names_or_the_cameras(tmp_path: Path, name: str, mask: str) -> None:
    names = {(n, v): name.format(n=n, cam=cam) for n in FRAMES for v, cam in enumerate(NAMES)}
    model = colmap_files.rig()
    placed = [model.images[v]._replace(name=at) for (_, v), at in names.items()]
    colmap_files.WRITE["text"](tmp_path / "sparse" / "0", model._replace(images=placed))
    for (n, v), at in names.items():
        ring.write_picture(tmp_path / "images" / at, v, n)
        ring.write_mask(tmp_path / "masks" / mask.format(n=n, cam=NAMES[v]), v, n)
    check(find_capture("colmap", tmp_path, {}), {0: 0, 1: 1, 2: 2})


def test_masks_beside_a_file_that_names_none_are_read_as_its_pictures_lie(tmp_path: Path) -> None:
    import_capture.pictures(tmp_path / "images")
    test_nerfstudio.write(masks(tmp_path), test_nerfstudio.transforms())
    check(find_capture("nerfstudio", tmp_path, {}), {0: 0, 1: 1, 2: 2})


def beyond(x: np.ndarray, y: np.ndarray, turn: float) -> np.ndarray:
    """How far points lie outside an ellipse turned by `turn` radians, about, in the unit in which pictures are 4 by
    3."""
    c, s = np.cos(turn), np.sin(turn)
    along, across = (c * (x - 2.1) + s * (y - 1.4)) / 1.1, (c * (y - 1.4) - s * (x - 2.1)) / 0.6
    level = np.hypot(along, across)
    return np.asarray((level - 1) * level / np.maximum(np.hypot(along / 1.1, across / 0.6), 1e-9))


def silhouette(width: int, height: int, turn: float) -> np.ndarray:
    """[h, w] uint8 share of every pixel that the ellipse covers, whatever the size of the picture."""
    fine = 8
    x, y = (np.arange(width * fine) + 0.5) * 4 / (width * fine), (np.arange(height * fine) + 0.5) * 3 / (height * fine)
    inside = (beyond(x, y[:, None], turn) <= 0).reshape(height, fine, width, fine)
    return np.rint(255 * inside.mean(axis=(1, 3))).astype(np.uint8)


def outline(mask: np.ndarray) -> np.ndarray:
    """[n, 2] px where a mask's rows pass through half of 255."""
    level = mask.astype(float) - 127.5
    rows, columns = np.nonzero((level[:, :-1] > 0) != (level[:, 1:] > 0))
    here, next_ = level[rows, columns], level[rows, columns + 1]
    return np.stack([columns + 0.5 + here / (here - next_), rows + 0.5], axis=1)


@pytest.mark.parametrize("size", [(160, 120), (80, 60), (640, 480), (107, 80)])
@pytest.mark.parametrize("turn", [0.0, 0.4, 1.2])
def test_masks_of_another_size_put_the_outline_where_it_is(tmp_path: Path, size: tuple[int, int], turn: float) -> None:
    """The law: within half a pixel of the picture, wherever the outline runs, whatever the masks' own pixels are."""
    whole = (320, 240)
    import_capture.pictures(tmp_path / "images", size=whole)
    entries = test_images.cameras()
    for entry in entries["cameras"]:  # type: ignore[attr-defined]
        entry |= {"width": 320, "height": 240, "K": (np.diag([5.0, 5, 1]) @ np.array(entry["K"])).tolist()}
    import_capture.dump(tmp_path / "cameras.json", entries)
    drawn = silhouette(*size, turn)
    for name in NAMES:
        for n in FRAMES:
            written("16 bit")(tmp_path / "masks" / name / f"{n:06d}.png", drawn)
    capture = find(tmp_path)
    (told,) = said(capture, "the same shape, so masks are")
    assert told.startswith(f"cameras cam1, cam2, cam10: masks are {size[0]}x{size[1]} px, pictures 320x240 px")
    assert ("enlarged" if size[0] < 320 else "reduced") in told
    for read in open_source(capture, "masks").read(1, FRAMES):
        assert read.shape == (240, 320)
        points = np.concatenate([outline(read), outline(read.T)[:, ::-1]]) / 80
        assert len(points) > 400
        assert np.abs(80 * beyond(*points.T, turn)).max() < 0.5


def test_masks_of_another_shape_or_of_two_sizes_are_refused(tmp_path: Path) -> None:
    folders(tmp_path)
    import_capture.pictures(tmp_path / "masks", size=(32, 32))
    with pytest.raises(
        UserError, match=r"mask .* is 32x32 px, its picture is 64x48 px, which is another shape; a mask"
    ):
        find(tmp_path)
    import_capture.pictures(tmp_path / "masks", size=(32, 24))
    ring.write_mask(tmp_path / "masks" / NAMES[0] / "000002.png", 0, 2)
    with pytest.raises(UserError, match=r"frame 2: mask .* is 64x48 px, the first one is 32x24 px; one camera has one"):
        find(tmp_path)


def test_smaller_masks_of_0_and_1_are_spread_before_they_are_enlarged(tmp_path: Path) -> None:
    folders(tmp_path)
    small = (ring.mask(0, 0)[::2, ::2] > 0).astype(np.uint8)
    for name in NAMES:
        for n in FRAMES:
            path = tmp_path / "masks" / name / f"{n:06d}.png"
            path.parent.mkdir(parents=True, exist_ok=True)
            write_png(path, small)
    (read,) = open_source(find(tmp_path), "masks").read(0, [0])
    assert read.shape == (48, 64)
    assert set(np.unique(read)) > {0, 255}


def rewritten(base: Path, names: tuple[str, ...], change: Callable[[np.ndarray], np.ndarray]) -> Path:
    """Masks of some cameras with other values in the place of 0 and 255."""
    for name in names:
        for path in (base / "masks" / name).iterdir():
            write_png(path, change(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)).astype(np.uint8))
    return base


@pytest.mark.parametrize("value", [1, 2, 100])
@pytest.mark.parametrize("names", [NAMES, NAMES[1:2]], ids=["all", "one"])
def test_a_single_value_below_white_is_the_subject(tmp_path: Path, names: tuple[str, ...], value: int) -> None:
    """In all cameras, or in one whose masks another program wrote; white is read as it is."""
    rewritten(masks(folders(tmp_path)), names, lambda m: m // 255 * value)
    capture = find(tmp_path)
    check(capture, {0: 0, 2: 2})
    assert {int(m.max()) for v in range(3) for m in open_source(capture, "masks").read(v, FRAMES)} == {255}
    (told,) = said(capture, f"hold only 0 and {value}; ")
    assert told.startswith("masks hold" if names == NAMES else f"masks of {names[0]} hold")


def test_a_camera_without_the_subject_is_read_as_the_others_are(tmp_path: Path) -> None:
    rewritten(masks(folders(tmp_path)), NAMES, lambda m: m // 255 * 2)
    rewritten(tmp_path, NAMES[:1], np.zeros_like)
    assert [s.options for s in find(tmp_path).masks if s] == [{"labels": True, "mostly_black": True}] * 3


def test_several_values_below_white_are_refused_where_nothing_is_white(tmp_path: Path) -> None:
    def parts(mask: np.ndarray) -> np.ndarray:
        return mask // 255 * (1 + np.arange(mask.shape[1]) % 3)

    rewritten(masks(folders(tmp_path)), NAMES, parts)
    with pytest.raises(UserError, match=r"hold values up to 3, such as .*000000\.png, and none above 127.*as 255"):
        find(tmp_path)
    rewritten(tmp_path, NAMES[1:], lambda m: (m > 0) * 255)
    capture = find(tmp_path)
    assert said(capture, f"masks of {NAMES[0]} hold nothing above 127 in the frames looked at, so nobody is seen there")
    assert not any(m.any() and m.max() > 127 for m in open_source(capture, "masks").read(0, FRAMES))


def test_a_soft_matte_that_is_dark_where_it_is_looked_at_stays_as_it_is(tmp_path: Path) -> None:
    """The subject is a shadow in the frames looked at, and white in another."""
    numbers = tuple(range(14))
    masks(folders(tmp_path, numbers), numbers=numbers)
    for name in NAMES:
        for n in numbers:
            soft = np.minimum(np.arange(64), 90)[None].repeat(48, axis=0) * (255 if n == 5 else 1)
            write_png(tmp_path / "masks" / name / f"{n:06d}.png", np.minimum(soft, 255).astype(np.uint8))
    capture = find(tmp_path)
    assert [s.options for s in capture.masks if s] == [{}] * 3
    assert not said(capture, "hold")


def test_specks_that_noise_left_where_nobody_is_seen_are_no_subject(tmp_path: Path) -> None:
    masks(folders(tmp_path))
    specks = np.zeros((48, 64), np.uint8)
    specks[::7, ::5] = 1
    rewritten(tmp_path, NAMES[:1], lambda _: specks)
    capture = find(tmp_path)
    assert [s.options for s in capture.masks if s] == [{"mostly_black": True}] * 3
    assert said(capture, f"masks of {NAMES[0]} hold nothing above 127")
    late = rewritten(tmp_path, NAMES[:1], lambda _: np.zeros((48, 64)))  # white that comes later is no wrapped byte
    write_png(late / "masks" / NAMES[0] / "000001.png", np.where(specks, 254, 0).astype(np.uint8))
    assert max(int(m.max()) for m in open_source(find(late), "masks").read(0, FRAMES)) == 254


def test_masks_of_one_camera_that_mark_the_background_are_named(tmp_path: Path) -> None:
    masks(folders(tmp_path))
    assert not said(find(tmp_path), "rim")
    for path in (tmp_path / "masks" / "cam2").iterdir():
        write_png(path, 255 - cv2.imread(str(path), cv2.IMREAD_GRAYSCALE))
    (told,) = said(find(tmp_path), "rim")
    assert told.startswith("masks of cam2 are white along 100% of the pictures' rim, unlike the others'")
    assert "write them the other way round" in told


@pytest.mark.parametrize("value", [1, 255])
def test_one_mask_that_marks_the_background_unlike_its_camera_s_others_is_read_the_other_way_round(
    tmp_path: Path, value: int
) -> None:
    """Whichever frames are read with it; a camera whose masks are all so is warned about and read as it is."""
    masks(folders(tmp_path), value=value)
    path = tmp_path / "masks" / "cam2" / "000001.png"
    write_png(path, value - cv2.imread(str(path), cv2.IMREAD_GRAYSCALE))
    check(find(tmp_path), dict.fromkeys(FRAMES, 0) | {n: n for n in FRAMES})
    reader = open_source(find(tmp_path), "masks")
    at = NAMES.index("cam2")
    alone = [m for n in FRAMES for m in reader.read(at, [n])]
    np.testing.assert_array_equal(alone, list(open_source(find(tmp_path), "masks").read(at, FRAMES)))
    assert [reader.turned(v, FRAMES) for v in (0, at)] == [[], [1]]
    rewritten(tmp_path, ("cam2",), lambda m: np.where(m == m[0, 0], value, 0))
    turned = open_source(find(tmp_path), "masks")
    assert all(m[0, 0] == 255 for m in turned.read(at, FRAMES))
    assert turned.turned(at, FRAMES) == []


def test_holes_in_masks_that_mostly_fill_their_picture_and_a_subject_along_the_rim_stay(tmp_path: Path) -> None:
    """Between the arm and the body of one who stands before the camera; and one who comes that near in a frame."""
    masks(folders(tmp_path))
    hole = np.full((48, 64), 255, np.uint8)
    hole[20:30, 20:30] = 0
    rewritten(tmp_path, NAMES[:1], lambda _: hole)
    near = np.full((48, 64), 255, np.uint8)
    near[:12, :30] = 0
    write_png(tmp_path / "masks" / NAMES[1] / "000001.png", near)
    reader = open_source(find(tmp_path), "masks")
    assert all((m == hole).all() for m in reader.read(0, FRAMES))
    assert (next(iter(reader.read(1, [1]))) == near).all()
