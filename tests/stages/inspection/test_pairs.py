"""Every kind of pair that breaks rectification elsewhere has a name here."""

from __future__ import annotations

import numpy as np
import pytest

from stages.inspection.finding import Verdict
from stages.inspection.pairs import every_pair, of_pairs, rectified
from tests.stages.geometry.scenes import camera, on_ring, rig_of

MIDDLE = np.zeros(3)


def on(*azimuths: float) -> list[np.ndarray]:
    return [camera(on_ring(a), MIDDLE) for a in azimuths]


PAIRS = {
    "22.5": (on(0, 22.5), 819.2, {"ok"}),
    "45": (on(0, 45), 819.2, {"ok"}),
    "60": (on(0, 60), 819.2, {"ok"}),
    "67.5": (on(0, 67.5), 819.2, {"wide", "clipped"}),
    "72": (on(0, 72), 819.2, {"wide", "clipped"}),
    "90": (on(0, 90), 819.2, {"wide", "clipped", "useless"}),
    "120": (on(0, 120), 819.2, {"clipped", "useless"}),
    "150": (on(0, 150), 819.2, {"useless"}),
    "180": (on(0, 180), 819.2, {"useless"}),
    "swapped": (on(22.5, 0), 819.2, {"ok"}),
    "vertical": ([camera(on_ring(0, 0), MIDDLE), camera(on_ring(0, 20), MIDDLE)], 819.2, {"vertical"}),
    "diagonal": ([camera(on_ring(0, 0), MIDDLE), camera(on_ring(20, 20.5), MIDDLE)], 819.2, {"vertical"}),
    "both rolled": ([camera(on_ring(a), MIDDLE, 90) for a in (0, 20)], 819.2, {"vertical", "rolled"}),
    "one rolled": ([camera(on_ring(0), MIDDLE), camera(on_ring(20), MIDDLE, 90)], 819.2, {"rolled"}),
    "behind": ([camera(on_ring(0, 8, r), MIDDLE) for r in (2.0, 3.0)], 819.2, {"one behind the other"}),
    "coincident": (on(0, 0), 819.2, {"coincident"}),
    "a tenth of a millimetre": (on(0, 0.003), 819.2, {"coincident"}),
    "focal ratio 1.5": (on(0, 22.5), [819.2, 1228.8], {"ok", "clipped"}),
}


@pytest.mark.parametrize("name", PAIRS)
def test_every_pair_is_named(name: str) -> None:
    poses, focal, kinds = PAIRS[name]
    pair = rectified(rig_of(poses, focal=focal), 0, 1)
    assert pair.kind in kinds, pair
    assert 0 <= pair.body <= 1
    assert np.isfinite(pair.baseline)


def test_a_pair_that_cannot_be_matched_is_a_note_and_cameras_without_partner_count() -> None:
    rig = rig_of(on(0, 30, 180))
    findings = of_pairs(rig, every_pair(rig))
    assert [f.verdict for f in findings[1:]] == [Verdict.GOOD, Verdict.NOTE, Verdict.NOTE]
    assert findings[0].value == pytest.approx(2 / 3)
    assert findings[0].verdict is Verdict.GOOD
    assert "cam2" in findings[0].sentence
    apart = rig_of(on(0, 120))
    assert of_pairs(apart, every_pair(apart))[0].verdict is Verdict.DOUBTFUL
    assert of_pairs(rig.subset([0]), [])[0].verdict is Verdict.UNKNOWN
