"""Joints in space as CMU Panoptic has them: a JSON a frame, `body3DScene_00000000.json`, with every body's id and 19
joints (x, y, z, confidence), centimetres in the world of its cameras."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from posegaussian.storage.model.documents import read_json, shortened
from posegaussian.storage.model.errors import SourceError
from posegaussian.storage.model.joint_sets import PANOPTIC19
from posegaussian.storage.model.plausible import check_joints3d

METRES = 1e-2
"""In a unit of the files."""


def read_bodies(path: str | Path) -> Mapping[int, np.ndarray]:
    """{id: [19, 4] float64 (x, y, z, score) in world metres} of one frame; score 0 where a joint was not found. Raises
    SourceError."""
    data: Any = read_json(path, "joints")
    bodies = data.get("bodies") if isinstance(data, dict) else None
    if not isinstance(bodies, list) or not all(isinstance(b, dict) for b in bodies):
        raise SourceError(f"{path} has no list 'bodies' of objects")
    out: dict[int, np.ndarray] = {}
    for body in bodies:
        who, flat = body.get("id"), body.get("joints19")
        if type(who) is not int or abs(who) >= 2**31 or who in out:
            raise SourceError(f"{path}: the id of a body is {shortened(who)}; another whole number each is expected")
        try:
            found = np.array(flat, dtype=np.float64).reshape(len(PANOPTIC19), 4)
        except (TypeError, ValueError):
            raise SourceError(
                f"{path}: joints19 of body {who} are not {len(PANOPTIC19)} times x, y, z and confidence"
            ) from None
        known = np.isfinite(found).all(axis=1) & (found[:, 3] > 0)
        out[who] = np.where(known[:, None], found * [METRES, METRES, METRES, 1], 0.0)
        out[who][:, 3] = np.minimum(out[who][:, 3], 1)
        check_joints3d(str(path), out[who][:, :3])
    return out
