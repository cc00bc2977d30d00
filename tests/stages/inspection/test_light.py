"""Exposure in an inspection is the survey's measure: the same numbers, in the same words for the same cameras."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from posegaussian.stages.imaging.exposure import NONE, match
from posegaussian.stages.inspection.finding import FindingVerdict
from posegaussian.stages.inspection.light import of_light
from posegaussian.stages.survey.algorithms.surface import colors_at

STOPS = np.array([[0.0, 0, 0], [1.0, 1.2, 0.8], [0.0, 0, 0], [0, 0, 0]])


@pytest.fixture
def surface(monkeypatch: pytest.MonkeyPatch) -> np.ndarray:
    """[4, 4, 64, 3] as the survey takes it; the last camera shares nothing."""
    rng, out = np.random.default_rng(1), np.full((4, 4, 64, 3), NONE)
    for a, b in ((0, 1), (1, 2), (0, 2)):
        out[a, b, :40] = STOPS[a] - STOPS[b] + 0.1 * rng.normal(size=(40, 3))
    monkeypatch.setattr("posegaussian.stages.inspection.light.surface_stops", lambda inputs, view, numbers: out[view])
    return out


def footage(cameras: int = 4) -> Any:
    return SimpleNamespace(
        rig=range(cameras),
        believed=tuple(range(cameras)),
        names=tuple("abcd"[:cameras]),
        numbers=[np.arange(3)] * cameras,
        inputs=None,
    )


def test_an_inspection_says_what_the_effect_is_decided_by(surface: np.ndarray) -> None:
    found, matching = of_light(footage()), match(surface)
    assert matching is not None
    assert [f.value for f in found[:3]] == [pytest.approx(p) for p in matching.proven[:3]]
    assert [f.verdict for f in found] == [
        FindingVerdict.GOOD,
        FindingVerdict.DOUBTFUL,
        FindingVerdict.GOOD,
        FindingVerdict.UNKNOWN,
    ]
    assert "brighter than the middle camera" in found[1].sentence


def test_few_points_and_one_camera_tell_nothing(surface: np.ndarray) -> None:
    surface[..., 10:, :] = NONE
    assert [f.verdict for f in of_light(footage())] == [FindingVerdict.UNKNOWN]
    assert [f.verdict for f in of_light(footage(1))] == [FindingVerdict.UNKNOWN]


def test_clipped_black_and_glinting_colours_do_not_count() -> None:
    picture = np.full((60, 100, 3), 128, np.uint8)
    picture[:, :20], picture[:, 60:70] = 20, 255
    picture[:, 70:] = 60
    picture[30:32, 84:86] = 230
    found = colors_at(
        picture, np.array([[5.0, 20.0], [40.0, 20.0], [58.0, 20.0], [85.0, 31.0], [95.0, 10.0]]), blur=2.0
    )
    assert (found[[0, 2, 3]] == 0).all()
    np.testing.assert_allclose(found[[1, 4]], [[0.2159] * 3, [0.0452] * 3], atol=1e-3)  # sRGB 128 and 60
