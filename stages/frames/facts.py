"""Names of the effects that kernels look for: apart from how they are decided, which is no part of a kernel's code."""

from __future__ import annotations

from posegaussian.stages.contract.facts import fact

AVERAGED_WITH = 3
"""Frames before and after that a picture, and its depth, is averaged with: noise falls by up to the root of 7."""
EXPOSURE_MATCHING = fact("exposure_matching")
GAP_OPENING = fact("gap_opening")
LIGHT_STEADYING = fact("light_steadying")
NOISE_AVERAGING = fact("noise_averaging")
OUTLINE_CORRECTION = fact("outline_correction")
OUTLINE_REDRAWING = fact("outline_redrawing")
TONE_MAPPING = fact("tone_mapping")
