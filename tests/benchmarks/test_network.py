"""The gates of the network's benchmark say what they are asked to."""

from __future__ import annotations

import numpy as np

from benchmarks.network.gain import GATES, gates
from benchmarks.network.picture import nearer


def _rows(gains: list[float], epe: float = 0.8) -> list[dict[str, object]]:
    """Scenes of a floor of 28 dB and 2 px, 3 dB below true depth."""
    kinds = [
        (n, kind, psnr, off)
        for n, g in enumerate(gains)
        for kind, psnr, off in (("floor", 28.0, 2.0), ("network", 28.0 + g, 2.0 * epe), ("truth", 31.0, 0.0))
    ]
    return [{"seed": n, "depth": kind, "box psnr": psnr, "EPE": off} for n, kind, psnr, off in kinds]


def _held(gains: list[float], epe: float = 0.8, by_iterations: dict[int, float] | None = None) -> list[bool]:
    return [
        holds
        for _, holds in gates(_rows(gains, epe), by_iterations or {1: 1.7, 2: 1.65, 3: 1.6, 4: 1.6}, GATES["fast"], 4)
    ]


def test_all_hold_of_what_gains_enough() -> None:
    assert all(_held([0.6, 0.7, 0.8]))


def test_each_gate_fails_alone() -> None:
    assert _held([0.55, 0.56, 0.57])[0] is False
    assert _held([0.7, 0.7, 0.71], epe=0.86)[1] is False
    assert _held([1.4, 1.5, -0.11])[2] is False
    assert _held([0.0, 3.0, 0.1])[3] is False
    assert _held([0.7, 0.8, 0.7], by_iterations={1: 1.6, 2: 1.7, 3: 1.6, 4: 1.6})[4:] == [False, True, True]


def test_beyond_the_trained_iterations_nothing_is_asked() -> None:
    assert len(_held([0.6, 0.7], by_iterations={4: 1.0, 5: 9.0})) == 4


def test_the_share_of_the_way_counts_where_it_is_more() -> None:
    rows = [{**r, "box psnr": 36.0} if r["depth"] == "truth" else r for r in _rows([0.8, 0.9])]
    sentence, holds = next(gates(rows, {4: 1.0}, GATES["fast"], 4))
    assert not holds
    assert "+0.96" in sentence


def test_green_is_nearer_and_red_farther() -> None:
    shown = nearer(np.array([[40.0, 0.0, 5.0]]), np.array([[0.0, 40.0, 5.0]]))[0]
    assert shown[0, 1] > 200
    assert shown[0, 0] == 0
    assert shown[1, 0] > 200
    assert shown[1, 1] == 0
    assert not shown[2].any()
