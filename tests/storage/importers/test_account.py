"""What every import says, whatever the layout: unit, direction, distances, sizes, and frames that differ by one."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from posegaussian.storage.importers.account import accounted
from posegaussian.storage.importers.evidence import check_direction
from posegaussian.storage.importers.find import find_capture
from posegaussian.storage.importers.registry import IMPORTERS
from posegaussian.storage.model.capture import Capture, Stream
from posegaussian.storage.model.errors import CalibrationError
from tests.fuzz import captures
from tests.storage.importers import test_dynacap, test_videos
from tests.support import ring

WRITE = {
    **{layout: getattr(captures, layout) for layout in IMPORTERS if hasattr(captures, layout)},
    "colmap": partial(captures.colmap, "text"),
    "dynacap": test_dynacap.write,
    "videos": partial(captures.films_and, test_videos.kalibr),
}


@pytest.mark.parametrize("layout", IMPORTERS)
def test_every_layout_says_unit_direction_distances_and_sizes(layout: str, tmp_path: Path) -> None:
    WRITE[layout](tmp_path / "capture")
    said = find_capture(layout, tmp_path / "capture", {}).notes
    assert any(n.startswith("unit:") for n in said), said
    assert sum(n.startswith(("direction:", "one camera only")) for n in said) >= 1, said
    assert sum("m apart" in n or "one camera only" in n for n in said) >= 1, said
    assert any("calibrated size" in n or "the calibration is for" in n for n in said), said


def write(base: Path, **changed: Any) -> Path:
    """The ring as the layout `images` has it."""
    cameras = []
    for v in range(4):
        own = {"R": ring.rotation(v).tolist(), "t": ring.translation(v).tolist()}
        size = {"width": ring.SIZE[0], "height": ring.SIZE[1]}
        own |= {key: value(v) for key, value in changed.items()}
        cameras.append({"name": f"c{v}", **size, "K": ring.intrinsics(v).tolist(), **own})
        ring.write_picture(base / "images" / f"c{v}" / "0.png", v, 0)
    (base / "cameras.json").write_text(json.dumps({"pixel_center": "integer", "frame_rate": 30, "cameras": cameras}))
    return base


def test_a_camera_that_shares_no_frame_with_another_is_named(tmp_path: Path) -> None:
    base = write(tmp_path)
    for number in (7, 8):
        ring.write_picture(base / "images" / "c2" / f"{number}.png", 2, 0)
    assert not any("shares no frame" in n for n in find_capture("images", base, {}).notes)
    (base / "images" / "c2" / "0.png").unlink()
    (told,) = (n for n in find_capture("images", base, {}).notes if "shares no frame" in n)
    assert told.startswith("camera c2 shares no frame with any other (7-8), so that nothing is made of its pictures")


def test_poses_of_the_other_direction_are_refused_where_the_layout_defines_one(tmp_path: Path) -> None:
    said = find_capture("images", write(tmp_path), {}).notes
    assert "direction: world to camera; all cameras look at one point to 0 degrees" in said
    inverse = {"R": lambda v: ring.rotation(v).T.tolist(), "t": lambda v: ring.centre(v).tolist()}
    with pytest.raises(CalibrationError, match="the poses were written in the other direction"):
        find_capture("images", write(tmp_path, **inverse), {})


def test_cameras_side_by_side_are_not_judged_by_where_their_axes_meet() -> None:
    """Three that spread by two degrees each meet behind themselves, which is no error; at 40 degrees it is."""

    def spread(step: float) -> tuple[np.ndarray, np.ndarray]:
        turned = [cv2.Rodrigues(np.array([0, -np.radians(step * v), 0]))[0] for v in (-1, 0, 1)]
        return np.stack(turned), np.array([[0.3 * v, 0, 0] for v in (-1, 0, 1)])

    said = check_direction("abc", *spread(2), "world to camera")
    assert said == ["direction: world to camera, as the format has it; all cameras look one way, to 4 degrees"]
    with pytest.raises(CalibrationError, match="every camera looks straight away from one point"):
        check_direction("abc", *spread(40), "world to camera")


def test_videos_that_differ_by_a_frame_are_said(tmp_path: Path) -> None:
    own = find_capture("images", write(tmp_path), {})

    def said(*lengths: int, **options: Any) -> bool:
        streams = tuple(Stream("video", (), tuple(range(n)), ring.SIZE, options) for n in lengths)
        capture = Capture("x", own.rig, 30.0, streams)
        return any("frames and are taken to begin together" in n for n in accounted(capture, True).notes)

    def begun(*firsts: int) -> Capture:
        streams = tuple(Stream("video", (), tuple(range(k, 10)), ring.SIZE) for k in firsts)
        return accounted(Capture("x", own.rig, 30.0, streams), True)

    assert said(9, 10, 9, 9)
    assert not any("begin together" in n for n in begun(0, 1, 0, 0).notes)
    assert not said(9, 9, 9, 9)
    assert not said(9, 12, 9, 9)


@pytest.mark.parametrize(("largest", "bits"), [(255, 8), (1023, 10), (4080, 12), (4095, 12), (4096, None), (0, None)])
def test_16_bit_pictures_that_use_the_lowest_bits_alone_are_said(
    tmp_path: Path, largest: int, bits: int | None
) -> None:
    """Whatever their alpha holds, and where one camera's pictures go farther none is accused."""
    write(tmp_path)

    def picture(v: int, most: int) -> None:
        values = np.full((ring.SIZE[1], ring.SIZE[0], 4), most // 3, np.uint16)
        values[5, 5, 1], values[..., 3] = most, 65535
        cv2.imwrite(str(tmp_path / "images" / f"c{v}" / "0.png"), values)

    for v in range(4):
        picture(v, largest)
    told = [n for n in find_capture("images", tmp_path, {}).notes if n.startswith("16-bit pictures")]
    if bits is None:
        assert not told
        return
    factor = 2 ** (16 - bits)
    dark = (
        f"16-bit pictures hold at most {largest} where looked at: {bits} bits in 16, which is {factor} times too dark"
    )
    assert told == [f"{dark}; multiply them by {factor} and import again"]
    picture(2, 60000)
    assert not any("16-bit" in n for n in find_capture("images", tmp_path, {}).notes)


def test_cameras_in_another_unit_are_said_with_what_it_may_be(tmp_path: Path) -> None:
    far = {"t": lambda v: (100 * ring.translation(v)).tolist()}
    told = [n for n in find_capture("images", write(tmp_path, **far), {}).notes if "are they in" in n]
    assert len(told) == 1
    assert "are they in centimetres or in millimetres? Then cameras lie up to" in told[0]
    assert "multiply translations by 0.01 or 0.001" in told[0]


def test_cameras_that_another_unit_makes_small_are_said_with_what_it_may_be(tmp_path: Path) -> None:
    """Metres that were read as millimetres: everything is carved away, and the pictures are empty."""

    def told(times: float) -> list[str]:
        near = {"t": lambda v: (times * ring.translation(v)).tolist()}
        return [n for n in find_capture("images", write(tmp_path, **near), {}).notes if "read as if" in n]

    (sentence,) = told(0.0003)
    assert "read as if they were millimetres? Then cameras lie up to" in sentence
    assert "multiply translations by 1000" in sentence
    (sentence,) = told(0.002)
    assert "centimetres or millimetres" in sentence
    assert "multiply translations by 100 or 1000" in sentence
    assert not told(1.0)
    assert not told(0.1), "a rig of decimetres there may be"


def test_a_camera_whose_pictures_stay_the_same_while_others_change_is_said_with_its_frames(tmp_path: Path) -> None:
    """Stood still for all, as before a statue, it is no fault of one."""
    write(tmp_path)

    def said(standing: Mapping[int, tuple[int, ...]]) -> list[str]:
        for v, n in np.ndindex(4, 8):
            instant = 3 if n in standing.get(v, ()) else n
            ring.write_picture(tmp_path / "images" / f"c{v}" / f"{n}.png", v, instant)
        return [n for n in find_capture("images", tmp_path, {}).notes if "show the same picture" in n]

    assert not said({})
    (told,) = said({2: (3, 4, 5)})
    assert told.startswith("c2: frames 3 to 5 show the same picture, while other cameras' change")
    assert [n[:2] for n in said({1: (3, 4), 2: (3, 4)})] == ["c1", "c2"], "most of the others change"
    assert not said(dict.fromkeys((0, 1, 2), (3, 4)))
    assert not said(dict.fromkeys(range(4), tuple(range(8))))
