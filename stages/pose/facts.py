"""Names of the effects that kernels look for: apart from how they are decided, which is no part of a kernel's code."""

from __future__ import annotations

from posegaussian.stages.contract.facts import fact

POSE_HEATMAPS = fact("pose_heatmaps")
