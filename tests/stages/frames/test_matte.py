"""The background plate's matte against the true mask of a person before a wall."""

import numpy as np
import pytest

from stages.capture.person import ring
from stages.frames.matte import plate_distance, plate_matte
from stages.frames.params import FramesParams
from stages.frames.run import check
from stages.frames.stage import STAGE as FRAMES
from stages.io import Block, Views
from stages.survey.params import SurveyParams
from stages.survey.stage import STAGE as SURVEY
from tests.memory import run_stage
from tests.stages.frames.fakes import Pictures, film, overlap, wall


def _masks(pictures: np.ndarray, matte: str = "auto") -> tuple[np.ndarray, list[str]]:
    """Masks [F, h, w] and warnings by survey and frames together."""
    size = pictures.shape[1]
    rig = ring(1, size, 0)
    views, sources = Views(rig.names, (0,), ()), {"pictures": Pictures([list(pictures)])}
    survey = run_stage(SURVEY, SurveyParams(), {}, rig, views, 1, view=0, sources=sources)
    out = run_stage(FRAMES, FramesParams(matte=matte), survey, rig, views, len(pictures), view=0, sources=sources)
    mask = out["frames/mask"][:, 0]
    return mask, check(Block("frames/mask", mask, 0), FramesParams(matte=matte))


@pytest.mark.parametrize("view", [0, 2])
def test_a_walking_person_is_found_and_the_shadow_is_not(view: int) -> None:
    pictures, truth = film(256, 24, view, walk=2.2)
    mask, warnings = _masks(pictures)
    scores = [overlap(m, t) for m, t in zip(mask, truth, strict=True)]
    # Grey cloth before a grey wall, a shadow of a third: 0.9 is typical at 256 px, where one pixel of outline is 0.07.
    assert np.median(scores) > 0.88
    assert min(scores) > 0.8
    assert warnings == []


def test_an_empty_scene_has_no_foreground() -> None:
    size, rng = 128, np.random.default_rng(0)
    noisy = np.clip(wall(size, 1) + rng.normal(0, 4, (6, size, size, 3)), 0, 255).astype(np.uint8)
    mask, warnings = _masks(noisy)
    assert not mask.any()
    assert len(warnings) == 1
    assert "frames.matte: none" in warnings[0]


def test_a_subject_that_stays_in_its_place_is_warned_about() -> None:
    pictures, truth = film(128, 6, 0, walk=0.0)
    still = np.repeat(pictures[:1], 6, axis=0)
    mask, warnings = _masks(still)
    assert not mask.any()
    assert "part of the background plate" in warnings[0]
    assert truth[0].any()


def test_a_plate_that_does_not_fit_is_warned_about() -> None:
    picture = np.full((3, 64, 64, 3), 90, np.uint8)
    mask = np.stack([plate_matte(p, np.full_like(p, 200) * np.array([1, 0, 1], np.uint8), np.zeros((64, 64), np.uint8), 30.0) for p in picture])
    assert "camera moves" in check(Block("frames/mask", mask, 0), FramesParams())[0]


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
