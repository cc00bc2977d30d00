"""Findings on the light of every camera: exposure and white balance, by the measure that `effects.exposure_matching`
is decided by, and how much of the subject is clipped."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from posegaussian.stages.contract.facts import MASKS
from posegaussian.stages.imaging.exposure import FEWEST_POINTS, NONE, match
from posegaussian.stages.inspection.finding import Finding, measured, unmeasured
from posegaussian.stages.inspection.footage import Footage
from posegaussian.stages.survey.algorithms.sample import of_somebody
from posegaussian.stages.survey.algorithms.surface import surface_stops
from posegaussian.storage.model.masks import foreground

LIGHT = (0.5, 2.0)
"""Stops: half a stop is visible, but effects.exposure_matching evens it out without loss; two leave 6 of 8 bits."""
CLIPPED = (0.1, 0.5)
"""Share of the subject that a camera clips and others do not: colour that is gone, whatever gain evens it out. What is
white in all cameras, such as a coat, is no fault of one."""
WHITE = 254
"""Of 255, from which on a channel counts as clipped: what codecs leave of white."""
ADVICE = (
    "effects.exposure_matching evens it out; better, set exposure and white balance by hand and equal in all cameras"
)
FEW = f"shares {FEWEST_POINTS} well exposed surface points, dark and bright ones"


def of_light(footage: Footage) -> list[Finding]:
    """Exposure and white balance of every believed camera against the others, at surface points that they share: where
    another one sees them, nobody knows."""
    if len(footage.believed) < 2:
        return [unmeasured("exposure", (), "stops", *LIGHT, "one camera has nobody to differ from")]
    compared = [of_somebody(footage.inputs, numbers) for numbers in footage.numbers]
    surface = np.stack([surface_stops(footage.inputs, v, numbers) for v, numbers in enumerate(compared)])
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


def of_clipping(footage: Footage) -> list[Finding]:
    """How much of the subject every camera shows clipped in some channel, beyond the median of the other believed ones,
    in pixels of given masks."""
    if MASKS not in footage.facts:
        why = "the capture has no masks of every camera that say where the subject is"
        return [unmeasured("clipped white", (), "of the subject", *CLIPPED, why)]
    masks = {n: footage.masks(n) for n in footage.looked_at}
    found = [_clipped(footage, v, masks) for v in range(len(footage.rig))]
    out: list[Finding] = []
    for v, (name, share) in enumerate(zip(footage.names, found, strict=True)):
        if share is None:
            why = "its masks hold nothing in the frames that were looked at"
            out.append(unmeasured("clipped white", (name,), "of the subject", *CLIPPED, why))
            continue
        others = [s for o in footage.believed if o != v and (s := found[o]) is not None]
        middle = float(np.median(others)) if others else 0.0
        told = f"{share:.0%} of the subject is clipped white" + f", {middle:.0%} in the others" * bool(others)
        advice = f"expose {name} less: what is clipped has lost its colour; or leave it out with views.sources"
        beyond = max(0.0, share - middle)
        out.append(measured("clipped white", (name,), beyond, "of the subject", *CLIPPED, told, advice))
    return out


def _clipped(footage: Footage, view: int, masks: Mapping[int, Mapping[int, np.ndarray]]) -> float | None:
    """Share of the subject, by masks {frame: {view: mask}}, that a camera shows clipped; None without a subject."""
    subject = [
        picture[foreground(masks[n][view][: picture.shape[0], : picture.shape[1]])]
        for n in masks
        if view in masks[n] and (picture := footage.picture(view, n)) is not None
    ]
    colours = np.concatenate([*subject, np.zeros((0, 3), np.uint8)])
    return float((colours >= WHITE).any(axis=1).mean()) if len(colours) else None


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
