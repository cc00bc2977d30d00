"""Pictures of another size than their calibration:
what bars and shapes tell is found, what they leave open is refused."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from posegaussian.storage.importers.find import find_capture
from posegaussian.storage.importers.letterbox import Fit, explanations, measured
from posegaussian.storage.model.capture import Capture
from posegaussian.storage.model.crop import Crop
from posegaussian.storage.model.errors import CalibrationError
from tests.storage.importers.test_pose2sim import write_calibration
from tests.support import import_capture
from tests.support.video_clips import planes, write_clip

CALIBRATED = (320, 240)
LOSSY = [cv2.IMWRITE_JPEG_QUALITY, 50]


def scene(seed: int, size: tuple[int, int] = CALIBRATED, low: float = 60, high: float = 220) -> np.ndarray:
    """[h, w, 3] smooth blobs from `low` to `high`, with a camera's noise."""
    rng = np.random.default_rng(seed)
    blobs = cv2.GaussianBlur(rng.normal(size=(size[1], size[0])), (0, 0), 9)
    blobs = (blobs - blobs.min()) / np.ptp(blobs)
    return np.clip(
        (low + (high - low) * blobs)[..., None] + rng.normal(scale=2, size=(size[1], size[0], 3)), 0, 255
    ).astype(np.uint8)


def filmed(size: tuple[int, int], at: tuple[int, int, int, int], picture: np.ndarray) -> np.ndarray:
    """The calibrated picture scaled to `at` (left, top, width, height) of a black picture of `size`, as a lossy
    codec leaves it."""
    out = np.zeros((size[1], size[0], 3), np.uint8)
    left, top, width, height = at
    out[top : top + height, left : left + width] = cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)
    return cv2.imdecode(cv2.imencode(".jpg", out, LOSSY)[1], cv2.IMREAD_COLOR)


def explained(
    size: tuple[int, int], at: tuple[int, int, int, int], calibrated: tuple[int, int] = CALIBRATED, **light: float
) -> list[Fit]:
    shown = [filmed(size, at, scene(seed, calibrated, **light)) for seed in range(3)]
    return explanations(calibrated, size, measured(shown))


def off(crop: Crop, at: tuple[int, int, int, int], calibrated: tuple[int, int] = CALIBRATED) -> float:
    """Calibrated px by which a corner of the calibrated picture is missed, at most."""
    left, top, width, height = at
    corners = np.array([[left, top], [left + width, top + height]], float)
    return float(np.abs(corners * crop.scale + crop.offset - [[0, 0], calibrated]).max())


@pytest.mark.parametrize(
    ("size", "at", "how"),
    [
        ((160, 120), (0, 0, 160, 120), "same shape"),
        ((640, 480), (0, 0, 640, 480), "same shape"),
        ((320, 270), (0, 15, 320, 240), "not scaled and letterboxed"),
        ((160, 134), (0, 7, 160, 120), "scaled down by 2 and letterboxed"),
        ((427, 240), (53, 0, 320, 240), "53 black columns at the left"),
        ((320, 248), (0, 0, 320, 240), "inside black bars, which are always dark: 8 below"),
        ((352, 288), (16, 24, 320, 240), "inside black bars"),
        ((200, 120), (30, 0, 160, 120), "inside black bars"),
    ],
)
@pytest.mark.parametrize("light", [{"low": 60, "high": 220}, {"low": 2, "high": 130}], ids=["bright", "dark corners"])
def test_scale_and_bars_are_found(size: tuple[int, int], at: tuple[int, int, int, int], how: str, light: dict) -> None:
    """To 0.5 px at the corners; the one even pixel more or less that codecs want is half a pixel on either side."""
    (found,) = explained(size, at, **light)
    assert how in found.how
    assert off(found.crop, at) <= 0.5 * max(1.0, found.crop.scale)


def test_a_dark_ceiling_is_no_bar_and_hides_none() -> None:
    """One edge of the letterbox is seen; beyond the other the scene itself is dark."""

    def ceiling(seed: int) -> np.ndarray:
        picture = scene(seed)
        picture[:50] = picture[:50] // 8
        return picture

    letterboxed = [filmed((320, 270), (0, 15, 320, 240), ceiling(seed)) for seed in range(3)]
    (found,) = explanations(CALIBRATED, (320, 270), measured(letterboxed))
    assert off(found.crop, (0, 15, 320, 240)) <= 0.5
    plain = [filmed((160, 120), (0, 0, 160, 120), ceiling(seed)) for seed in range(3)]
    (found,) = explanations(CALIBRATED, (160, 120), measured(plain))
    assert off(found.crop, (0, 0, 160, 120)) == 0


