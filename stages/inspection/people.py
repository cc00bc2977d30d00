"""Whom the pictures show: the pipeline reconstructs one person, and nothing of pictures without anybody."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import inf

import numpy as np

from posegaussian.stages.contract.facts import JOINTS2D, JOINTS3D, MASKS
from posegaussian.stages.contract.io import PictureReader
from posegaussian.stages.estimators.blazepose_files import FETCH
from posegaussian.stages.estimators.interface import Estimator
from posegaussian.stages.estimators.turned import Turned, quarter_turns
from posegaussian.stages.frames.bodies.own_joints import person_size
from posegaussian.stages.geometry.subject import STATURE
from posegaussian.stages.geometry.triangulation import triangulate
from posegaussian.stages.imaging.color import to_display
from posegaussian.stages.inspection.finding import Finding, FindingVerdict, measured, unmeasured
from posegaussian.stages.inspection.footage import LOOSE, Footage
from posegaussian.stages.inspection.joint_fit import FEWEST
from posegaussian.stages.inspection.planned import Planned
from posegaussian.stages.survey.algorithms.joints import RESIDUAL, SCORE, people, seen_joints
from posegaussian.storage.model.cameras import Rig
from posegaussian.storage.model.joint_sets import joint_set

MEASURE = "people"
SEVERAL = (0.05, inf)
"""Share of the pictures that show more than one person: now and then a passer-by is left out by the views'
agreement; never bad, as one is still reconstructed."""
BY_PLACE = (1, inf)
"""People whom cameras place apart, though no picture shows two; never bad, as one is still reconstructed."""
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
SIZE = "stature"
TALL, SMALL = (2.5, inf), (0.5, -inf)
"""Metres that a person is tall, above or below which the unit of the poses is another; never bad, as pictures come out
the same: only what is measured in metres, such as exported splats, does not."""
OTHERS = 2
"""Cameras that show somebody, from which on one that shows nobody is odd."""


class Finder:
    """People in pictures, turned upright where the rig holds a camera rolled, by an estimator."""

    def __init__(self, pictures: PictureReader, estimator: Estimator, rig: Rig) -> None:
        self._pictures, self._estimator, self._rig = pictures, estimator, rig
        self.joint_set = estimator.joint_set
        self._seen: dict[tuple[int, int], np.ndarray] = {}

    def read(self, view: int, number: int) -> np.ndarray:
        """[people, J, 3] (u, v, score) of those it is sure of, captured px; each picture is looked at once, and nobody
        is in a frame the view lacks."""
        if number not in self._pictures.numbers(view):
            return np.zeros((0, len(joint_set(self.joint_set)), 3))
        if (view, number) not in self._seen:
            (picture,) = self._pictures.read(view, [number])
            found = Turned(self._estimator, quarter_turns(self._rig, view)).find(to_display(picture), MOST)
            self._seen[view, number] = np.asarray(found.joints[found.presence >= SURE], dtype=np.float64)
        return self._seen[view, number]


def of_stature(footage: Footage) -> list[Finding]:
    """Whether the subject is as tall as people are, by arms and legs that two cameras show; nothing where no joints
    tell, or joints in space may be of no person."""
    known = [j for j in _in_space(footage) if (j[:, 3] > 0).sum() >= FEWEST]
    if not known:
        return []
    tall = STATURE * float(np.median([person_size(j, "coco17") for j in known]))
    factor = STATURE / tall
    told = f"the person is {tall:.2g} m tall, by arms and legs in {len(known)} frame{'s' * (len(known) > 1)}"
    advice = (
        f"if people are filmed, the poses have another unit: {factor:.3g} times as long, the person is {STATURE:g} m"
        f" tall; import again with --option scale={factor:.3g}, times the scale of this import where it had one, or"
        " with --option distance=CAM_A,CAM_B,METRES"
    )
    return [measured(SIZE, (), tall, "m", *(SMALL if tall < STATURE else TALL), told, advice)]


def _in_space(footage: Footage) -> Iterator[np.ndarray]:
    """[17, 4] joints (x, y, z, score), m, of the subject in each frame in which believed cameras show joints, given
    ones, else those that the estimator finds."""
    if len(footage.believed) < 2 or JOINTS3D in footage.facts:
        return
    if JOINTS2D in footage.facts:
        yield from footage.joints[1]
    elif "found" in footage.readers:
        views, readers = list(footage.believed), {**footage.readers, "joints": footage.source("found")}
        inputs = replace(footage, readers=readers, joint_crops=footage.captured_to_calibrated).joint_inputs
        for number in footage.looked_at:
            yield triangulate(footage.rig.subset(views), seen_joints(inputs, number, LOOSE)[views], SCORE, RESIDUAL)


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


def of_places(planned: Planned, camera: str, count: int, told: str) -> Finding:
    """The finding on people whom cameras place apart, though no picture shows two; `camera` shows the second best."""
    return measured(MEASURE, (), count, "people by place", *BY_PLACE, told, _advice(planned, camera))


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
    asked = {
        "found": (footage.asked_views, footage.looked_at[:1]),
        "joints": (footage.believed, footage.joint_numbers if JOINTS2D in footage.facts else []),
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
    do; none where nothing could look, or where joints in space tell of a subject that is no person. Of given masks,
    which may be of one, only what is amiss."""
    masked = "masks" in footage.tellers
    if not masked and {MASKS, JOINTS3D} & footage.facts:
        return []
    shown = dict(_shown(footage))
    if not any(shown.values()):
        return []
    out = [_somebody(footage, list(shown.values()), masked)]
    if masked and out[0].verdict is FindingVerdict.GOOD:
        out = []
    for v, found in shown.items():
        if found and not _any(found) and sum(map(_any, shown.values())) >= OTHERS:
            out.append(_blind(footage.names[v], len(found), masked))
    return out


