"""Whom the pictures show: the pipeline reconstructs one person, and nothing of pictures without anybody."""

from __future__ import annotations

from collections.abc import Iterator
from math import inf
from typing import Any

import numpy as np

from posegaussian.stages.contract.facts import JOINTS2D, JOINTS3D, MASKS
from posegaussian.stages.contract.io import PictureReader
from posegaussian.stages.estimators.blazepose_files import FETCH
from posegaussian.stages.estimators.interface import Estimator
from posegaussian.stages.estimators.turned import Turned, quarter_turns
from posegaussian.stages.imaging.color import to_display
from posegaussian.stages.inspection.finding import Finding, measured, unmeasured
from posegaussian.stages.inspection.footage import Footage
from posegaussian.stages.inspection.planned import Planned
from posegaussian.stages.survey.algorithms.joints import SCORE
from posegaussian.storage.model.cameras import Rig

MEASURE = "people"
SEVERAL = (0.05, inf)
"""Share of the pictures that show more than one person: now and then a passer-by is left out by the views'
agreement; never bad, as one is still reconstructed."""
FEWEST = 5
"""Joints above the survey's least score that make a person; a chair has fewer."""
LEAST = 0.2
"""Extent over that of the picture's largest person: a figure on a poster or far behind is none that could be taken
for the subject."""
SURE = 0.6
"""How sure the estimator must be of a person: of furniture and of a person found twice it was at most 0.51, of an
onlooker at least 0.69."""
MOST = 6
"""People looked for in a picture."""
SIGHT = "somebody in sight"
OF_PICTURES = "of the pictures"
SHOWN = (0.02, 0.01)
"""Share of the pictures that show somebody: one of them is enough, as the subject may walk in and out."""
SHOWN_BY_ONE = (SHOWN[0], -inf)
"""The same of one camera; never bad, as others show the subject."""
OTHERS = 2
"""Cameras that show somebody, from which on one that shows nobody is odd."""
PICTURES = 8
"""Pictures in which the estimator looks for people far smaller than the subject, which takes seconds each;
one a camera."""


class Finder:
    """People in pictures, turned upright where the rig holds a camera rolled, by an estimator."""

    def __init__(self, pictures: PictureReader, estimator: Estimator, rig: Rig) -> None:
        self._pictures, self._estimator, self._rig = pictures, estimator, rig
        self.joint_set = estimator.joint_set
        self._seen: dict[tuple[int, int], np.ndarray] = {}

    def read(self, view: int, number: int) -> np.ndarray:
        """[people, J, 3] (u, v, score) of those it is sure of, captured px; each picture is looked at once."""
        if (view, number) not in self._seen:
            (picture,) = self._pictures.read(view, [number])
            found = Turned(self._estimator, quarter_turns(self._rig, view)).find(to_display(picture), MOST)
            self._seen[view, number] = np.asarray(found.joints[found.presence >= SURE], dtype=np.float64)
        return self._seen[view, number]


def of_people(footage: Footage, planned: Planned) -> list[Finding]:
    """One finding on the most people a picture shows, by the estimator where it is here, by the joints that came
    with the capture."""
    unit, counted = "of the pictures with more than one", _counted(footage)
    if not counted:
        return [
            unmeasured(
                MEASURE,
                (),
                unit,
                *SEVERAL,
                f"no joints came with the capture and no estimator is here to look: `{FETCH}`",
                f"`{FETCH}`",
            )
        ]
    several = {v: max(found) for v, found in counted.items() if max(found, default=0) > 1}
    if not several and "found" not in footage.readers:
        return [
            unmeasured(
                MEASURE,
                (),
                unit,
                *SEVERAL,
                "the capture's joints name at most one person a picture; whether the pictures show others, only an"
                f" estimator tells: `{FETCH}`",
            )
        ]
    share = _crowded(counted)
    told = "one person at most in every picture that was looked at"
    if not any(max(found, default=0) for found in counted.values()):
        told = "nobody in the pictures in which people were counted"
    if several:
        seen = ", ".join(f"{footage.names[v]} up to {n}" for v, n in several.items())
        told = (
            f"more than one person in {share:.0%} of the pictures that were looked at ({seen}); one is reconstructed:"
            " who is in most pictures and largest in them, or whom pose.subject names"
        )
    return [measured(MEASURE, (), share, unit, *SEVERAL, told, _advice(planned, footage.names[next(iter(several), 0)]))]


