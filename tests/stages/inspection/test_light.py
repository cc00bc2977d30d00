"""Exposure in an inspection is the survey's measure: the same numbers, in the same words for the same cameras."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from posegaussian.stages.contract.facts import MASKS, Facts
from posegaussian.stages.imaging.exposure import NONE, match
from posegaussian.stages.inspection.finding import Finding, FindingVerdict
from posegaussian.stages.inspection.footage import Footage
from posegaussian.stages.inspection.light import of_clipping, of_light
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
        inputs=SimpleNamespace(facts=Facts()),
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


def clipped(*shares: float, masked: bool = True, believed: tuple[int, ...] = ()) -> list[Finding]:
    """Of cameras whose subject, half of the picture, is clipped in one channel by so much; all else is white."""
    picture, masks = {}, {}
    for v, share in enumerate(shares):
        shown, mask = np.full((20, 40, 3), 255, np.uint8), np.zeros((20, 40), np.uint8)
        mask[:, :20] = 255
        shown[:, :20] = 90
        shown[:, : round(20 * share), v % 3] = 254
        picture[v], masks[v] = shown, np.pad(mask, ((0, 5), (0, 0)))
    made = SimpleNamespace(
        rig=range(len(shares)),
        believed=believed or tuple(range(len(shares))),
        names=tuple("abcde"[: len(shares)]),
        facts=Facts(frozenset({MASKS} if masked else ())),
        looked_at=[0, 7],
        masks=lambda number: masks,
        picture=lambda view, number: picture[view],
    )
    return of_clipping(cast(Footage, made))


def test_a_camera_that_clips_the_subject_where_others_do_not_is_told() -> None:
    """What is white in all cameras alike, or beside the subject, is no fault of one."""
    found = clipped(0.05, 0.05, 0.9, 0.3)
    verdicts = [FindingVerdict.GOOD, FindingVerdict.GOOD, FindingVerdict.BAD, FindingVerdict.DOUBTFUL]
    assert [f.verdict for f in found] == verdicts
    assert found[2].sentence == "90% of the subject is clipped white, 5% in the others"
    assert {f.verdict for f in clipped(0.7, 0.75, 0.7)} == {FindingVerdict.GOOD}
    assert clipped(0.8)[0].verdict is FindingVerdict.BAD


def test_clipping_of_a_camera_that_is_left_out_moves_no_other() -> None:
    assert [f.value for f in clipped(0.0, 0.5, 0.0, believed=(0, 2))] == [0.0, 0.5, 0.0]
    assert [f.value for f in clipped(0.4, 1.0, 0.0, believed=(0, 2))] == [0.4, 0.8, 0.0]


def test_without_masks_or_a_subject_clipping_is_not_measured() -> None:
    (found,) = clipped(0.9, 0.9, masked=False)
    assert found.verdict is FindingVerdict.UNKNOWN
