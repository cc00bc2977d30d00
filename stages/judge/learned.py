"""What the network makes of reduced frames, in memory: by the pipeline's own kernels, with heatmaps of given joints."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from dataclasses import fields
from typing import Any

import numpy as np

from posegaussian.stages.contract.facts import ESTIMATED, JOINTS2D, JOINTS3D
from posegaussian.stages.contract.io import Inputs, TaskScope
from posegaussian.stages.contract.timing import TimedInputs
from posegaussian.stages.gaussians.params import GaussiansParams
from posegaussian.stages.gaussians.run import run as gaussians_of
from posegaussian.stages.judge.memory import Frames
from posegaussian.stages.network.asset import SHIPPED_NETWORKS
from posegaussian.stages.network.choice import fitting_weights
from posegaussian.stages.network.params import NETWORK, NONE, NetworkParams
from posegaussian.stages.network.run import run as network_of
from posegaussian.stages.pose.facts import POSE_HEATMAPS
from posegaussian.stages.pose.run import run as pose_of

PLAIN = NetworkParams(weights=NONE, precision="float32")
"""Default settings but for the precision, which must not follow from the machine that judges; the network is opened
beside them."""


class Opened(Frames, TimedInputs):
    """Frames in memory beside what was opened of files, by source."""

    def __init__(self, frames: Frames, opened: dict[str, Any]) -> None:
        super().__init__(TaskScope(**{f.name: getattr(frames, f.name) for f in fields(TaskScope)}), frames.arrays)
        self._opened = opened

    def source(self, kind: str) -> Any:
        """What was opened. Raises KeyError for anything else."""
        return self._opened[kind]

    def timed(self, module: str) -> AbstractContextManager[None]:
        """Nobody takes times here."""
        return nullcontext()


def learned(inputs: Inputs, made: Frames) -> dict[str, Frames]:
    """Frames with depth and Gaussians (`with_gaussians`) with those that weights that ship and fit these cameras make
    of them, by name."""
    networks, found = inputs.source(SHIPPED_NETWORKS.name), with_heatmaps(made, inputs)
    fitting, _ = fitting_weights(inputs.rig, inputs.views.sources)
    return {name: _refined(found, networks[name]) for name in fitting}


def with_heatmaps(frames: Frames, inputs: Inputs) -> Frames:
    """The frames with heatmaps of the joints that came with the capture; as they are where there are none, or where
    joints are estimated, which has not happened yet."""
    posed = _posed(frames, inputs, frozenset({POSE_HEATMAPS}))
    if posed is None:
        return frames
    found = frames.with_facts(frames.facts | {POSE_HEATMAPS})
    return found.with_array("pose/heatmaps", posed["pose/heatmaps"])


def with_joints(frames: Frames, inputs: Inputs) -> Frames | None:
    """The frames with `pose/joints2d` and `pose/joints3d`, which came with the capture or cut the person out; None
    where there are none yet."""
    if {"pose/joints2d", "pose/joints3d"} <= frames.arrays.keys():
        return frames
    posed = _posed(frames, inputs, frozenset())
    if posed is None:
        return None
    for name in ("pose/joints2d", "pose/joints3d"):
        frames = frames.with_array(name, posed[name])
    return frames


def _posed(frames: Frames, inputs: Inputs, more: frozenset[str]) -> dict[str, np.ndarray] | None:
    """What the pose stage makes of given joints."""
    known = inputs.facts & {JOINTS2D, JOINTS3D}
    if not known or ESTIMATED in inputs.facts:
        return None
    opened = {
        kind: inputs.source(kind) for kind, told in (("joints", JOINTS2D), ("joints3d", JOINTS3D)) if told in known
    }
    posed = Opened(frames.with_facts(frames.facts | known | more), opened)
    # A few frames far apart: nothing bridges them.
    posed.put(pose_of(posed, inputs.settings["pose"].model_copy(update={"bridge": 0})))
    return posed.arrays


def _refined(frames: Frames, network: Any) -> Frames:
    out = frames.with_facts(frames.facts | {NETWORK})
    out.put(network_of(Opened(out, {NETWORK: network}), PLAIN))
    out.put(gaussians_of(out, GaussiansParams()))
    return out
