"""What kernels look for: apart from how effects are decided, which is no part of a kernel's code."""

from __future__ import annotations

from posegaussian.stages.contract.facts import fact

POSE_HEATMAPS = fact("pose_heatmaps")
HIDDEN = -2
"""In `pose/chosen`: nobody found is the subject, whom somebody that stands nearer hides."""
