"""One frame of a training scene as arrays: what the stages before the network give, and the truth beside it.

color [V, h, w, 3], mask [V, h, w]           of all cameras, sources first, then the held-out one of every gap
truth [V, h, w] float32                      true depth, metres, 0 = none
depth, confidence [S, h, w]                  the analytic start of the sources
joints [S, 17, 3]                            px and score, as an estimator would give them
intrinsics, world_to_camera                  of all cameras as a program under test knows them
pairs [P, 3]                                 indices (source, next source, held-out camera between them)
"""

from __future__ import annotations

import hashlib
import inspect

import numpy as np

from posegaussian.stages.depth.algorithms.pose_prior import limbs_of
from posegaussian.stages.depth.algorithms.scene import Frame, Geometry
from posegaussian.stages.depth.methods.registry import METHODS
from posegaussian.stages.depth.params import DepthParams
from posegaussian.stages.simulator.effects.base import generator
from posegaussian.stages.simulator.setup import stage
from posegaussian.stages.simulator.take import Shot
from posegaussian.stages.training import scenes
from posegaussian.stages.training.config import TrainingConfig
from posegaussian.stages.training.scenes import training_scene
from posegaussian.storage.model.cameras import Rig

FORMAT = 1
"""Raised when the arrays of a frame change their meaning."""
LIMBS = 0.5
"""Share of the frames whose start knows the limbs, as the effect `limb_bounds` has it."""


def make_frame(config: TrainingConfig, index: int) -> dict[str, np.ndarray]:
    """Training frame `index`: a pure function of its arguments."""
    return _frame(config, config.scene_seed(index), index % config.frames_per_scene)


def validation_frame(config: TrainingConfig, index: int) -> dict[str, np.ndarray]:
    """Validation frame `index`, 0 to `config.validation.count` - 1."""
    return _frame(config, config.validation_seed(index), 0)


def _frame(config: TrainingConfig, seed: int, number: int) -> dict[str, np.ndarray]:
    staged = stage(training_scene(seed, config.frames_per_scene, config.cameras, config.size))
    take, sources = staged.take, staged.sources
    shots = [take.shoot(number, v) for v in range(len(take.rig))]
    random = generator(seed, "start", number)
    method = config.methods[int(random.integers(len(config.methods)))]
    limbs = random.random() < LIMBS
    depth, confidence = _start(staged.written.subset(range(sources)), shots[:sources], method, limbs)
    rig = staged.written
    return {
        "color": np.stack([s.color for s in shots]),
        "mask": np.stack([s.mask if v < sources else s.true_mask for v, s in enumerate(shots)]),
        "truth": np.stack([s.depth for s in shots]).astype(np.float32),
        "depth": depth,
        "confidence": confidence.astype(np.float16),
        "joints": np.stack([s.joints2d for s in shots[:sources] if s.joints2d is not None]),
        "intrinsics": rig.intrinsics,
        "world_to_camera": rig.world_to_camera,
        "pairs": _pairs(rig, sources),
        "about": np.array([seed, number, config.methods.index(method), limbs]),
    }


def _start(rig: Rig, shots: list[Shot], method: str, limbs: bool) -> tuple[np.ndarray, np.ndarray]:
    """Depth and confidence [S, h, w] of all sources, as the depth stage makes them."""
    params = DepthParams.model_validate({"method": method})
    views = tuple(range(len(shots)))
    geometry = Geometry.of(rig, views, params)
    joints = shots[0].joints3d
    capsules = (
        limbs_of(np.column_stack([joints, np.ones(len(joints))])) if limbs and joints is not None else np.zeros((0, 7))
    )
    frame = Frame({v: s.color for v, s in enumerate(shots)}, {v: s.mask for v, s in enumerate(shots)}, capsules)
    of_frame = METHODS[method].of_frame
    assert of_frame is not None, f"{method} takes views one by one"
    maps = of_frame(geometry, frame, params, True)
    return np.stack([maps[v][0] for v in views]), np.stack([maps[v][1] for v in views])


def _pairs(rig: Rig, sources: int) -> np.ndarray:
    """[P, 3] neighbours around the ring, and the held-out camera nearest to the middle between them."""
    centres = rig.centres
    out = []
    for a in range(sources):
        b = (a + 1) % sources
        middle = 0.5 * (centres[a] + centres[b])
        out.append([a, b, sources + int(np.argmin(np.linalg.norm(centres[sources:] - middle, axis=1)))])
    return np.array(out)


def data_key(config: TrainingConfig) -> str:
    """Hexadecimal digest of all that a frame depends on, the code that casts the scenes included."""
    said = repr((FORMAT, config.frames_per_scene, tuple(config.cameras), config.size, tuple(config.methods), LIMBS))
    return hashlib.sha256((said + inspect.getsource(scenes)).encode()).hexdigest()[:16]
