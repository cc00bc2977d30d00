"""What `network.weights: auto` and `network.precision: auto` come to."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from posegaussian.stages.contract.facts import REFINING, Facts
from posegaussian.stages.contract.judged import GIVEN_MATTE, LEARNED, NONE
from posegaussian.stages.network import precision
from posegaussian.stages.network.choice import CANDIDATES, PICKED, best_of, fitting_weights, pick, settled
from posegaussian.stages.network.params import NetworkParams
from posegaussian.stages.simulator.subjects.capsule_person import capture_person

FAST = CANDIDATES.index("fast")


def evidence(views: int, scores: np.ndarray | None = None, *facts: str) -> Any:
    """Of so many cameras around a person; `scores` [picture, candidate, measure] of left-out views."""
    rig = capture_person(views=views, size=16, frames=1, held_out=0).rig
    noted = {} if scores is None else {LEARNED: scores}
    return SimpleNamespace(
        rig=rig, sources=tuple(range(views)), facts=Facts(frozenset(facts)), noted=noted, params=NetworkParams()
    )


def drawn(gain: float, ssim: float = 0.0) -> np.ndarray:
    """Two pictures and one that was not drawn, with so much more by the weights than by none."""
    out = np.full((3, len(CANDIDATES), 3), NONE)
    out[:2] = [20.0, 0.8, 0.9]
    out[:2, FAST, :2] += [gain, ssim]
    return out


@pytest.mark.parametrize(
    ("gain", "ssim", "picked"),
    [(1.0, 0.01, "fast"), (0.5, -0.01, "none"), (-0.7, 0.02, "fast"), (0.0, 0.0, "fast")],
)
def test_weights_count_unless_left_out_views_look_less_alike_with_them(gain: float, ssim: float, picked: str) -> None:
    found = pick(evidence(8, drawn(gain, ssim), GIVEN_MATTE))
    assert found is not None
    assert found.fact == PICKED[picked]
    assert f"fast {20 + gain:.2f} dB" in found.reason
    assert "none 20.00 dB" in found.reason


def test_more_likeness_never_turns_weights_off() -> None:
    gains = np.linspace(-0.1, 0.1, 41)
    chosen = [best_of(drawn(0.0, g)[:2].mean(axis=0), ["fast"]) for g in gains]
    assert chosen == sorted(chosen)
    assert {0, FAST} == set(chosen)


def test_it_waits_for_the_judge_where_the_judge_can_tell() -> None:
    assert pick(evidence(8, None, GIVEN_MATTE)) is None


@pytest.mark.parametrize("scores", [None, drawn(-3.0, -0.2), drawn(3.0, 0.2)])
def test_where_refinement_follows_the_angle_decides_and_left_out_views_are_not_asked(scores: np.ndarray | None) -> None:
    for views, fits in ((8, "fast"), (4, "wide"), (3, "none")):
        found, alone = pick(evidence(views, scores, GIVEN_MATTE, REFINING)), pick(evidence(views, None, REFINING))
        assert found is not None
        assert alone is not None
        assert found.fact == alone.fact == PICKED[fits]
        assert found.reason == alone.reason


def test_where_nothing_can_be_judged_the_angle_decides() -> None:
    close, wide = pick(evidence(8)), pick(evidence(4))
    assert close is not None
    assert wide is not None
    assert close.fact == PICKED["fast"]
    assert "within 45 degrees of another, and fast was trained on pairs of up to 62" in close.reason
    assert wide.fact == PICKED["wide"]
    assert "within 90 degrees of another, and wide was trained on pairs of up to 92" in wide.reason
    apart = pick(evidence(3))
    assert apart is not None
    assert apart.fact == PICKED["none"]
    assert "degrees apart, beyond the 92" in apart.reason
    empty = pick(evidence(8, np.full((3, len(CANDIDATES), 3), NONE), GIVEN_MATTE))
    assert empty is not None
    assert empty.fact == PICKED["fast"]


@pytest.mark.parametrize(("views", "fits"), [(12, ["fast"]), (6, ["fast"]), (5, ["wide"]), (4, ["wide"]), (3, [])])
def test_of_weights_trained_as_wide_as_cameras_stand_those_trained_the_least_wide_fit(
    views: int, fits: list[str]
) -> None:
    found, why = fitting_weights(evidence(views).rig, range(views))
    assert found == fits
    assert ("beyond" in why) == (not fits)


def test_the_view_in_the_middle_says_how_wide_cameras_stand() -> None:
    """Of a ring of eight every second one stands 90 degrees from the next; with one more three have one at 45."""
    rig = evidence(8).rig
    assert fitting_weights(rig, [0, 2, 4, 6])[0] == ["wide"]
    assert fitting_weights(rig, [0, 1, 2, 4, 6])[0] == ["fast"]
    # as many at 45 degrees as at 90: 67.5 in the middle
    assert fitting_weights(rig, [0, 1, 3, 5])[0] == ["wide"]


def test_a_single_view_has_no_pair() -> None:
    found = pick(evidence(1, None, GIVEN_MATTE))
    assert found is not None
    assert found.fact == PICKED["none"]


def test_a_named_answer_stands_and_auto_is_resolved_by_the_fact() -> None:
    assert settled(NetworkParams(weights="mine.safetensors"), Facts(frozenset({PICKED["fast"]}))).weights != "fast"
    for name, fact in PICKED.items():
        assert settled(NetworkParams(), Facts(frozenset({fact}))).weights == name


@pytest.mark.parametrize(
    ("processor", "features", "wanted"),
    [
        ("znver4", {"avx512bf16": True}, "bf16"),
        ("sapphirerapids", {"avx512bf16": True, "amx-bf16": True}, "bf16"),
        ("sapphirerapids", {"avx512bf16": True, "amx-bf16": False}, "float32"),
        ("neoverse-v1", {"bf16": True}, "bf16"),
        ("znver2", {"avx2": True, "avx512bf16": False}, "float32"),
    ],
)
def test_precision_follows_the_processor(
    monkeypatch: pytest.MonkeyPatch, processor: str, features: dict[str, bool], wanted: precision.Precision
) -> None:
    import llvmlite.binding

    monkeypatch.setattr(llvmlite.binding, "get_host_cpu_features", lambda: features)
    monkeypatch.setattr(llvmlite.binding, "get_host_cpu_name", lambda: processor)
    precision.faster_in_bf16.cache_clear()
    assert precision.PRECISION.pick is not None
    found = precision.PRECISION.pick(evidence(8))
    precision.faster_in_bf16.cache_clear()
    assert found is not None
    assert precision.precision_of(NetworkParams(), Facts(frozenset({found.fact})))[0] == wanted
    other: precision.Precision = "float32" if wanted == "bf16" else "bf16"
    named = NetworkParams(precision=other)
    assert precision.precision_of(named, Facts(frozenset({found.fact})))[0] == other, "what is named stands"
