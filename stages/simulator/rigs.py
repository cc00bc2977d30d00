"""From a scene's rig to cameras: names, intrinsics and poses."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from posegaussian.stages.geometry.projection import project
from posegaussian.stages.simulator.effects.base import generator
from posegaussian.stages.simulator.scene import NOWHERE, Arc, Dome, Listed, Ring, Scene, SceneCamera, Stereo, THuman
from posegaussian.storage.model.cameras import Rig, camera_centre, rigid
from posegaussian.storage.model.errors import ConfigError


def pointed(centre: np.ndarray, target: np.ndarray, up: Sequence[float], roll: float) -> np.ndarray:
    """[4, 4] world_to_camera at `centre` [3] towards `target` [3], which is elsewhere, `up` upwards in the picture,
    then rolled by degrees."""
    forward = (target - centre) / np.linalg.norm(target - centre)
    right = np.cross(forward, up)
    if np.linalg.norm(right) < 1e-9:  # straight up or down: left of the picture is left of the subject
        right = np.array([1.0, 0.0, 0.0] if abs(forward[1]) > 0.9 else [0.0, -1.0, 0.0])
        right = right - (right @ forward) * forward
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    a = math.radians(roll)
    rotation = np.array([[math.cos(a), math.sin(a), 0], [-math.sin(a), math.cos(a), 0], [0, 0, 1]]) @ rotation
    return rigid(rotation, -rotation @ centre)


def _intrinsics(
    size: tuple[int, int], focal: float | None, fill: float, distance: float, subject_height: float
) -> np.ndarray:
    width, height = size
    f = focal * max(size) if focal is not None else fill * height * distance / subject_height
    return np.array([[f, 0.0, width / 2], [0.0, f, height / 2], [0.0, 0.0, 1.0]])


def _turns(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Degrees around and above the horizon of every source camera."""
    rig = scene.rig
    assert not isinstance(rig, Listed)
    n = rig.cameras
    if isinstance(rig, Arc):
        return (np.linspace(-rig.span / 2, rig.span / 2, n) if n > 1 else np.zeros(1)) + rig.start, np.zeros(n)
    if isinstance(rig, Dome):
        of_ring = rig.of_ring
        around = np.concatenate([360.0 * (np.arange(k) + 0.5 * (r % 2)) / max(k, 1) for r, k in enumerate(of_ring)])
        above = np.repeat(np.linspace(0.0, rig.top, rig.rings) if rig.rings > 1 else np.zeros(1), of_ring)
        return around + rig.start, above
    if isinstance(rig, Stereo):
        half = math.degrees(math.asin(min(1.0, rig.baseline / 2 / rig.radius)))
        pairs = 360.0 * np.arange(n // 2) / (n // 2)
        return np.stack([pairs - half, pairs + half], axis=1).ravel() + rig.start, np.zeros(n)
    return 360.0 * np.arange(n) / n + rig.start, np.zeros(n)


def make_rig(scene: Scene, span: tuple[float, float]) -> tuple[Rig, int]:
    """The true cameras of a scene, source cameras first, and how many of them are sources.

    span: metres above the ground from the subject's lowest to its highest point; cameras look at its middle. Held-out
    cameras given by number stand midway between neighbours, spread over the rig, with the lens of the rig. Raises
    ConfigError for a listed camera that stands where it looks.
    """
    target, subject_height = np.array([0.0, 0.0, (span[0] + span[1]) / 2]), span[1] - span[0]
    rows: list[tuple[str, np.ndarray, np.ndarray, tuple[int, int]]] = []
    if isinstance(scene.rig, Listed):
        rows += [_listed(c, target, subject_height) for c in scene.rig.cameras]
    else:
        around, above = _turns(scene)
        rows += [
            _placed(scene, f"cam{i:02d}", a, e, target, subject_height)
            for i, (a, e) in enumerate(zip(around, above, strict=True))
        ]
    sources = len(rows)
    if isinstance(scene.held_out, list):
        rows += [_listed(c, target, subject_height) for c in scene.held_out]
    elif scene.held_out:
        rows += [_placed(scene, f"mid{i:02d}", a, e, target, subject_height) for i, (a, e) in enumerate(_gaps(scene))]
    n = len(rows)
    poses = np.stack([r[2] for r in rows])
    if scene.rig.jitter:
        for v in range(sources):
            away = generator(scene.seed, "jitter", v).normal(size=3) * scene.rig.jitter
            centre = camera_centre(poses[v]) + away
            if isinstance(scene.rig, Listed):
                camera = scene.rig.cameras[v]
                poses[v] = pointed(centre, _looked_at(camera, target), camera.up, camera.roll)
            else:
                poses[v] = pointed(centre, target, (0, 0, 1), _roll(scene, rows[v][0]))
    return (
        Rig(
            tuple(r[0] for r in rows),
            np.stack([r[1] for r in rows]),
            np.zeros((n, 8)),
            poses,
            np.array([r[3] for r in rows], dtype=np.int64),
        ),
        sources,
    )


def framed(scene: Scene, poses: np.ndarray) -> tuple[Rig, int]:
    """As `make_rig`, but the rig's `fill` is the least share of the height that the subject fills in any picture.

    poses [M, V, 3] the subject's vertices in the world, metres, at the moments that count; they are in front of all
    cameras. Cameras stand around the middle of the ground that the subject takes up; what they look at is raised or
    lowered until as much is left free above as below.
    """
    assert not isinstance(scene.rig, Listed)
    bounds = poses.reshape(-1, 3).min(axis=0), poses.reshape(-1, 3).max(axis=0)
    middle, low, high = 0.5 * (bounds[0] + bounds[1]) * [1, 1, 0], float(bounds[0][2]), float(bounds[1][2])
    for _ in range(4):
        rig, sources = make_rig(scene, (low, high))
        moved = rig.world_to_camera.copy()
        moved[:, :3, 3] -= rig.rotations @ middle
        rig = dataclasses.replace(rig, world_to_camera=moved)
        rows = np.array(
            [
                [
                    (r.min(), r.max())
                    for p in poses
                    for r in [project(p, rig.intrinsics[v], rig.world_to_camera[v])[0][:, 1]]
                ]
                for v in range(len(rig))
            ]
        )
        height, focal = scene.rig.size[1], rig.intrinsics[0, 1, 1]
        factor = scene.rig.fill * height / np.ptp(rows, axis=2).min()
        lower = (0.5 * (rows.min() + rows.max()) - 0.5 * height) * scene.rig.radius / focal
        low, high = low - lower, high - lower
    intrinsics = rig.intrinsics.copy()
    intrinsics[:, (0, 1), (0, 1)] *= factor
    return dataclasses.replace(rig, intrinsics=intrinsics), sources


def _gaps(scene: Scene) -> list[tuple[float, float]]:
    """Degrees around and above of the held-out cameras: middles of gaps between neighbours, spread over the rig."""
    assert isinstance(scene.held_out, int)
    assert not isinstance(scene.rig, Listed)
    around, above = _turns(scene)
    n = len(around)
    chosen = np.linspace(0, scene.rig.gaps, scene.held_out, endpoint=False).astype(int)
    if isinstance(scene.rig, Stereo):  # the middle of a pair
        return [((around[2 * p] + around[2 * p + 1]) / 2, 0.0) for p in chosen]
    if isinstance(scene.rig, Arc):
        return [((around[i] + around[i + 1]) / 2, (above[i] + above[i + 1]) / 2) for i in chosen]
    of_ring = scene.rig.of_ring if isinstance(scene.rig, Dome) else [n]
    steps = np.repeat([360.0 / max(k, 1) for k in of_ring], of_ring)
    alone = np.repeat([k == 1 for k in of_ring], of_ring) if isinstance(scene.rig, Dome) else np.zeros(n, dtype=bool)
    return [(around[i] + steps[i] / 2, above[i]) for i in np.flatnonzero(~alone)[chosen]]


def _placed(
    scene: Scene, name: str, around: float, above: float, target: np.ndarray, subject_height: float
) -> tuple[str, np.ndarray, np.ndarray, tuple[int, int]]:
    rig = scene.rig
    assert not isinstance(rig, Listed)
    a, e = math.radians(around), math.radians(above)
    centre = np.array(
        [
            rig.radius * math.cos(a) * math.cos(e),
            rig.radius * math.sin(a) * math.cos(e),
            rig.height + rig.radius * math.sin(e),
        ]
    )
    if rig.tilt:
        centre = target + _tilted(rig, around) @ (centre - target)
    pose = pointed(centre, target, (0, 0, 1), _roll(scene, name))
    return (
        name,
        _intrinsics(rig.size, rig.focal, rig.fill, float(np.linalg.norm(centre - target)), subject_height),
        pose,
        rig.size,
    )


def _roll(scene: Scene, name: str) -> float:
    """Degrees by which a camera that is not listed is rolled."""
    rig = scene.rig
    assert not isinstance(rig, Listed)
    further = float(generator(scene.seed, f"roll {name}").uniform(-1, 1)) * rig.roll_spread if rig.roll_spread else 0.0
    return rig.roll + further


def _tilted(rig: Ring | Arc | Dome | Stereo | THuman, around: float) -> np.ndarray:
    """[3, 3] turn by the rig's tilt about the line from the subject towards the rig's start; of a pair, its middle."""
    toward = rig.start
    if isinstance(rig, Stereo):
        apart = 720.0 / rig.cameras
        toward += apart * round((around - rig.start) / apart)
    a, t = math.radians(toward), -math.radians(rig.tilt)
    on = np.array([[math.cos(a), -math.sin(a), 0.0], [math.sin(a), math.cos(a), 0.0], [0.0, 0.0, 1.0]])
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, math.cos(t), -math.sin(t)], [0.0, math.sin(t), math.cos(t)]])
    return on @ about_x @ on.T


def _looked_at(camera: SceneCamera, middle: np.ndarray) -> np.ndarray:
    """[3] where a listed camera looks; `middle` [3] of the subject."""
    return middle if camera.look_at is None else np.array(camera.look_at)


def _listed(
    camera: SceneCamera, target: np.ndarray, subject_height: float
) -> tuple[str, np.ndarray, np.ndarray, tuple[int, int]]:
    centre, at = np.array(camera.position), _looked_at(camera, target)
    if np.linalg.norm(centre - at) < NOWHERE:
        raise ConfigError(
            f"camera {camera.name} stands at {camera.position}, the middle of the subject, which it looks at; move it,"
            " or name another look_at"
        )
    pose = pointed(centre, at, camera.up, camera.roll)
    return (
        camera.name,
        _intrinsics(camera.size, camera.focal, camera.fill, float(np.linalg.norm(centre - at)), subject_height),
        pose,
        camera.size,
    )
