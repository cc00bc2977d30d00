"""A frame of training without the simulator:
a textured ball between cameras, and a start that is a ball of another size."""

from __future__ import annotations

import numpy as np

from posegaussian.stages.geometry.projection import pixel_centres, rays, unproject
from posegaussian.stages.training.config import TrainingConfig
from posegaussian.stages.training.contract import Frame
from posegaussian.storage.model.cameras import Rig
from tests.support.known_geometry import camera, on_ring, rig_of, sphere_depth, sphere_mask

RADIUS, STARTS_AT = 0.5, 0.44


def tiny(**more: object) -> TrainingConfig:
    """Seconds on one core: crops of 32 px, one pair a step, in float32, from matched depth alone."""
    settings = {
        "size": 64,
        "crop": 32,
        "batch": 1,
        "iterations": 2,
        "window": 1,
        "steps_per_frame": 1000,
        "cameras": (3,),
        "methods": ("sweep",),
        "precision": "float32",
        "depth_steps": 100,
        "joint_steps": 0,
        "warm_up": 5,
        "learning_rate": 1e-3,
        "frames_per_scene": 1,
        "scenes": {"count": 1},
        "starts": {"matched": 1, "hull": 0, "noisy": 0, "truth": 0},
        "single": 0,
        "strange": 0,
    }
    return TrainingConfig.model_validate({**settings, **more})


def ball(
    size: int = 64, exact: bool = False, angles: tuple[float, ...] = (-15.0, 15.0), stacked: bool = False
) -> Frame:
    """Sources at so many degrees around the ball and the camera between the first two, which are the pairs. `exact`:
    the start is the truth. `stacked`: the cameras stand above each other instead."""
    sources = len(angles)
    places = [on_ring(0, elevation=a) if stacked else on_ring(a) for a in (*angles, 0)]
    rig = rig_of([camera(p, np.zeros(3)) for p in places], (size, size), 1.6 * size)
    truth = np.stack([sphere_depth(rig, v, np.zeros(3), RADIUS) for v in range(sources + 1)]).astype(np.float32)
    mask = np.stack([sphere_mask(rig, v, np.zeros(3), RADIUS) for v in range(sources + 1)])
    start = truth[:sources] if exact else np.stack([_larger(rig, v) for v in range(sources)])
    start = np.where(mask[:sources] > 127, start, 0).astype(np.float32)
    confidence = np.where(start > 0, 0.8, 0).astype(np.float16)
    middle = np.full((3, sources, 17, 3), 1.0)
    middle[..., :2] = size / 2 + np.linspace(-8, 8, 17)[:, None]
    return {
        "color": np.stack([_color(rig, v, truth[v]) for v in range(sources + 1)]),
        "mask": mask,
        "truth": truth[:sources],
        "depth": start,
        "hull": start,
        "confidence": confidence,
        "joints": middle,
        "intrinsics": rig.intrinsics,
        "world_to_camera": rig.world_to_camera,
        "pairs": np.array([[0, 1, sources], [1, 0, sources]]),
    }


def _larger(rig: Rig, view: int) -> np.ndarray:
    """Depth of a ball as seen at the true one's outline: farther by what the smaller ball lacks in the middle."""
    _, directions = rays(pixel_centres(tuple(rig.size[view])), rig.intrinsics[view], rig.world_to_camera[view])
    near = sphere_depth(rig, view, np.zeros(3), RADIUS)
    return near + (RADIUS - STARTS_AT) / np.linalg.norm(directions, axis=-1)


def _color(rig: Rig, view: int, depth: np.ndarray) -> np.ndarray:
    points = unproject(depth, rig.intrinsics[view], rig.world_to_camera[view])
    waves = np.stack([np.sin(points @ np.array(k)) for k in ((3, 28, 11), (7, -9, 30), (2, 21, -17))], axis=-1)
    return np.where((depth > 0)[..., None], np.rint(127.5 + 110 * waves), 0).astype(np.uint8)
