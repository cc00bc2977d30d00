"""Names of the effects that kernels look for: apart from how they are decided, which is no part of a kernel's code."""

from __future__ import annotations

from posegaussian.stages.contract.facts import fact

EXPOSURE_MATCHING = fact("exposure_matching")
OUTLINE_CORRECTION = fact("outline_correction")
TONE_MAPPING = fact("tone_mapping")
