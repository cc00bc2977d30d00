"""Findings on exposure and white balance of every camera,
by the measure that `effects.exposure_matching` is decided by."""

from __future__ import annotations

import numpy as np

from posegaussian.stages.imaging.exposure import FEWEST_POINTS, NONE, match
from posegaussian.stages.inspection.finding import Finding, measured, unmeasured
from posegaussian.stages.inspection.footage import Footage
from posegaussian.stages.survey.algorithms.surface import surface_stops

LIGHT = (0.5, 2.0)
"""Stops: half a stop is visible, but effects.exposure_matching evens it out without loss; two leave 6 of 8 bits."""
ADVICE = (
    "effects.exposure_matching evens it out; better, set exposure and white balance by hand and equal in all cameras"
)
FEW = f"shares {FEWEST_POINTS} well exposed surface points, dark and bright ones"


def of_light(footage: Footage) -> list[Finding]:
    """Exposure and white balance of every believed camera against the others, at surface points that they share: where
    another one sees them, nobody knows."""
    if len(footage.believed) < 2:
        return [unmeasured("exposure", (), "stops", *LIGHT, "one camera has nobody to differ from")]
    surface = np.stack([surface_stops(footage.inputs, v, footage.numbers[v]) for v in range(len(footage.rig))])
    found = match(surface)
    if found is None:
        return [unmeasured("exposure", (), "stops", *LIGHT, f"no camera {FEW} with another")]
    shared = ((surface < NONE).all(axis=-1).sum(axis=-1) >= FEWEST_POINTS) | np.eye(len(surface), dtype=bool)
    out: list[Finding] = []
    for v in footage.believed:
        name = footage.names[v]
        if (shared[v] | shared[:, v]).sum() < 2:
            out.append(unmeasured("exposure", (name,), "stops", *LIGHT, f"it {FEW} with no other camera"))
        else:
            out.append(_light(name, float(found.proven[v]), -np.log2(found.gains[v])))
    return out


def _light(name: str, proven: float, stops: np.ndarray) -> Finding:
    """A camera that is for certain `proven` stops off the middle one, and by `stops` [3] for all that is known."""
    mean = float(stops.mean())
    r, g, b = stops - mean
    told = (
        f"at shared surface points {abs(mean):.2f} stops {'brighter' if mean >= 0 else 'darker'} than the middle"
        f" camera; white balance red {r:+.2f}, green {g:+.2f}, blue {b:+.2f}"
    )
    return measured(
        "exposure",
        (name,),
        proven,
        "stops",
        *LIGHT,
        told if proven > 0 else "no difference at shared surface points is beyond the error of the measure",
        ADVICE,
        at_least=True,
    )
