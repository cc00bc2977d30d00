"""Names of the effects that kernels look for: apart from how they are decided, which is no part of a kernel's code."""

from __future__ import annotations

from posegaussian.stages.contract.facts import fact

SILHOUETTE_CLIPPING = fact("silhouette_clipping")
HOLE_FILLING = fact("hole_filling")
ANTI_ALIASING = fact("anti_aliasing")
SURFACE_CLOSING = fact("surface_closing")
SOURCE_DETAIL = fact("source_detail")
POSE_BLENDING = fact("pose_blending")
OUTLINE_EVENING = fact("outline_evening")
FITTED = fact("fitted_gaussians")
"""Pictures are drawn from Gaussians that rendering itself fits to each frame."""
