"""Left-out views: what a picture scores, who draws it, and that the better candidate scores more."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
import pytest

from posegaussian.stages.contract.facts import Facts
from posegaussian.stages.contract.io import TaskScope, Views
from posegaussian.stages.contract.judged import NONE, cannot_judge, mean_of_asked, mean_scores
from posegaussian.stages.depth.params import DepthParams
from posegaussian.stages.imaging.color import gain_table
from posegaussian.stages.judge.drawing import score, scores, with_gaussians
from posegaussian.stages.judge.memory import Frames
from posegaussian.stages.simulator.subjects.capsule_person import capture_person

PLAIN = Facts()


@cache
def person(views: int = 6, size: int = 64) -> Frames:
    """One frame of the person, all cameras sources."""
    filmed = capture_person(views=views, size=size, frames=1, held_out=0, motion="kick")
    rig = filmed.rig
    scope = TaskScope(
        partition=range(1),
        source_frames=np.zeros(1, int),
        time=np.zeros(1),
        valid=np.ones((1, len(rig)), bool),
        views=Views(rig.names, tuple(range(len(rig))), ()),
        view=None,
        rig=rig,
        source_rig=rig,
        captured_to_calibrated=np.tile([1.0, 0.0, 0.0], (len(rig), 1)),
        path=None,
        facts=Facts(frozenset({"left_right_check"})),
        joint_set=None,
    )
    return Frames(scope, {"frames/color": filmed.color[:1], "frames/mask": filmed.mask[:1]})


@cache
def made(method: str) -> Frames:
    return with_gaussians(person(), DepthParams(), method)


def test_a_camera_s_own_light_changes_no_score_and_a_perfect_picture_is_perfect() -> None:
    frames = person()
    filmed, mask = frames.read("frames/color", 0)[0], frames.read("frames/mask", 0)[0]
    exact = np.rint(filmed * (mask[..., None] / 255.0)).astype(np.uint8)
    psnr, ssim, coverage = score(exact, mask, filmed, mask)
    assert psnr > 50  # half a step of rounding: 58 dB
    assert ssim > 0.999
    assert coverage == 1.0
    blurred = cv2.GaussianBlur(exact, (0, 0), 2.0)
    plain, darker = (score(np.rint(blurred * g).astype(np.uint8), mask, filmed, mask) for g in (1.0, 0.8))
    assert plain[0] < psnr
    assert darker[0] == pytest.approx(plain[0], abs=0.05)  # rounding after the gain


def test_a_left_out_view_s_own_gaussians_draw_nothing() -> None:
    """Whatever they are: here they would fill the picture."""
    whole, filmed = made("hull"), person().read("frames/color")
    before = scores(whole, filmed, [2], PLAIN)
    opacity = whole.read("gaussians/opacity").copy()
    opacity[:, 2] = 0
    after = scores(whole.with_array("gaussians/opacity", opacity), filmed, [2], PLAIN)
    np.testing.assert_array_equal(before, after)
    opacity = np.zeros_like(opacity)
    opacity[:, 2] = whole.read("gaussians/opacity")[:, 2]
    own_alone = scores(whole.with_array("gaussians/opacity", opacity), filmed, [2], PLAIN)
    assert own_alone[0, 2] == 0.0, "nothing of the person is covered"


def test_depth_that_is_wrong_scores_less() -> None:
    frames, filmed = made("hull"), person().read("frames/color")
    depth = frames.read("depth/depth")
    views = list(frames.views.sources)
    right, wrong = (
        mean_scores(scores(frames.with_array("depth/depth", d), filmed, views, PLAIN)[:, None])
        for d in (depth, depth * np.float32(1.05))
    )
    assert right is not None
    assert wrong is not None
    assert right[0, 0] > wrong[0, 0] + 1


def test_gains_that_even_cameras_out_score_more_and_gains_of_equal_cameras_score_less() -> None:
    frames, filmed = made("hull"), person().read("frames/color")
    odd = filmed.copy()
    for v in range(0, odd.shape[1], 2):  # half a stop, every second camera
        cv2.LUT(filmed[0, v], gain_table(np.full(3, 2**-0.5)), dst=odd[0, v])
    views = list(frames.views.sources)

    def psnr(color: np.ndarray, compared: np.ndarray) -> float:
        found = mean_scores(scores(frames.with_array("frames/color", color), compared, views, PLAIN)[:, None])
        assert found is not None
        return float(found[0, 0])

    assert psnr(filmed, odd) > psnr(odd, odd), "matched again, compared in each camera's own light"
    assert psnr(filmed, filmed) > psnr(odd, filmed), "spoilt where nothing was to match"


def test_only_what_was_drawn_counts() -> None:
    drawn = np.array([[[20.0, 0.8, 1.0], [22.0, 0.9, 1.0]], [[NONE] * 3, [30.0, 0.9, 1.0]]])
    means = mean_scores(drawn)
    assert means is not None
    np.testing.assert_array_equal(means[:, 0], [20.0, 22.0])
    assert mean_scores(drawn[1:]) is None
    assert cannot_judge(2, True) is not None
    assert cannot_judge(3, False) is not None
    assert cannot_judge(3, True) is None


def test_a_candidate_that_was_not_asked_takes_no_picture_from_the_others() -> None:
    asked = np.random.default_rng(0).uniform(10, 30, (4, 2, 3))
    asked[3, 1] = NONE
    every = np.insert(asked, 1, NONE, axis=1)
    means, alone = mean_of_asked(every), mean_scores(asked)
    assert means is not None
    assert alone is not None
    np.testing.assert_array_equal(means[[0, 2]], alone)
    assert (means[1] == NONE).all()
    assert mean_of_asked(np.full((4, 3, 3), NONE)) is None


def test_a_view_without_a_picture_is_not_drawn_and_draws_nothing() -> None:
    frames = made("hull")
    missing = Frames(
        TaskScope(**{n: getattr(frames, n) for n in TaskScope.__dataclass_fields__} | {"valid": _all_but(frames, 1)}),
        {n: frames.read(n) for n in ("frames/color", "frames/mask", "depth/depth")}
        | {f"gaussians/{n}": frames.read(f"gaussians/{n}") for n in ("scale", "rotation", "opacity")},
    )
    found = scores(missing, person().read("frames/color"), [0, 1], PLAIN)
    assert (found[1] == NONE).all()
    assert (found[0] != NONE).all()


def _all_but(frames: Frames, view: int) -> np.ndarray:
    valid = frames.valid.copy()
    valid[:, view] = False
    return valid


def test_what_does_not_count_changes_no_score() -> None:
    frames = person()
    filmed, mask = frames.read("frames/color", 0)[0], frames.read("frames/mask", 0)[0].copy()
    rows = np.nonzero(mask.any(axis=1))[0]
    behind = np.zeros(mask.shape, bool)
    behind[rows[len(rows) // 2] :][:6] = True
    picture = np.rint(filmed * (mask[..., None] / 255.0)).astype(np.uint8)
    mask[behind] = 0
    assert score(picture, mask, filmed, mask, ~behind)[0] > 50 > score(picture, mask, filmed, mask)[0]
