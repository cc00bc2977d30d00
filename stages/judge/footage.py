"""A few frames of all source views, reduced and cut out by the masks that came with the capture."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np

from posegaussian.stages.contract.facts import Facts
from posegaussian.stages.contract.io import Inputs, TaskScope
from posegaussian.stages.depth.facts import LEFT_RIGHT_CHECK
from posegaussian.stages.imaging.color import to_display
from posegaussian.stages.imaging.warp import Warp
from posegaussian.stages.judge.memory import Frames


def frames_of(inputs: Inputs, most: int) -> Frames:
    """`frames/color` and `frames/mask` of at most `most` worked frames, evenly spread, of those that most source views
    have a picture of; in pixels of the rig, padded to the largest."""
    numbers, valid = inputs.footage("pictures")
    sources = list(inputs.views.sources)
    seen = valid[:, sources].sum(axis=1)
    whole = np.flatnonzero(seen == seen.max())
    at = whole[np.rint(np.linspace(0, len(whole) - 1, min(most, len(whole)) + 2)[1:-1]).astype(int)]
    width, height = (int(n) for n in inputs.rig.size.max(axis=0))
    shape = (len(at), len(inputs.rig), height, width)
    color, mask = np.zeros((*shape, 3), np.uint8), np.zeros(shape, np.uint8)
    pictures, masks = inputs.source("pictures"), inputs.source("masks")
    for v in sources:
        warp = Warp(v, pictures.size(v), inputs.source_rig, inputs.rig, inputs.captured_to_calibrated[v])
        w, h = warp.size
        wanted = [i for i in range(len(at)) if valid[at[i], v]]
        there = [int(numbers[at[i]]) for i in wanted]
        for i, picture, given in zip(wanted, pictures.read(v, there), masks.read(v, there), strict=True):
            color[i, v, :h, :w], mask[i, v, :h, :w] = warp(to_display(picture)), warp(given)
    scope = TaskScope(**{f.name: getattr(inputs, f.name) for f in fields(TaskScope)})
    scope = replace(
        scope,
        partition=range(len(at)),
        source_frames=numbers[at],
        time=np.zeros(len(at)),
        valid=valid[at],
        view=None,
        facts=Facts(frozenset({LEFT_RIGHT_CHECK})),
        joint_set=None,
    )
    return Frames(scope, {"frames/color": color, "frames/mask": mask})
