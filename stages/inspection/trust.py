"""Which cameras a run will believe, by its own measure and decision."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from posegaussian.stages.contract.facts import ESTIMATED, JOINTS2D
from posegaussian.stages.contract.io import Inputs, Views
from posegaussian.stages.contract.trust import Belief, CameraVerdict, judged_cameras
from posegaussian.stages.imaging.camera_mapping import frames_rig, undistorted
from posegaussian.stages.inspection.finding import Finding, FindingVerdict, unmeasured
from posegaussian.stages.inspection.footage import Footage, inputs_of, shared_numbers
from posegaussian.stages.inspection.planned import Planned
from posegaussian.stages.survey.algorithms.agreement import agreement_of_view
from posegaussian.stages.survey.algorithms.links import in_common
from posegaussian.stages.survey.algorithms.sample import look, of_somebody, sample_numbers
from posegaussian.stages.survey.measures.agreement import NAME as AGREEMENT
from posegaussian.stages.survey.measures.contrast import CONTRAST, ContrastLook
from posegaussian.stages.survey.measures.declaration import Sampled
from posegaussian.stages.survey.measures.standing import STANDING
from posegaussian.stages.survey.params import LONGEST, SurveyParams
from posegaussian.stages.survey.run import FEW
from posegaussian.stages.survey.standing.standing import AsTheyStand, standing_in
from posegaussian.stages.survey.standing.standing import told as standing_told
from posegaussian.stages.survey.trust import TRUST

MEASURE = "agreement"


ADVICE = (
    "calibrate it again, or check that its pictures, masks and timing are of this recording; until then a run leaves it"
    " out by itself (views.trust: all believes every camera)"
)


ADVICE_IN_PLACE = (
    "look at its masks, which may lack what those of the others hold, and check that it was in step; until then a run"
    " leaves it out by itself (where its masks are at fault, views.trust with its name keeps its pictures)"
)


ADVICE_LACKING = (
    "complete its masks, or make those of all anew (frames.matte: person); until then the others overrule them"
)


ADVICE_BLANK = (
    "look at its pictures: a cap on the lens, a lamp in it, a recording that failed; until then a run leaves it out by"
    " itself (views.trust: all believes every camera)"
)


ADVICE_MOVED = (
    "work on the frames before and after apart (frames.range), each with a calibration of its own; until then a run"
    " leaves it out by itself (views.trust: all believes every camera)"
)


ADVICE_LATE = (
    "bring it into step, see frames.time_offset, or trigger the cameras together; until then a run leaves it out by"
    " itself (views.trust: all believes every camera)"
)


ADVICE_TURNED = (
    "calibrate it again, or check that it was not moved; until then a run turns it by itself (views.trust: all leaves"
    " every camera as it is written down)"
)


def of_trust(verdicts: Mapping[str, CameraVerdict]) -> list[Finding]:
    """Of every camera that may be a source: how far what it shows lies from what the others show."""
    return [_of_camera(v) for v in verdicts.values()]


def camera_verdicts(footage: Footage, planned: Planned) -> dict[str, CameraVerdict]:
    """Whom a run will believe of all cameras that may be sources, by name."""
    sources = list(planned.source_places)
    names = tuple(footage.names[v] for v in sources)
    if len(sources) < TRUST.fewest:
        return judged_cameras(TRUST, names, planned.trust, {})
    source_rig, crops = footage.source_rig, footage.captured_to_calibrated
    scope = replace(
        footage.scope,
        rig=undistorted(frames_rig(source_rig, LONGEST), source_rig, footage.captured, crops),
        facts=(footage.facts - {JOINTS2D}) | (planned.facts & {JOINTS2D, ESTIMATED}),
        views=Views(footage.names, tuple(sources), ()),
    )
    inputs = inputs_of(scope, footage)
    numbers = of_somebody(inputs, sample_numbers(shared_numbers(footage.numbers, sources), planned.sample))
    stand = AsTheyStand(inputs, standing_in(inputs, numbers))
    told = [agreement_of_view(stand, v, numbers, in_common(stand, v, numbers)) for v in sources]
    pairs, standing = np.stack([of_view[sources] for of_view in told]), standing_told(stand.standing, stand)[sources]
    contrast = np.array([_contrast(footage, inputs, v, planned.sample) for v in sources])
    return judged_cameras(TRUST, names, planned.trust, {AGREEMENT: pairs, STANDING: standing, CONTRAST: contrast})


def _contrast(footage: Footage, inputs: Inputs, view: int, sample: int) -> float:
    """As the survey has it, of the same frames."""
    numbers = footage.numbers[view]
    chosen = sample_numbers(numbers, sample)
    sampled = Sampled(inputs, SurveyParams(sample=sample), view, numbers, chosen, sample_numbers(chosen, FEW))
    (block,) = look(inputs, view, [ContrastLook(sampled)])
    return float(block.data)


def _of_camera(verdict: CameraVerdict) -> Finding:
    belief, names = verdict.belief, (verdict.camera,)
    assert belief is not None, f"camera {verdict.camera} was compared"
    if belief.measured is None and not belief.believed:
        sentence, none = belief.reason, (TRUST.unit, TRUST.bound, TRUST.bound)
        return Finding(MEASURE, names, None, *none, sentence, ADVICE_BLANK, FindingVerdict.LEFT_OUT)
    if belief.measured is None:
        return unmeasured(MEASURE, names, TRUST.unit, TRUST.bound, TRUST.bound, belief.reason)
    told, advice, found = belief.reason, "", FindingVerdict.GOOD
    if verdict.state == "left out":
        advice = _advice(belief)
        found = FindingVerdict.LEFT_OUT
    elif belief.in_place:
        advice, found = ADVICE_LACKING, FindingVerdict.DOUBTFUL
    elif verdict.turn.any():
        advice, found = ADVICE_TURNED, FindingVerdict.DOUBTFUL
        told = f"it stands turned by {np.degrees(np.linalg.norm(verdict.turn)):.2f} degrees: {told}"
    return Finding(MEASURE, names, belief.measured, TRUST.unit, TRUST.bound, TRUST.bound, told, advice, found)


def _advice(belief: Belief) -> str:
    """What to do about a camera that is left out."""
    if belief.moved:
        return ADVICE_MOVED
    if belief.late:
        return ADVICE_LATE
    return ADVICE_IN_PLACE if belief.in_place else ADVICE
