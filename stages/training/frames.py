"""One frame of a training scene as arrays: what the stages before the network give, and the truth beside it.

Of many cameras neighbours are kept, `pairs_per_frame` pairs of them; all cameras say what the hull is.

color [V, h, w, 3], mask [V, h, w]           of the kept cameras, sources first, then the held-out one of every gap
truth [S, h, w] float32                      true depth of the sources, metres, 0 = none
depth, confidence [S, h, w]                  their matched analytic depth
hull [S, h, w] float32                       depth of the hull's surface, metres, 0 = none
joints [F, S, 17, 3]                         true px, and whether a joint is seen now, of the frames of a video up to
                                             this one, the last
intrinsics, world_to_camera                  of all cameras as a program under test knows them
pairs [P, 3]                                 indices (source, next source, held-out camera between them)
"""

from __future__ import annotations

import hashlib
import inspect

import numpy as np

from posegaussian.stages.depth.algorithms.pose_prior import flesh_of, limbs_of
from posegaussian.stages.depth.algorithms.scene import Frame, Geometry
from posegaussian.stages.depth.methods.registry import METHODS
from posegaussian.stages.depth.params import DepthParams
from posegaussian.stages.geometry.projection import project
from posegaussian.stages.simulator.effects.base import generator
from posegaussian.stages.simulator.setup import stage
from posegaussian.stages.simulator.take import Shot, Take
from posegaussian.stages.training import scenes, wardrobe
from posegaussian.stages.training.config import TrainingConfig
from posegaussian.stages.training.scenes import training_scene
from posegaussian.storage.model.cameras import Rig

FORMAT = 2
"""Raised when the arrays of a frame change their meaning."""
RATES = (15.0, 24.0, 30.0, 50.0, 60.0)
"""Frames a second of the videos whose last frame this is."""
LIMBS = 0.5
"""Share of the frames whose start knows the limbs, as the effect `limb_bounds` has it."""


def make_frame(config: TrainingConfig, index: int) -> dict[str, np.ndarray]:
    """Training frame `index`: a pure function of its arguments."""
    return _frame(config, config.scene_seed(index), index % config.frames_per_scene)


def validation_frame(config: TrainingConfig, index: int) -> dict[str, np.ndarray]:
    """Validation frame `index`, 0 to `config.validation.count` - 1."""
    return _frame(config, config.validation_seed(index), 0)


def _frame(config: TrainingConfig, seed: int, number: int) -> dict[str, np.ndarray]:
    scene = training_scene(seed, config.frames_per_scene, config.cameras, config.size)
    staged = stage(scene)
    take, sources, rig = staged.take, staged.sources, staged.written
    random = generator(seed, "start", number)
    method = config.methods[int(random.integers(len(config.methods)))]
    limbs, rate = random.random() < LIMBS, RATES[int(random.integers(len(RATES)))]
    pairs = neighbours(rig, sources, closed=scene.rig.kind == "ring")
    first = int(random.integers(len(pairs)))
    pairs = np.roll(pairs, -first, axis=0)[: config.pairs_per_frame]
    kept, held = (list(dict.fromkeys(pairs[:, columns].ravel().tolist())) for columns in ([0, 1], [2]))
    shots = {v: take.shoot(number, v) for v in (*range(sources), *held)}
    (depth, confidence), (hull, _) = (
        _start(rig.subset(range(sources)), [shots[v] for v in range(sources)], kept, m, limbs and m == method)
        for m in (method, "hull")
    )
    place = {v: i for i, v in enumerate((*kept, *held))}
    return {
        "color": np.stack([shots[v].color for v in place]),
        "mask": np.stack([shots[v].mask if v < sources else shots[v].true_mask for v in place]),
        "truth": np.stack([shots[v].depth for v in kept]).astype(np.float32),
        "depth": depth,
        "confidence": confidence.astype(np.float16),
        "hull": hull,
        "joints": _joints(take, kept, [shots[v] for v in kept], float(take.times[number, 0]), rate, config.clip_frames),
        "intrinsics": rig.intrinsics[list(place)],
        "world_to_camera": rig.world_to_camera[list(place)],
        "pairs": np.array([[place[int(v)] for v in pair] for pair in pairs]),
        "about": np.array([seed, number, config.methods.index(method), limbs]),
    }


def _joints(take: Take, views: list[int], shots: list[Shot], time: float, rate: float, frames: int) -> np.ndarray:
    """[F, S, 17, 3] true places in the pictures of some views, and whether they are seen now, at the times of `frames`
    frames up to `time`, seconds, the last."""
    person = take.actors[0]
    clip = []
    for before in range(frames - 1, -1, -1):
        joints = person.joints(time - before / rate)
        assert joints is not None, "training scenes show people"
        clip.append([project(joints, take.rig.intrinsics[v], take.rig.world_to_camera[v])[0] for v in views])
    seen = [s.true_joints2d[:, 2:] for s in shots if s.true_joints2d is not None]
    return np.concatenate([np.array(clip), np.broadcast_to(np.stack(seen), (frames, len(views), 17, 1))], axis=-1)


def _start(rig: Rig, shots: list[Shot], views: list[int], method: str, limbs: bool) -> tuple[np.ndarray, np.ndarray]:
    """Depth and confidence [S, h, w] of some sources, as the depth stage makes them; all say what the hull is."""
    params = DepthParams.model_validate({"method": method})
    geometry = Geometry.of(rig, tuple(sorted(views)), params)
    joints = shots[0].joints3d
    known = np.column_stack([joints, np.ones(len(joints))]) if limbs and joints is not None else np.zeros((17, 4))
    colors, masks = {v: shots[v].color for v in views}, {v: s.mask for v, s in enumerate(shots)}
    frame = Frame(colors, masks, limbs_of(known), flesh_of(known))
    of_frame = METHODS[method].of_frame
    assert of_frame is not None, f"{method} takes views one by one"
    maps = of_frame(geometry, frame, params, True)
    return np.stack([maps[v][0] for v in views]), np.stack([maps[v][1] for v in views])


def neighbours(rig: Rig, sources: int, closed: bool) -> np.ndarray:
    """[P, 3] neighbours along the rig, the last and the first among them where it is `closed`, and the held-out camera
    nearest to the middle between them."""
    centres = rig.centres
    out = []
    for a in range(sources if closed else sources - 1):
        b = (a + 1) % sources
        middle = 0.5 * (centres[a] + centres[b])
        out.append([a, b, sources + int(np.argmin(np.linalg.norm(centres[sources:] - middle, axis=1)))])
    return np.array(out)


def data_key(config: TrainingConfig) -> str:
    """Hexadecimal digest of all that a frame depends on, the code that casts the scenes included."""
    said = repr(
        (
            FORMAT,
            config.frames_per_scene,
            tuple(config.cameras),
            config.pairs_per_frame,
            config.size,
            tuple(config.methods),
            config.clip_frames,
            LIMBS,
        )
    )
    return hashlib.sha256((said + inspect.getsource(scenes) + inspect.getsource(wardrobe)).encode()).hexdigest()[:16]
