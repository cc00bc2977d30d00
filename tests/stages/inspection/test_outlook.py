"""The outlook says what depth compares and takes for a matte, and its tier follows cameras,
mattes and all that is wrong."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from posegaussian.stages.contract.facts import SEGMENTED
from posegaussian.stages.inspection.finding import Finding, FindingVerdict, measured, overall, unmeasured
from posegaussian.stages.inspection.outlook import RING, TIERS, expected, of_cameras, of_matte, pair_lines, tier
from posegaussian.stages.inspection.pairs import every_pair, of_pairs
from posegaussian.stages.inspection.planned import Planned
from posegaussian.storage.model.cameras import Rig
from tests.support.inspection_plans import planned
from tests.support.known_geometry import camera, on_ring, rig_of

MIDDLE = np.zeros(3)
BAD = measured("mask agreement", ("cam0",), 0.5, "", 0.98, 0.9, "masks contradict each other", "look at them")
DOUBTFUL = measured("epipolar distance", ("cam0",), 2.0, "px", 1, 3, "beside the lines", "calibrate again")


def around(*azimuths: float) -> Rig:
    return rig_of([camera(on_ring(a), MIDDLE) for a in azimuths])


TWO_PAIRS = around(0, 48, 180, 245)


def findings(plan: Planned, *more: Finding) -> list[Finding]:
    return [*of_pairs(plan, every_pair(plan)), of_matte(plan), of_cameras(plan), *more]


@pytest.mark.parametrize(
    ("rig", "matte", "more", "expects"),
    [
        (around(*np.arange(16) * 22.5), "given", (), "sharp"),
        (around(*range(0, 360, 45)), "given", (), "good"),
        (around(*range(0, 360, 45)), "given", (DOUBTFUL,), "fair"),
        (around(*range(0, 360, 45)), "plate", (DOUBTFUL,), "poor"),
        (around(*range(0, 360, 45)), "given", (BAD,), "not fit to be shown"),
        (around(*range(0, 360, 60)), "given", (), "fair"),
        (TWO_PAIRS, "given", (), "fair"),
        (TWO_PAIRS, "plate", (), "poor"),
        (around(0, 10), "given", (), "fair"),
        (around(0, 90, 180, 270), "given", (), "poor"),
        (around(0, 120, 240), "given", (), "not fit to be shown"),
    ],
)
def test_the_tier_is_that_of_cameras_mattes_and_faults(
    rig: Rig, matte: str, more: tuple[Finding, ...], expects: str
) -> None:
    plan = planned(rig, matte=matte)
    found = findings(plan, *more)
    assert tier(plan, found) == expects
    assert overall(found) is not FindingVerdict.GOOD or expects in TIERS[:2], (
        "a capture that is called good comes out good"
    )
    assert f"expected: {expects}" in expected(plan, found)


def test_the_figures_are_those_that_were_measured_for_such_a_geometry() -> None:
    for angle, psnr, _ in RING[1:]:
        plan = planned(rig_of([camera(on_ring(a, 0), MIDDLE) for a in np.arange(0, 359, angle)]))
        assert f"reach {psnr:.1f} dB" in expected(plan, findings(plan))
    assert all(a[1] > b[1] for a, b in pairwise(RING))
    assert len(set(TIERS)) == 5


def test_every_matched_pair_is_named_and_every_refused_one_has_its_reason() -> None:
    told = "\n".join(pair_lines(planned(TWO_PAIRS)))
    assert "run matches 2 of 6 pairs (sgbm): cam0 and cam1 (48 degrees apart), cam2 and cam3 (64 degrees apart)" in told
    assert "run refuses 4 pairs, too wide" in told
    rolled = rig_of([camera(on_ring(a), MIDDLE, 90.0 * (a == 87)) for a in (0, 30, 60, 87)])
    told = "\n".join(pair_lines(planned(rolled)))
    assert "run matches 5 of 6 pairs (sgbm): cam2 and cam3 (27 degrees apart)" in told
    assert "leaves" in "\n".join(pair_lines(planned(around(0, 15, 30, 45), pairs=1)))


@pytest.mark.parametrize(
    ("matte", "facts", "verdict"),
    [
        ("given", set(), FindingVerdict.NOTE),
        ("person", {SEGMENTED}, FindingVerdict.GOOD),
        ("person", set(), FindingVerdict.DOUBTFUL),
        ("plate", set(), FindingVerdict.DOUBTFUL),
        ("none", set(), FindingVerdict.BAD),
    ],
)
def test_a_matte_is_judged_by_what_it_reached_elsewhere(matte: str, facts: set[str], verdict: FindingVerdict) -> None:
    found = of_matte(planned(TWO_PAIRS, matte=matte, facts=frozenset({"joints2d", *facts})))
    assert found.verdict is verdict
    assert f"frames.matte: {matte}" in found.sentence
    if matte in ("plate", "none"):
        assert "set frames.matte: person" in found.advice
        assert "models fetch blazepose" in of_matte(planned(TWO_PAIRS, matte=matte, facts=frozenset())).advice


def test_a_second_person_lowers_nothing_where_one_is_cut_out() -> None:
    crowd = measured("people", (), 0.5, "", 0.05, 1, "two in every picture", "say whom")
    ring = around(*range(0, 360, 45))
    assert tier(planned(ring), findings(planned(ring), crowd)) == "good"
    assert tier(planned(ring, matte="plate"), findings(planned(ring, matte="plate"), crowd)) == "poor"


def test_the_tier_says_where_nobody_knows_whether_cameras_are_in_step() -> None:
    plan, said = planned(around(*range(0, 360, 45)), matte="given"), "in step was not measured"
    unknown = unmeasured("time offset", (), "frames", 0.25, 0.75, "the capture has no 2D joints")
    known = measured("time offset", ("cam0",), 0.0, "frames", 0.25, 0.75, "in step", "")
    assert said in expected(plan, findings(plan, unknown))
    assert said not in expected(plan, findings(plan, unknown, known))
    assert said not in expected(plan, findings(plan))
