"""The depth methods by name. A further one is a file of this folder and its entry here."""

from __future__ import annotations

from collections.abc import Mapping

from posegaussian.stages.depth.methods.declaration import DepthMethod
from posegaussian.stages.depth.methods.given import METHOD as GIVEN
from posegaussian.stages.depth.methods.hull import METHOD as HULL
from posegaussian.stages.depth.methods.relief import METHOD as RELIEF
from posegaussian.stages.depth.methods.sgbm import METHOD as SGBM
from posegaussian.stages.depth.methods.sweep import METHOD as SWEEP
from posegaussian.stages.depth.methods.truth import METHOD as TRUTH

METHODS: Mapping[str, DepthMethod] = {m.name: m for m in (GIVEN, RELIEF, SWEEP, SGBM, HULL, TRUTH)}
"""In the order in which `auto` asks them."""
BY_PICTURES = tuple(m.name for m in sorted(METHODS.values(), key=lambda m: m.quality or 0) if m.quality is not None)
"""Those that any capture of several views can choose from, the worst quality level first."""