def test_a_flash_of_light_in_one_frame_ends_a_bar() -> None:
    dark = np.zeros((270, 320, 3), np.uint8)
    dark[15:] = scene(0)[0, 0]
    lit = dark.copy()
    lit[6:] = 200
    assert measured([dark]).top == (15, True)
    assert measured([dark, lit]).top.dark == 6


@pytest.mark.parametrize("level", [4, 30])
def test_in_the_dark_nothing_is_known(level: int) -> None:
    night = [np.full((270, 320, 3), level, np.uint8)]
    assert explanations(CALIBRATED, (320, 270), measured(night)) == []


def test_bars_in_a_picture_of_the_same_shape_leave_it_open() -> None:
    """Either the bars were there when the camera was calibrated, or they came after."""
    both = explained((320, 240), (40, 30, 240, 180), calibrated=(640, 480))
    assert len(both) == 2


def capture_of(
    folder: Path,
    size: tuple[int, int],
    at: tuple[int, int, int, int],
    aspect: Fraction | None = None,
    **options: object,
) -> Capture:
    """A pose2sim folder whose cam2 was filmed at another size, in H.264; bars of a film have luma 16."""
    (folder / "videos").mkdir(exist_ok=True)
    for name in import_capture.NAMES:
        shown, stretched = [scene(i, import_capture.SIZE)[..., 1] for i in range(4)], None
        if name == "cam2":
            stretched = aspect
            shown = [np.maximum(filmed(size, at, scene(i, import_capture.SIZE))[..., 1], 16) for i in range(4)]
        write_clip(folder / "videos" / f"{name}.mp4", [planes(s) for s in shown], aspect=stretched)
    write_calibration(folder)
    return find_capture("pose2sim", folder, options)


def test_a_letterboxed_video_is_imported_and_what_was_decided_is_said(tmp_path: Path) -> None:
    found = capture_of(tmp_path, (64, 64), (0, 8, 64, 48))
    assert found.crops == {"cam2": Crop(scale=1, offset=(0, -8))}
    (said,) = (n for n in found.notes if "letterboxed" in n)
    assert (
        said
        == "camera cam2: pictures are 64x64 px, the calibration is for 64x48 px: not scaled and letterboxed: 8 black"
        " rows above and 8 black rows below are always dark, where this leaves 8.0 at each of the two sides;"
        " captured x becomes 1 x + (0, -8), unless frames.crop says otherwise"
    )
    again = Capture.from_json(found.to_json())
    assert again.crops == found.crops


def test_the_setting_wins(tmp_path: Path) -> None:
    crop = {"cam2": {"scale": 1.0, "offset": (0.0, -7.0)}}
    found = capture_of(tmp_path, (64, 64), (0, 8, 64, 48), crop=crop)
    assert found.crops == {"cam2": Crop(scale=1, offset=(0, -7))}


def test_what_is_refused_is_printed_with_settings_to_copy(tmp_path: Path) -> None:
    """A picture without bars and of another shape was cut, stretched or scaled: nobody can tell."""
    with pytest.raises(
        CalibrationError,
        match=(
            "camera cam2: pictures are 60x48 px, the calibration is for 64x48 px;"
            " that is another shape, and there are no black bars"
        ),
    ) as refused:
        capture_of(tmp_path, (60, 48), (0, 0, 60, 48))
    copied = [line for line in str(refused.value).splitlines() if line.startswith(" ")]
    assert yaml.safe_load("\n".join(copied)) == {"frames": {"crop": {"cam2": {"scale": 1.06667, "offset": [0, -1.6]}}}}
    # A comment instead of the value is a setting, too.
    other = [line.replace("# cam2", "cam2") for line in copied if "scale: 1.06667" not in line]
    assert yaml.safe_load("\n".join(other)) == {"frames": {"crop": {"cam2": {"scale": 1, "offset": [2, 0]}}}}


def test_pixels_that_are_not_square_are_named_and_no_crop_is_advised(tmp_path: Path) -> None:
    """Neither width nor height alone would be right: the picture is stretched."""
    with pytest.raises(CalibrationError) as refused:
        capture_of(tmp_path, (48, 48), (0, 0, 48, 48), Fraction(4, 3))
    assert "pixels are not square, and players show it as 64x48 px" in str(refused.value)
    assert f"ffmpeg -i {tmp_path / 'videos' / 'cam2.mp4'} -vf scale=64:48,setsar=1 OUT" in str(refused.value)
    assert "crop" not in str(refused.value)


def test_a_turned_picture_is_named(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match=r"camera cam2: .* the picture is turned by a quarter"):
        capture_of(tmp_path, (48, 64), (0, 0, 48, 64))
