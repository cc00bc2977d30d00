"""Every guard by its case."""

from __future__ import annotations

from tests.mutations import guards_cameras, guards_depth, guards_measures, guards_network, guards_pose, guards_splatting
from tests.mutations.guard import Guard

ALL = (
    *guards_splatting.GUARDS,
    *guards_cameras.GUARDS,
    *guards_depth.GUARDS,
    *guards_pose.GUARDS,
    *guards_measures.GUARDS,
    *guards_network.GUARDS,
)
GUARDS: dict[str, list[Guard]] = {}
for each in ALL:
    GUARDS.setdefault(each.case, []).append(each)