def _advice(planned: Planned, name: str) -> str:
    """What keeps the others out, given what the run takes for masks and joints."""
    matte, estimator = planned.matte[0], planned.estimator[0]
    choose = (
        "if it should be another person, say who: pose.subject: person2, or where:"
        f" detection.box: {{{name}: [left, top, right, bottom]}}, px of the captured picture"
    )
    if estimator not in ("blazepose", "onnx"):
        choose += ", with detection.estimator: blazepose, as given joints are taken as they are"
    held = {
        "given": "the given masks must hold one person alone: look at the outlines",
        "person": "frames.matte: person cuts out one; who touches or hides the subject leaves edges",
        "plate": "a background plate keeps everybody who moves: set frames.matte: person, which needs joints",
        "none": "everything is foreground: set frames.matte: person, which needs joints",
    }
    return f"{held[matte]}; {choose}"


def _counted(footage: Footage) -> dict[int, list[int]]:
    """People a picture by believed camera: as the estimator finds them in one frame, or as the given joints name them,
    whichever are more."""
    every = footage.believed
    some = sorted({every[int(i)] for i in np.rint(np.linspace(0, len(every) - 1, min(len(every), PICTURES)))})
    asked = {
        "found": (some, footage.looked_at[:1]),
        "joints": (every, footage.joint_numbers if JOINTS2D in footage.facts else []),
    }
    ways = []
    for kind, (views, numbers) in asked.items():
        if kind in footage.readers and numbers:
            ways.append(
                {
                    v: [people(footage.source(kind).read(v, n)) for n in numbers if n in footage.numbers[v]]
                    for v in views
                }
            )
    return max(ways, key=_crowded, default={})


def _crowded(counted: dict[int, list[int]]) -> float:
    """Share of the pictures with more than one person."""
    return float(np.mean([n > 1 for found in counted.values() for n in found] or [False]))


def of_sight(footage: Footage) -> list[Finding]:
    """One finding on all pictures that were looked at, and one on each believed camera that shows nobody while others
    do; none where nothing could look, or where masks or joints in space tell of a subject that is no person."""
    if {MASKS, JOINTS3D} & footage.facts:
        return []
    shown = dict(_shown(footage))
    if not any(shown.values()):
        return []
    every = [s for found in shown.values() for s in found]
    share, count = float(np.mean(every)), len(every)
    told = f"{sum(every)} of {count} pictures that were looked at show somebody"
    advice = (
        "look at the pictures: wrong frames (frames.range), people too small (detection.zoom), pictures that lie on"
        " their side, or cameras that look elsewhere; of a subject that is no person give masks"
    )
    if not share:
        told = f"nobody was found in any of the {count} pictures that were looked at"
    out = [measured(SIGHT, (), share, OF_PICTURES, *SHOWN, told, advice)]
    for v, found in shown.items():
        if found and not any(found) and sum(any(o) for o in shown.values()) >= OTHERS:
            out.append(_blind(footage.names[v], len(found)))
    return out


def _blind(name: str, count: int) -> Finding:
    told = f"nobody was found in its {count} pictures that were looked at, while other cameras show somebody"
    advice = (
        f"does {name} see the subject? If not, leave it out (views.sources); if so, people may be too small"
        " (detection.zoom), or cut off"
    )
    return measured(SIGHT, (name,), 0.0, OF_PICTURES, *SHOWN_BY_ONE, told, advice)


def _shown(footage: Footage) -> Iterator[tuple[int, list[bool]]]:
    """Believed camera, and whether somebody is in each of its pictures that were looked at, by whoever looked: the
    estimator where it is here, the joints that came with the capture."""
    asked = {
        "found": footage.looked_at,
        "joints": footage.joint_numbers if JOINTS2D in footage.facts else [],
    }
    asked = {kind: numbers for kind, numbers in asked.items() if kind in footage.readers}
    for v in footage.believed:
        seen: dict[int, bool] = {}
        for kind, numbers in asked.items():
            for n in numbers:
                if n in footage.numbers[v] and not seen.get(n, False):
                    seen[n] = people(footage.source(kind).read(v, n)) > 0
        yield v, list(seen.values())


def people(joints: Any) -> int:
    """How many of joints [people, J, 3] (u, v, score) are people: `FEWEST` joints are seen, and they are not tiny
    beside the largest."""
    extents = []
    for person in np.asarray(joints, dtype=np.float64).reshape(-1, *np.shape(joints)[1:]):
        seen = person[(person[:, 2] >= SCORE) & np.isfinite(person).all(axis=1)]
        extents.append(float(np.linalg.norm(np.ptp(seen[:, :2], axis=0))) if len(seen) >= FEWEST else 0.0)
    return int(np.sum(np.array(extents) > LEAST * max(extents))) if extents and max(extents) > 0 else 0