def _any(found: Sequence[tuple[int, bool]]) -> bool:
    """Whether one of a camera's pictures shows somebody."""
    return any(there for _, there in found)


def where_looked(footage: Footage) -> list[str]:
    """A sentence where the pictures of the middle are not the ones that were looked at, as they show nobody."""
    if footage.middle in footage.looked_at:
        return []
    nobody = "few masks, if any, hold somebody" if "masks" in footage.tellers else "nobody was found"
    told = f"looked at {_frames(footage, footage.looked_at)}: in the middle, in {_frames(footage, [footage.middle])},"
    return [f"{told} {nobody}; frames.range leaves out frames without anybody"]


def _frames(footage: Footage, numbers: Sequence[int]) -> str:
    """`frames 2, 4 of 0..5`."""
    word = "frame" if len(numbers) == 1 else "frames"
    named = ", ".join(map(str, numbers))
    return f"{word} {named} of {footage.common[0]}..{footage.common[-1]}"


def _somebody(footage: Footage, shown: Sequence[Sequence[tuple[int, bool]]], masked: bool) -> Finding:
    """On all pictures, by what each camera shows: (frame, whether somebody is there)."""
    every = [s for found in shown for _, s in found]
    share, count = float(np.mean(every)), len(every)
    told = f"{sum(every)} of {count} pictures that were looked at show somebody"
    advice = (
        "look at the pictures: wrong frames (frames.range), people too small (detection.zoom), pictures that lie on"
        " their side, or cameras that look elsewhere; of a subject that is no person give masks"
    )
    frames = _frames(footage, sorted({n for found in shown for n, _ in found}))
    if not share:
        told = f"nobody was found in any of the {count} pictures that were looked at, of {frames}"
    if not share and masked:
        told = f"the masks of all {count} pictures that were looked at, of {frames}, hold nobody"
        advice = "look at the masks: wrong frames (frames.range), or masks that hold nothing, without which people are"
        advice += " cut out (frames.matte: person)"
    return measured(SIGHT, (), share, OF_PICTURES, *SHOWN, told, advice)


def _blind(name: str, count: int, masked: bool) -> Finding:
    pictures = "its picture that was" if count == 1 else f"its {count} pictures that were"
    if masked:
        told = f"its masks hold nobody in {pictures} looked at, while those of other cameras do"
        advice = (
            f"does {name} see the subject? If not, leave it out (views.sources); if so, give it masks, or set"
            " frames.matte: person, which cuts the person out of the pictures of all cameras"
        )
    else:
        told = f"nobody was found in {pictures} looked at, while other cameras show somebody"
        advice = (
            f"does {name} see the subject? If not, leave it out (views.sources); if so, people may be too small"
            " (detection.zoom), or cut off"
        )
    return measured(SIGHT, (name,), 0.0, OF_PICTURES, *SHOWN_BY_ONE, told, advice)


def _shown(footage: Footage) -> Iterator[tuple[int, list[tuple[int, bool]]]]:
    """Believed camera, and (frame, whether somebody is there) of each of its pictures that were looked at, by whoever
    looked: masks where there are any, else the estimator where it is here and joints that came with the capture."""
    asked = {"found": footage.looked_at, "joints": footage.joint_numbers if JOINTS2D in footage.facts else []}
    if "masks" in footage.tellers:
        asked = {"masks": footage.looked_at}
    for v in footage.believed:
        seen: dict[int, bool] = {}
        for kind in (k for k in asked if k in footage.readers):
            before = {n for told, view, n in footage.told if (told, view) == (kind, v)}
            for n in sorted({*asked[kind], *before}):
                if n in footage.numbers[v] and not seen.get(n, False):
                    seen[n] = footage.shows(kind, v, n)
        yield v, list(seen.items())
