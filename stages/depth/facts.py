"""Names of the effects that kernels look for: apart from how they are decided, which is no part of a kernel's code."""

from __future__ import annotations

from posegaussian.stages.contract.facts import fact

LEFT_RIGHT_CHECK = fact("left_right_check")
LIMB_BOUNDS = fact("limb_bounds")
