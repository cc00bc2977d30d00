"""An estimator's own heatmaps go where its joints go."""

from __future__ import annotations

from typing import Any

import numpy as np

from posegaussian.stages.pose.params import PoseParams
from posegaussian.stages.pose.stage import STAGE
from posegaussian.storage.model.cameras import Rig
from posegaussian.storage.model.joint_sets import COCO17
from tests.support.memory_inputs import run_stage
from tests.support.walking_skeleton import pixels, ring, roles, walk

FRAMES, SIZE = 7, 128


def detected(rig: Rig, joints: np.ndarray) -> dict[str, np.ndarray]:
    """One person a picture, looked at in the whole of it; a joint's map is a broad peak at the joint."""
    cells = (np.arange(64) + 0.5) * SIZE / 64
    across = np.exp(-0.5 * ((cells - joints[..., :1]) / 8.0) ** 2)
    down = np.exp(-0.5 * ((cells - joints[..., 1:2]) / 8.0) ** 2)
    shape = (FRAMES, len(rig), 1)
    return {
        "detection/joints2d": joints[:, :, None].astype(np.float32),
        "detection/heatmaps": (down[..., :, None] * across[..., None, :])[:, :, None].astype(np.float16),
        "detection/region": np.tile(np.array([SIZE / 2, SIZE / 2, SIZE, 0.0], np.float32), (*shape, 1)),
    }


def run(rig: Rig, arrays: dict[str, np.ndarray], length: int | None = None) -> dict[str, Any]:
    return run_stage(
        STAGE,
        PoseParams(),
        arrays,
        rig,
        roles(rig),
        FRAMES,
        length,
        facts=frozenset({"joints2d", "detected", "segmented"}),
    )


def test_maps_follow_joints_whose_sides_are_put_right() -> None:
    rig = ring(6, size=SIZE)
    exact = pixels(rig, walk(FRAMES))
    right = detected(rig, exact)
    wrong = {k: v.copy() for k, v in right.items()}
    for frame, views in ((2, slice(None)), (4, slice(1, 3))):
        for name in ("detection/joints2d", "detection/heatmaps"):
            wrong[name][frame, views] = right[name][frame, views][:, :, list(COCO17.flips)]
    a, b = run(rig, right), run(rig, wrong)
    assert (a["pose/chosen"] == 0).all()
    assert a["pose/heatmaps"].max(axis=(3, 4)).min() > 0.9
    assert a["pose/heatmaps"].tobytes() == b["pose/heatmaps"].tobytes()
    assert a["pose/joints2d"].tobytes() == b["pose/joints2d"].tobytes()
    assert run(rig, wrong, 2)["pose/heatmaps"].tobytes() == b["pose/heatmaps"].tobytes()
