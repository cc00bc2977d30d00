"""When pose heatmaps are drawn: where there are joints."""

from __future__ import annotations

from posegaussian.stages.contract.declaration import Decision, Effect, Evidence
from posegaussian.stages.contract.facts import JOINTS2D, JOINTS3D
from posegaussian.stages.pose import facts


def _heatmaps(evidence: Evidence, bound: float) -> Decision:
    views = len(evidence.joint_views)
    if views:
        return Decision(True, float(views), bound, f"{views} of {len(evidence.sources)} source views have joints")
    return Decision(True, float(len(evidence.sources)), bound, "the capture came with 3D joints, which every view sees")


def _no_joints(evidence: Evidence) -> str | None:
    return None if {JOINTS2D, JOINTS3D} & evidence.facts else "the capture has no joints"


POSE_HEATMAPS = Effect(
    facts.POSE_HEATMAPS,
    "Draw a heatmap of every joint in every view.",
    "source views with joints",
    0.0,
    "views",
    _heatmaps,
    lacks=_no_joints,
)
