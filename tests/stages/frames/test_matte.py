"""The background plate's matte against the true mask of a person before a wall."""

from collections.abc import Sequence

import cv2
import numpy as np
import pytest

from posegaussian.stages.contract.io import Views
from posegaussian.stages.frames.facts import LIGHT_STEADYING
from posegaussian.stages.frames.mask_doubts import doubts
from posegaussian.stages.frames.params import FramesParams, Matte
from posegaussian.stages.frames.plate_matte import plate_distance, plate_matte
from posegaussian.stages.frames.run import run as frames_in
from posegaussian.stages.frames.stage import STAGE as FRAMES
from posegaussian.stages.imaging.color import gain_table
from posegaussian.stages.simulator.subjects.capsule_person import ring
from posegaussian.stages.survey.params import SurveyParams
from posegaussian.stages.survey.stage import STAGE as SURVEY
from tests.support.frame_readers import Joints, Pictures, film, overlap, wall
from tests.support.memory_inputs import MemoryInputs, run_stage


def _masks(
    pictures: np.ndarray, joints: np.ndarray | None = None, effects: frozenset[str] = frozenset()
) -> tuple[np.ndarray, list[str]]:
    """Masks [F, h, w] and warnings by survey and frames together, with effects that are on;
    with joints [F, 17, 3] the plate leaves people out."""
    size = pictures.shape[1]
    rig = ring(1, size, 0)
    views, sources = (
        Views(rig.names, (0,), ()),
        {
            "pictures": Pictures([list(pictures)]),
            "joints": None if joints is None else Joints(joints),
        },
    )
    facts = frozenset({"several_frames"} if joints is None else {"several_frames", "joints2d"})
    survey = run_stage(
        SURVEY,
        SurveyParams(),
        {},
        rig,
        views,
        1,
        view=0,
        sources=sources,
        facts=facts | {"survey/plate", "survey/spread"},
    )
    out = run_stage(
        FRAMES,
        FramesParams(matte="plate"),
        survey,
        rig,
        views,
        len(pictures),
        view=0,
        sources=sources,
        facts=facts | effects,
    )
    mask = out["frames/mask"][:, 0]
    return mask, list(doubts(mask, "plate"))


@pytest.mark.parametrize("view", [0, 2])
def test_a_walking_person_is_found_and_the_shadow_is_not(view: int) -> None:
    pictures, truth, _ = film(256, view, np.linspace(-1.1, 1.1, 24))
    mask, warnings = _masks(pictures)
    scores = [overlap(m, t) for m, t in zip(mask, truth, strict=True)]
    # Grey cloth before a grey wall, a shadow of a third: 0.9 is typical at 256 px, where one pixel of outline is 0.07.
    assert np.median(scores) > 0.88
    assert min(scores) > 0.8
    assert warnings == []


def test_a_camera_that_exposes_by_itself_loses_nobody() -> None:
    """Light that comes and goes by up to a quarter of a stop is taken for a person unless it is steadied."""
    pictures, truth, _ = film(256, 0, np.linspace(-1.1, 1.1, 24))
    drift = 0.25 * np.sin(1.3 * np.arange(24))
    changing = np.stack([cv2.LUT(p, gain_table(np.full(3, 2.0**d))) for p, d in zip(pictures, drift, strict=True)])
    still, lost, kept = (
        np.mean([overlap(m, t) for m, t in zip(_masks(p, effects=e)[0], truth, strict=True)])
        for p, e in ((pictures, frozenset()), (changing, frozenset()), (changing, frozenset({LIGHT_STEADYING})))
    )
    # What is rounded twice moves an outline here and there by a pixel, which is 0.07.
    assert kept > still - 0.02
    assert lost < kept - 0.1


