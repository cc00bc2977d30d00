"""Pictures of the subject cut out in the place of masks: what it wears is not read as where it is."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from posegaussian.storage.importers.mask_cut_outs import as_cut_out
from posegaussian.storage.model.capture import Capture
from posegaussian.storage.model.errors import UserError
from posegaussian.storage.readers.sources import open_source
from tests.storage.importers.test_mask_reading import matte
from tests.storage.importers.test_masks import FRAMES, NAMES, find, folders, said

RANDOM = np.random.default_rng(11)
Write = Callable[[np.ndarray], np.ndarray]
JPEG = [cv2.IMWRITE_JPEG_QUALITY, 60]


def shape(v: int, n: int) -> np.ndarray:
    """[180, 240] float 0..255 of a person."""
    return matte(shift=5 * v + n)[:180]


def dressed(mask: np.ndarray) -> np.ndarray:
    """[h, w, 3] float of somebody in black trousers and a light shirt, woven, whom a lamp lights from one side."""
    height, width = mask.shape
    rows, columns = np.mgrid[:height, :width]
    cloth = np.where((rows > height // 2)[..., None], (24, 20, 22), (190, 214, 206))
    woven = cv2.GaussianBlur(RANDOM.normal(0, 12, (height, width, 3)), (0, 0), 1)
    return np.clip((cloth + 3 * woven) * (0.7 + 0.5 * columns / width)[..., None], 10, 240)


def before(colour: float) -> Write:
    def write(mask: np.ndarray) -> np.ndarray:
        share = mask[..., None] / 255
        return dressed(mask) * share + colour * (1 - share)

    return write


def straight(mask: np.ndarray) -> np.ndarray:
    """[h, w, 4] as a keyer writes it, the room still behind a transparent pixel."""
    return np.dstack([np.where(mask[..., None] > 0, dressed(mask), RANDOM.uniform(0, 255, (*mask.shape, 3))), mask])


def transparent_black(mask: np.ndarray) -> np.ndarray:
    return np.dstack([np.where(mask[..., None] > 0, dressed(mask), 0), mask])


def written(base: Path, change: Write, names: tuple[str, ...] = NAMES, ending: str = ".png") -> Path:
    """Masks of cameras as a program wrote them, of nobody in the first frame of the last camera, grey ones of the
    others."""
    for v, name in enumerate(NAMES):
        for n in FRAMES:
            path = base / "masks" / name / f"{n:06d}"
            path.parent.mkdir(parents=True, exist_ok=True)
            mask = shape(v, n) * (0 if (v, n) == (2, 0) else 1)
            values = np.rint(change(mask) if name in names else mask)
            cv2.imwrite(str(path) + (ending if name in names else ".png"), values.astype(np.uint8), JPEG)
    return base


def check(capture: Capture, close: float, names: tuple[str, ...] = NAMES) -> None:
    source = open_source(find_right(capture), "masks")
    read = open_source(capture, "masks")
    for v in (NAMES.index(n) for n in names):
        for n, found, right in zip(FRAMES, read.read(v, FRAMES), source.read(v, FRAMES), strict=True):
            there, seen = right > 127, found > 127
            if (v, n) == (2, 0):
                assert not found.any()
            else:
                assert (there & seen).sum() >= close * (there | seen).sum()


def find_right(capture: Capture) -> Capture:
    """The same with masks that are right."""
    base = Path(capture.pictures[0].files[0].path).parents[2].parent / "right"
    return find(base) if base.exists() else find(written(folders(base), lambda m: m))


@pytest.mark.parametrize("write", [straight, transparent_black])
@pytest.mark.parametrize("names", [NAMES, NAMES[1:]], ids=["all", "some"])
def test_the_alpha_of_a_subject_cut_out_is_its_mask_to_the_bit(
    tmp_path: Path, write: Write, names: tuple[str, ...]
) -> None:
    """Whatever it wears, and where nobody is, whatever is behind what is transparent."""
    capture = find(written(folders(tmp_path / "cut"), write, names))
    check(capture, 1, names)
    (told,) = said(capture, "their colours")
    whose = "masks" if names == NAMES else f"masks of {', '.join(names)}"
    assert told == f"{whose} have an alpha that varies: it is read, and not their colours"
    assert not said(capture, "veil")
    soft = next(iter(open_source(capture, "masks").read(1, FRAMES[:1])))
    np.testing.assert_array_equal(soft, next(iter(open_source(find_right(capture), "masks").read(1, FRAMES[:1]))))


def test_a_camera_that_never_sees_the_subject_is_read_as_the_others_are(tmp_path: Path) -> None:
    base = written(folders(tmp_path), straight)
    for path in (base / "masks" / NAMES[0]).iterdir():
        cv2.imwrite(str(path), straight(np.zeros((180, 240))).astype(np.uint8))
    assert not any(m.any() for m in open_source(find(base), "masks").read(0, FRAMES))


@pytest.mark.parametrize("ending", [".png", ".jpg"])
@pytest.mark.parametrize("colour", [0, 255], ids=["black", "white"])
def test_a_subject_cut_out_before_one_colour_is_whatever_is_not_of_it(tmp_path: Path, colour: int, ending: str) -> None:
    capture = find(written(folders(tmp_path / "cut"), before(colour), ending=ending))
    check(capture, 0.9)
    (told,) = said(capture, "is read as the subject")
    assert f"masks are pictures of the subject before #{f'{colour:02x}' * 3}: " in told
    assert not said(capture, "veil")


def test_a_file_without_alpha_beside_those_that_are_read_by_theirs_is_refused(tmp_path: Path) -> None:
    base = written(folders(tmp_path), straight)
    path = base / "masks" / NAMES[1] / "000001.png"
    cv2.imwrite(str(path), shape(1, 1).astype(np.uint8))
    with pytest.raises(
        UserError, match=rf"camera {NAMES[1]}: masks are read by their alpha.* 1 have none.*000001\.png"
    ):
        find(base)


def coloured(mask: np.ndarray) -> np.ndarray:
    return np.dstack([mask * 0.3, mask, mask * 0])


def parts(mask: np.ndarray) -> np.ndarray:
    """Labels in a palette's colours, one a part of the body."""
    palette = RANDOM.integers(130, 256, (20, 3))
    height, width = mask.shape
    label = (np.arange(height)[:, None] // 20 * 4 + np.arange(width) // 30) % 20
    return np.where((mask > 127)[..., None], palette[label], 0)


def straightened(mask: np.ndarray) -> np.ndarray:
    """Black and white, transparent where a lens without its distortion shows nothing."""
    alpha = np.full_like(mask, 255)
    alpha[:3] = alpha[:, :3] = 0
    return np.dstack([np.where(mask > 127, 255, 0)] * 3 + [alpha])


@pytest.mark.parametrize("soft", [0, 6])
@pytest.mark.parametrize(
    ("write", "ending"),
    [
        (lambda m: np.dstack([m, m, m]), ".jpg"),
        (coloured, ".png"),
        (coloured, ".jpg"),
        (parts, ".png"),
        (straightened, ".png"),
    ],
    ids=["grey", "coloured", "coloured JPEG", "parts", "straightened"],
)
def test_masks_of_one_colour_labels_and_straightened_ones_are_read_by_their_largest_channel(
    tmp_path: Path, write: Write, soft: int, ending: str
) -> None:
    def softened(mask: np.ndarray) -> np.ndarray:
        return write(cv2.GaussianBlur(mask, (0, 0), soft) if soft else mask)

    capture = find(written(folders(tmp_path), softened, ending=ending))
    streams = [s for s in capture.masks if s]
    assert not any(s.options.keys() & {"alpha", "background"} for s in streams)
    assert as_cut_out(NAMES, streams)[1] == []
