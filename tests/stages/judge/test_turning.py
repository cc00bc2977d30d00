"""Which of three ways the cameras stand is taken: by the pictures of left-out views, and only where one of them is
clearly better than the one before."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from posegaussian.stages.contract.judged import CALIBRATION, TURNS
from posegaussian.stages.imaging.calibration import ALONE_GAIN, LEAST_GAIN
from posegaussian.stages.judge import turning

LINKED, TOGETHER = np.full((3, 3), 0.01), np.full((3, 3), 0.002)


class Drawn:
    """Frames of cameras that are turned so."""

    def __init__(self, turns: np.ndarray | None) -> None:
        self.turns = np.zeros((3, 3)) if turns is None else turns

    def read(self, name: str) -> None:
        """Nothing: pictures are scored by how the cameras stand."""


def taken(
    monkeypatch: pytest.MonkeyPatch,
    written: float,
    linked: float,
    together: float,
    near: bool = False,
    asked: bool = True,
) -> turning.Turned:
    """With left-out views drawn so well, in dB."""
    psnr = {0.0: written, 0.01: linked, 0.012: together, 0.002: together}
    score = lambda made, *rest: np.array([[psnr[round(float(made.turns[0, 0]), 3)], 0.9, 1.0]])  # noqa: E731
    fakes: dict[str, Any] = {
        "frames_of": lambda inputs, most, turns: Drawn(turns),
        "with_gaussians": lambda frames, *rest: frames,
        "body_facts": lambda inputs, method: None,
        "scores": score,
        "near": lambda inputs: near,
        "turns_by_links": lambda inputs: LINKED,
        "turns_together": lambda made: TOGETHER,
    }
    for name, fake in fakes.items():
        monkeypatch.setattr(turning, name, fake)
    inputs: Any = SimpleNamespace(settings={"depth": None}, facts={TURNS, *([CALIBRATION] if asked else [])})
    return turning.as_filmed(inputs, 2, "sweep", [0, 1])


@pytest.mark.parametrize(
    ("linked", "together", "frames", "turns"),
    [
        (19.0, 30.0, 0.0, LINKED),  # what links say is wrong: nothing is built on it
        (20.0 + 0.9 * LEAST_GAIN, 30.0, 0.0, LINKED),
        (21.0, 20.5, 0.01, LINKED),
        (21.0, 21.0 + 0.9 * LEAST_GAIN, 0.01, LINKED),
        (21.0, 21.0 + 1.1 * LEAST_GAIN, 0.012, LINKED + TOGETHER),
    ],
)
def test_cameras_turn_as_far_as_left_out_views_gain(
    linked: float, together: float, frames: float, turns: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = taken(monkeypatch, 20.0, linked, together)
    np.testing.assert_allclose(found.taken.frames.turns, frames)  # type: ignore[attr-defined]
    np.testing.assert_allclose(found.turns, turns)
    best = max(linked, together) if frames > 0.011 else linked
    np.testing.assert_allclose(found.drawn[..., 0], [[20.0, best]])


@pytest.mark.parametrize(("together", "taken_over"), [(19.0, False), (20 + 0.9 * ALONE_GAIN, False), (20.2, True)])
def test_cameras_near_what_links_tell_are_turned_by_pictures_alone(
    together: float, taken_over: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = taken(monkeypatch, 20.0, 30.0, together, near=True)
    np.testing.assert_allclose(found.taken.frames.turns, 0.002 * taken_over)  # type: ignore[attr-defined]
    np.testing.assert_allclose(found.turns, TOGETHER)
    np.testing.assert_allclose(found.drawn[..., 0], [[20.0, together]])


@pytest.mark.parametrize(("near", "turns"), [(False, LINKED), (True, TOGETHER)])
def test_forced_on_all_else_is_compared_with_the_cameras_that_the_run_will_have(
    near: bool, turns: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = taken(monkeypatch, 20.0, 19.0, 18.0, near, asked=False)
    np.testing.assert_allclose(found.turns, turns)
    np.testing.assert_allclose(found.taken.frames.turns, turns)  # type: ignore[attr-defined]