def test_an_empty_scene_has_no_foreground() -> None:
    size, rng = 128, np.random.default_rng(0)
    noisy = np.clip(wall(size, 1) + rng.normal(0, 4, (6, size, size, 3)), 0, 255).astype(np.uint8)
    mask, warnings = _masks(noisy)
    assert not mask.any()
    assert len(warnings) == 1
    assert "frames.matte: none" in warnings[0]


def test_a_subject_that_stays_in_its_place_is_warned_about() -> None:
    pictures, truth, _ = film(128, 0, np.zeros(1))
    mask, warnings = _masks(np.repeat(pictures, 6, axis=0))
    assert truth.any()
    assert not mask.any()
    assert "part of the background plate" in warnings[0]


def test_joints_keep_a_subject_that_lingers_out_of_the_plate() -> None:
    # For two thirds of the film the person stands in the middle, so a plain median shows the person.
    offsets = np.concatenate([np.linspace(-1.0, 0.0, 4), np.zeros(16), np.linspace(0.0, 1.0, 4)])
    pictures, truth, joints = film(192, 0, offsets)
    plain, helped = (
        np.median([overlap(m, t) for m, t in zip(_masks(pictures, j)[0][4:20], truth[4:20], strict=True)])
        for j in (None, joints)
    )
    assert plain < 0.6
    assert helped > 0.75


def test_what_was_never_seen_uncovered_is_foreground_where_it_touches_some() -> None:
    plate = np.full((100, 100, 3), 150, np.uint8)
    picture = plate.copy()
    picture[20:50, 40:60] = (220, 40, 40)
    spread = np.zeros((100, 100), np.uint8)
    spread[48:80, 40:60] = 255
    spread[85:95, 5:15] = 255
    mask = plate_matte(picture, plate, spread, 30.0)
    assert (mask[24:76, 44:56] == 255).all()
    assert not mask[84:96, 4:16].any()


def test_a_plate_that_does_not_fit_is_warned_about() -> None:
    picture = np.full((3, 64, 64, 3), 90, np.uint8)
    mask = np.stack(
        [
            plate_matte(p, np.full_like(p, 200) * np.array([1, 0, 1], np.uint8), np.zeros((64, 64), np.uint8), 30.0)
            for p in picture
        ]
    )
    assert "camera moves" in doubts(mask, "plate")[0]


@pytest.mark.parametrize("matte", ["given", "person", "plate", "none"])
def test_advice_is_for_the_matte_there_is(matte: Matte) -> None:
    empty, full = np.zeros((3, 8, 8), np.uint8), np.full((3, 8, 8), 255, np.uint8)
    (of_nobody,), of_all = doubts(empty, matte), doubts(full, matte)
    assert ("import masks" in of_nobody) == (matte in ("person", "plate"))
    assert ("is the subject seen by that camera" in of_nobody) == (matte in ("given", "person"))
    assert bool(of_all) == (matte in ("person", "plate"))


def test_masks_that_came_with_the_capture_and_hold_nothing_are_told_as_such() -> None:
    rig = ring(1, 32, 0)
    masks, pictures = (Pictures([list(np.zeros((3, *s), np.uint8))]) for s in ((32, 32), (32, 32, 3)))
    inputs = MemoryInputs(
        FRAMES,
        FramesParams(),
        {},
        rig,
        Views(rig.names, (0,), ()),
        range(3),
        3,
        view=0,
        sources={"pictures": pictures, "masks": masks},
        facts=frozenset({"several_frames", "masks"}),
    )
    (told,) = (b.notes for b in frames_in(inputs, FramesParams()) if b.array == "frames/mask")
    assert len(told) == 1
    assert "3 of 3 masks hold less than" in told[0]
    assert "came with the capture" in told[0]


