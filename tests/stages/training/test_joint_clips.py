"""Joints of clips: exact where nothing is wrong, wrong as estimators are, and stabilised by the stage's own filter."""

from __future__ import annotations

import numpy as np
import pytest

from posegaussian.stages.smoothing.params import SmoothingParams
from posegaussian.stages.smoothing.run import stabilised
from posegaussian.stages.training import joint_clips
from posegaussian.stages.training.joint_clips import EXACT, Marks, found, heatmaps_of, marks_drawn

SIZE = (64, 64)
STILL = np.concatenate([np.tile(np.linspace(12.0, 52.0, 17)[:, None], (3, 1, 2)), np.ones((3, 17, 1))], axis=-1)
PLAIN = Marks(False, 2.0, 0.0, 0.0, 6.0, "none")


@pytest.fixture
def calm(monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither limbs hidden, nor sides exchanged, nor joints elsewhere."""
    for name in ("LIMB", "TURNED", "ELSEWHERE"):
        monkeypatch.setattr(joint_clips, name, 0.0)


def test_exact_joints_stay_and_a_clip_without_joints_has_none() -> None:
    np.testing.assert_array_equal(found(STILL, EXACT, None), STILL)
    none = found(STILL, PLAIN._replace(none=True), np.random.default_rng(0))
    assert not none[..., 2].any()
    assert not heatmaps_of(none, SIZE, PLAIN)[0].any()


@pytest.mark.usefixtures("calm")
@pytest.mark.parametrize("drift", [0.0, 0.9])
def test_errors_are_as_large_as_asked_and_last_as_asked(drift: float) -> None:
    off = np.stack(
        [
            found(STILL, PLAIN._replace(drift=drift), np.random.default_rng(s))[..., :2] - STILL[..., :2]
            for s in range(60)
        ]
    )
    # 60 x 17 x 2 draws a frame: standard errors of 1.6 % and 0.022
    np.testing.assert_allclose(off.std(axis=(0, 2, 3)), 2.0, rtol=0.07)
    lasting = (off[:, 1:] * off[:, :-1]).mean() / (off**2).mean()
    assert lasting == pytest.approx(drift, abs=0.07)


@pytest.mark.usefixtures("calm")
def test_hidden_joints_are_twice_as_far_off_and_score_less() -> None:
    hidden = STILL.copy()
    hidden[:, ::2, 2] = 0
    out = np.stack([found(hidden, PLAIN, np.random.default_rng(s)) for s in range(60)])
    off = (out[..., :2] - hidden[..., :2]).std(axis=(0, 1, 3))
    assert off[::2].mean() == pytest.approx(2 * off[1::2].mean(), rel=0.1)
    assert out[..., ::2, 2].max() < out[..., 1::2, 2].min()


def test_joints_are_missed_sides_exchanged_and_limbs_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    marks = PLAIN._replace(noise=0.0, missed=0.2)
    monkeypatch.setattr(joint_clips, "LIMB", 0.0)
    monkeypatch.setattr(joint_clips, "TURNED", 0.0)
    missed = np.stack([found(STILL, marks, np.random.default_rng(s))[..., 2] == 0 for s in range(80)])
    assert missed.mean() == pytest.approx(0.2, abs=0.03)
    assert (missed.all(axis=1) | ~missed.any(axis=1)).mean() > 0.5, "half of them in all frames"
    monkeypatch.setattr(joint_clips, "TURNED", 1.0)
    turned = [found(STILL, PLAIN._replace(noise=0.0), np.random.default_rng(s)) for s in range(20)]
    assert any(not np.allclose(t[-1, 13:, :2], STILL[-1, 13:, :2]) for t in turned)
    assert all(np.allclose(np.sort(t[..., 0]), np.sort(STILL[..., 0])) for t in turned), "the same places"
    monkeypatch.setattr(joint_clips, "TURNED", 0.0)
    monkeypatch.setattr(joint_clips, "LIMB", 1.0)
    lost = [found(STILL, PLAIN, np.random.default_rng(s))[..., 2] for s in range(20)]
    assert all((s.max(axis=0) < 0.4).sum() == 2 for s in lost)


@pytest.mark.parametrize("kind", ["pairwise", "recurrent", "adaptive"])
def test_what_the_pose_encoder_sees_is_what_the_stage_gives(kind: str) -> None:
    marks = PLAIN._replace(stabiliser=kind)  # type: ignore[arg-type]
    joints = found(STILL, marks, np.random.default_rng(3))
    alone, steady = heatmaps_of(joints, SIZE, marks)
    np.testing.assert_array_equal(alone, heatmaps_of(joints[-1:], SIZE, PLAIN)[0])
    drawn = joint_clips.draw(joints, np.full((3, 17), marks.sigma), SIZE, (16, 16))
    kept = slice(None) if kind == "recurrent" else slice(1, None)
    np.testing.assert_array_equal(steady, stabilised(drawn[kept], joints[kept], SmoothingParams(method=kind)))  # type: ignore[arg-type]
    assert not np.array_equal(alone, steady)
    first, same = heatmaps_of(joints[-1:], SIZE, marks)
    np.testing.assert_array_equal(first, same, err_msg="the first frame passes")


def test_every_stabiliser_is_drawn() -> None:
    random = np.random.default_rng(0)
    drawn = [marks_drawn(("none", "adaptive"), random) for _ in range(60)]
    assert {m.stabiliser for m in drawn} == {"none", "adaptive"}
    assert {m.none for m in drawn} == {True, False}
