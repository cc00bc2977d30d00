"""What a run does with a body whose limbs are known, told for the judge's few frames.

Whether limbs bound the search and close gaps hangs on the method that is chosen here, so that it cannot be among the
facts of the judge's task: it is asked by the same functions that decide it in a run, for each method anew.
"""

from __future__ import annotations

import numpy as np

from posegaussian.stages.contract.facts import JOINTS2D, SEGMENTED, Facts
from posegaussian.stages.contract.io import Inputs
from posegaussian.stages.contract.judged import PERSON_MATTE
from posegaussian.stages.depth.effects import LIMB_BOUNDS, joints_that_fit
from posegaussian.stages.depth.methods.registry import METHODS
from posegaussian.stages.rendering.effects import SURFACE_CLOSING, widest_gap
from posegaussian.stages.rendering.facts import HOLE_FILLING

JOINT_FIT = "survey/joint_fit"


def body_facts(inputs: Inputs, method: str) -> Facts:
    """The effects of depth and rendering that are on for a person who is cut out by joints, with a depth method.

    Of a person whose masks came with the capture no joints are looked for here: nothing is on.
    """
    if not {PERSON_MATTE, JOINTS2D} <= inputs.facts:
        return Facts()
    on = {HOLE_FILLING} if SEGMENTED in inputs.facts else set()
    sources = inputs.views.sources
    share = joints_that_fit(np.stack([inputs.read(JOINT_FIT, v) for v in sources]))[1]
    if METHODS[method].several and share is not None and share > LIMB_BOUNDS.threshold:
        on.add(LIMB_BOUNDS.name)
        if SEGMENTED in inputs.facts and widest_gap(inputs.rig.subset(list(sources))) > SURFACE_CLOSING.threshold:
            on.add(SURFACE_CLOSING.name)
    return Facts(frozenset(on))
