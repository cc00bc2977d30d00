"""Every kind of pair that breaks rectification elsewhere has a name here, and what is predicted is what depth does."""

from __future__ import annotations

import numpy as np
import pytest

from posegaussian.stages.depth.algorithms.scene import Geometry
from posegaussian.stages.depth.methods.registry import METHODS
from posegaussian.stages.inspection.finding import Finding, FindingVerdict
from posegaussian.stages.inspection.pairs import every_pair, of_pairs
from posegaussian.stages.inspection.planned import Planned
from tests.support.inspection_plans import planned
from tests.support.known_geometry import camera, on_ring, rig_of

MIDDLE = np.zeros(3)


def on(*azimuths: float) -> list[np.ndarray]:
    return [camera(on_ring(a), MIDDLE) for a in azimuths]


PAIRS = {
    "22.5": (on(0, 22.5), 819.2, {"ok"}),
    "45": (on(0, 45), 819.2, {"ok"}),
    "60": (on(0, 60), 819.2, {"ok"}),
    "67.5": (on(0, 67.5), 819.2, {"ok"}),
    "72": (on(0, 72), 819.2, {"ok"}),
    "90": (on(0, 90), 819.2, {"ok"}),
    "120": (on(0, 120), 819.2, {"too wide"}),
    "150": (on(0, 150), 819.2, {"too wide"}),
    "180": (on(0, 180), 819.2, {"too wide"}),
    "swapped": (on(22.5, 0), 819.2, {"ok"}),
    "vertical": ([camera(on_ring(0, 0), MIDDLE), camera(on_ring(0, 20), MIDDLE)], 819.2, {"ok"}),
    "diagonal": ([camera(on_ring(0, 0), MIDDLE), camera(on_ring(20, 20.5), MIDDLE)], 819.2, {"ok"}),
    "both rolled": ([camera(on_ring(a), MIDDLE, 90) for a in (0, 20)], 819.2, {"ok"}),
    "one rolled": ([camera(on_ring(0), MIDDLE), camera(on_ring(20), MIDDLE, 90)], 819.2, {"ok"}),
    "behind": ([camera(on_ring(0, 8, r), MIDDLE) for r in (2.0, 3.0)], 819.2, {"one behind the other"}),
    "coincident": (on(0, 0), 819.2, {"coincident"}),
    "a tenth of a millimetre": (on(0, 0.003), 819.2, {"coincident"}),
    "focal ratio 1.5": (on(0, 22.5), [819.2, 1228.8], {"ok"}),
}
RIGS = {
    "two pairs": rig_of(on(0, 48, 180, 245)),
    "eight around": rig_of(on(*range(0, 360, 45))),
    "one is rolled": rig_of([*on(0, 30, 60), camera(on_ring(87), MIDDLE, 90)]),
    "far apart": rig_of(on(0, 120, 240)),
    "vertical": rig_of([camera(on_ring(0, e), MIDDLE) for e in (0, 25)]),
}


def of(found: list[Finding], measure: str) -> Finding:
    return next(f for f in found if f.measure == measure)


def findings(plan: Planned) -> list[Finding]:
    return of_pairs(plan, every_pair(plan))


@pytest.mark.parametrize("name", PAIRS)
def test_every_pair_is_named(name: str) -> None:
    poses, focal, kinds = PAIRS[name]
    (pair,) = every_pair(planned(rig_of(poses, focal=focal)))
    assert pair.kind in kinds, pair
    assert pair.fate == ("matched" if pair.kind == "ok" else "refused")
    assert 0 <= pair.body <= 1
    assert np.isfinite(pair.baseline)


@pytest.mark.parametrize("method", ["sgbm", "sweep"])
@pytest.mark.parametrize("name", RIGS)
def test_the_pairs_that_are_predicted_are_those_that_depth_compares(name: str, method: str) -> None:
    rig, views = RIGS[name], tuple(range(len(RIGS[name])))
    plan = planned(rig, method=method)
    geometry = Geometry.of(rig, views, plan.depth)
    pairs = (
        geometry.pairs
        if METHODS[method].rectifies
        else ((v, w) for v, n in geometry.neighbours.items() for w in n.views)
    )
    compared = {(min(p), max(p)) for p in pairs}
    assert plan.matched == compared
    assert {p.views for p in every_pair(plan) if p.fate == "matched"} == compared


def test_of_two_pairs_that_face_each_other_four_are_refused_and_it_is_not_good() -> None:
    """Every camera has a partner, but the worst is 65 degrees away: it was called good."""
    plan = planned(RIGS["two pairs"])
    found = findings(plan)
    assert len(plan.refused) == 4
    assert of(found, "partners").verdict is FindingVerdict.GOOD
    worst = of(found, "neighbours")
    assert worst.verdict is FindingVerdict.DOUBTFUL
    assert worst.value == pytest.approx(64.6, abs=1)
    assert "cam0 - cam1" in worst.sentence


def test_a_rolled_camera_is_a_partner_like_any_other() -> None:
    plan = planned(RIGS["one is rolled"])
    found = findings(plan)
    assert of(found, "partners").verdict is FindingVerdict.GOOD
    assert (2, 3) in plan.matched
    (note,) = (f for f in found if f.cameras == ("cam2", "cam3"))
    assert note.number == "26.7 degrees"
    assert note.verdict is FindingVerdict.GOOD
    assert "rolled" not in note.sentence
    assert "of a person is in both pictures" in note.sentence


def test_cameras_without_partner_count_and_a_pair_that_is_refused_is_a_note() -> None:
    plan = planned(rig_of(on(0, 30, 180)))
    found = findings(plan)
    assert of(found, "partners").value == pytest.approx(2 / 3)
    assert of(found, "partners").verdict is FindingVerdict.DOUBTFUL
    assert "cam2" in of(found, "partners").sentence
    assert [f.verdict for f in found if f.measure == "rectification"] == [
        FindingVerdict.GOOD,
        FindingVerdict.NOTE,
        FindingVerdict.NOTE,
    ]
    half = planned(rig_of(on(0, 20, 130, 250)))
    assert of(findings(half), "partners").verdict is FindingVerdict.BAD
    apart = findings(planned(RIGS["far apart"]))
    assert {of(apart, "partners").verdict, of(apart, "neighbours").verdict} == {FindingVerdict.BAD}
    assert "no two source cameras can be matched" in of(apart, "neighbours").sentence


def test_a_good_ring_is_good_and_only_sources_count() -> None:
    ring = RIGS["eight around"]
    assert {f.verdict for f in findings(planned(ring)) if f.measure in ("partners", "neighbours")} == {
        FindingVerdict.GOOD
    }
    some = planned(ring, sources=(0, 1, 4))
    assert of(findings(some), "partners").value == pytest.approx(2 / 3)
    assert {p.fate for p in every_pair(some) if not {0, 1, 4} >= set(p.views)} == {"not asked for"}


def test_without_pictures_to_compare_nothing_is_measured() -> None:
    for plan in (planned(RIGS["eight around"], method="hull"), planned(rig_of(on(0)), method="relief")):
        assert {f.verdict for f in findings(plan)[:2]} == {FindingVerdict.UNKNOWN}
