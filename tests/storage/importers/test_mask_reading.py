"""What an import makes of masks that do not run from 0 to 255, or around which a line was drawn, and that it leaves
those that are right as they are."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from posegaussian.storage.importers.mask_range import RIGHT, value_range
from posegaussian.storage.model.capture import Capture
from posegaussian.storage.readers.images import write_png
from posegaussian.storage.readers.sources import open_source
from tests.storage.importers.test_masks import FRAMES, NAMES, find, folders, said
from tests.support import ring

Change = Callable[[np.ndarray], np.ndarray]
RANDOM = np.random.default_rng(5)


def matte(softness: float = 0.6, size: int = 240, shift: int = 0) -> np.ndarray:
    """[size, size] float 0..255 of somebody with arms, soft along the outline by some px; 64 px of him across."""
    mask = np.zeros((size, size), np.float32)
    cv2.ellipse(mask, (size // 2 + shift, size // 2), (size // 7, size // 3), 0, 0, 360, 255, -1)
    cv2.line(mask, (size // 2 + shift, size // 3), (size // 8, size // 2), 255, 5)
    return np.asarray(cv2.GaussianBlur(mask, (0, 0), softness))


def video(mask: np.ndarray) -> np.ndarray:
    return 16 + mask * (219 / 255)


def veil(mask: np.ndarray) -> np.ndarray:
    return 20 + 0.7 * mask + RANDOM.uniform(0, 40, mask.shape)


def jpeg(mask: np.ndarray) -> np.ndarray:
    read = cv2.imdecode(cv2.imencode(".jpg", mask, [cv2.IMWRITE_JPEG_QUALITY, 40])[1], cv2.IMREAD_GRAYSCALE)
    assert read is not None
    return read


def as_bytes(mask: np.ndarray) -> np.ndarray:
    return np.clip(np.rint(mask), 0, 255).astype(np.uint8)


def written(base: Path, change: Change, names: tuple[str, ...] = NAMES) -> Path:
    """Masks of cameras, larger than their pictures, as a program wrote them."""
    for v, name in enumerate(NAMES):
        for n in FRAMES:
            path = base / "masks" / name / f"{n:06d}.png"
            path.parent.mkdir(parents=True, exist_ok=True)
            mask = matte(shift=5 * v + n)[:180]
            write_png(path, as_bytes(change(mask) if name in names else mask))
    return base


def read(capture: Capture) -> np.ndarray:
    """[V, F, h, w] float."""
    source = open_source(capture, "masks")
    return np.stack([list(source.read(v, FRAMES)) for v in range(3)]).astype(float)


def test_the_ends_are_what_most_of_background_and_subject_hold() -> None:
    assert value_range([as_bytes(video(matte()))]) == (16, 235)
    black, white = value_range([as_bytes(veil(matte())) for _ in range(3)]) or RIGHT
    assert (black, white) == (pytest.approx(60, abs=2), pytest.approx(198, abs=2))
    assert value_range([as_bytes(matte() * 200 / 255)]) == (0, 200)


@pytest.mark.parametrize("softness", [0.6, 3, 12], ids=["sharp", "hair", "moving"])
@pytest.mark.parametrize("size", [120, 240, 720])
def test_a_matte_whose_range_is_right_is_right_however_soft_or_compressed(softness: float, size: int) -> None:
    mask = as_bytes(matte(softness * size / 240, size))
    assert value_range([mask]) == value_range([jpeg(mask)]) == RIGHT
    haze = mask.copy()
    haze[: 3 * size // 5] = np.maximum(haze[: 3 * size // 5], 40)  # that a net left in the most part of the background
    assert value_range([haze]) == RIGHT


def test_masks_in_which_one_of_both_is_not_seen_tell_nothing() -> None:
    for mask in (np.zeros((90, 120)), np.full((90, 120), 255), 20 + RANDOM.uniform(0, 40, (90, 120))):
        assert value_range([as_bytes(mask)]) is None


@pytest.mark.parametrize(("change", "within", "sentence"), [
    (video, 2, "masks hold up to 16 where nobody is and 235 or more on the subject"),
    (veil, 60, "where nobody is and 19"),
])  # fmt: skip
def test_masks_of_another_range_are_read_as_those_of_the_right_one(
    tmp_path: Path, change: Change, within: float, sentence: str
) -> None:
    """The law: what a program did to the values is undone; noise stays where a matte is soft, and nowhere else."""
    right = read(find(written(folders(tmp_path / "right"), lambda m: m)))
    capture = find(written(folders(tmp_path / "other"), change))
    found = read(capture)
    assert np.abs(found - right).max() <= within
    assert not found[:, :, :6].any()
    assert np.abs(found - right).mean() < 1
    (told,) = said(capture, "they are spread to 0 and 255")
    assert sentence in told


def test_masks_whose_range_is_right_are_read_to_the_bit(tmp_path: Path) -> None:
    capture = find(written(folders(tmp_path), lambda m: jpeg(as_bytes(cv2.GaussianBlur(m, (0, 0), 4)))))
    assert [s.options for s in capture.masks if s] == [{"mostly_black": True}] * 3
    assert not said(capture, "spread")


def test_one_camera_of_another_range_is_named_and_who_sees_nobody_is_read_as_the_others(tmp_path: Path) -> None:
    capture = find(written(folders(tmp_path / "one"), video, NAMES[1:2]))
    assert [s.options.get("range") for s in capture.masks if s] == [None, [16, 235], None]
    assert said(capture, f"masks of {NAMES[1]} hold up to 16")
    base = written(folders(tmp_path / "nobody"), video)
    for path in (base / "masks" / NAMES[0]).iterdir():
        write_png(path, as_bytes(14 + RANDOM.uniform(0, 4, (180, 240))))
    capture = find(base)
    assert [s.options.get("range") for s in capture.masks if s] == [[16, 235]] * 3
    assert not (read(capture)[0] > 3).any()


@pytest.mark.parametrize(
    "values", [lambda m: m, lambda m: m // 255, lambda m: m // 255 * 7, video], ids=["white", "1", "label", "video"]
)
def test_a_line_around_masks_is_no_subject_and_does_not_say_that_they_mark_the_background(
    tmp_path: Path, values: Change
) -> None:
    def lined(mask: np.ndarray) -> np.ndarray:
        out = np.where(mask > 127, 255, 0).astype(np.uint8)
        out[[0, -1]] = out[:, [0, -1]] = 255
        return as_bytes(values(out))

    right = read(find(written(folders(tmp_path / "right"), lambda m: np.where(m > 127, 255, 0))))
    capture = find(written(folders(tmp_path / "lined"), lined))
    inwards = np.s_[:, :, 1:-1, 1:-1]  # in the outermost pixel a subject that is cut off is as wide as beside it
    np.testing.assert_array_equal(read(capture)[inwards], right[inwards])
    assert np.abs(read(capture) - right).sum() / 255 < 0.001 * right.size
    (told,) = said(capture, "along the pictures' edges")
    assert told.startswith("masks are white in a line of up to 1 px")
    assert not said(capture, "they seem to mark the background")
    one = find(written(folders(tmp_path / "one"), lined, NAMES[2:]))
    np.testing.assert_array_equal(read(one)[2:][inwards], right[2:][inwards])
    assert said(one, f"masks of {NAMES[2]} are white in a line")


def test_masks_without_a_line_say_nothing_of_one(tmp_path: Path) -> None:
    for v, name in enumerate(NAMES):
        for n in FRAMES:
            ring.write_mask(tmp_path / "masks" / name / f"{n:06d}.png", v, n)
    assert not said(find(folders(tmp_path)), "line")