def test_distance_is_blind_to_shadows_and_sees_chromaticity() -> None:
    plate = np.full((64, 64, 3), (160, 140, 120), np.uint8)
    for factor in (1.0, 0.8, 0.65):
        assert plate_distance((plate * factor).astype(np.uint8), plate, 30.0).max() < 3.0
    assert plate_distance((plate * 0.3).astype(np.uint8), plate, 30.0).min() > 30.0, "darker than any shadow"
    assert plate_distance(plate + np.uint8(40), plate, 30.0).min() > 30.0, "brighter than the plate"
    assert plate_distance(plate[..., ::-1] - np.uint8(20), plate, 30.0).min() > 30.0, "another colour"


def test_speckles_go_and_limbs_stay() -> None:
    plate = np.full((200, 200, 3), 150, np.uint8)
    picture = plate.copy()
    picture[40:160, 80:120] = (200, 30, 30)
    picture[20:36, 90:110] = (200, 30, 30)
    picture[100:102, 20:22] = (0, 0, 255)
    picture[70:73, 95:98] = 150
    mask = plate_matte(picture, plate, np.zeros((200, 200), np.uint8), 30.0)
    truth = np.zeros((200, 200), np.uint8)
    truth[40:160, 80:120] = truth[20:36, 90:110] = 255
    assert overlap(mask, truth) > 0.97
    assert not mask[90:110, 10:30].any()


def ramp(size: int) -> np.ndarray:
    """[size, size, 3] uint8: a picture that shows something wherever its mask is."""
    return np.tile(np.linspace(0, 255, size).astype(np.uint8)[:, None, None], (1, size, 3))


@pytest.mark.parametrize("inverted", [(1,), (0, 1, 2)])
def test_given_masks_that_mark_the_background_are_warned_about_in_one_camera_and_in_all(
    inverted: tuple[int, ...],
) -> None:
    """A camera so near that the subject fills its picture has masks without any background, and a bust half a rim."""
    size, rig = 32, ring(3, 32, 0)
    whole, bust = np.full((size, size), 255, np.uint8), np.zeros((size, size), np.uint8)
    bust[4:, 6:26] = 255
    bust[20:] = 255
    small = np.zeros((size, size), np.uint8)
    small[8:28, 12:20] = 255
    readers = {
        "pictures": Pictures([[ramp(size)] * 3] * 3),
        "masks": Pictures([[whole - small if v in inverted else m] * 3 for v, m in enumerate((whole, bust, small))]),
    }
    for v in range(3):
        inputs = MemoryInputs(
            FRAMES,
            FramesParams(),
            {},
            rig,
            Views(rig.names, (0, 1, 2), ()),
            range(3),
            3,
            view=v,
            sources=readers,
            facts=frozenset({"masks"}),
        )
        (notes,) = (b.notes for b in frames_in(inputs, FramesParams()) if b.array == "frames/mask")
        assert bool(notes) == (v in inverted)
        assert not notes or ("3 of 3 masks are white along" in notes[0] and "mark the background" in notes[0])


def test_one_given_mask_that_goes_around_its_picture_and_one_that_was_turned_are_told_with_their_frames() -> None:
    """Of many: it costs its frame whatever the others hold."""

    class Turned(Pictures):
        def turned(self, view: int, numbers: Sequence[int]) -> list[int]:
            return [n for n in numbers if n == 2]

    size, rig = 32, ring(1, 32, 0)
    small = np.zeros((size, size), np.uint8)
    small[8:28, 12:20] = 255
    inputs = MemoryInputs(
        FRAMES,
        FramesParams(),
        {},
        rig,
        Views(rig.names, (0,), ()),
        range(6),
        6,
        view=0,
        sources={
            "pictures": Pictures([[ramp(size)] * 6]),
            "masks": Turned([[small, 255 - small, *[small] * 4]]),
        },
        facts=frozenset({"masks"}),
    )
    (told,) = (b.notes for b in frames_in(inputs, FramesParams()) if b.array == "frames/mask")
    turned, around = told
    assert "frame 2 are white along more than 90%" in turned
    assert "read the other way round" in turned
    assert "1 of 6 masks are white along more than 75%" in around
    assert "frame 1;" in around
