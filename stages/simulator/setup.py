"""From a scene to a take: who plays, which cameras film, which effects are on, and why."""

from __future__ import annotations

import dataclasses
from collections import defaultdict
from dataclasses import dataclass

import numpy as np

from posegaussian.stages.contract.declaration import resolve
from posegaussian.stages.geometry.projection import project
from posegaussian.stages.simulator.effects.base import Ruling, SceneEvidence, generator, ruled
from posegaussian.stages.simulator.effects.registry import EFFECTS
from posegaussian.stages.simulator.rigs import framed, make_rig
from posegaussian.stages.simulator.scene import Listed, Person, Scene
from posegaussian.stages.simulator.subjects.splits import cast, refusal
from posegaussian.stages.simulator.take import Take
from posegaussian.stages.simulator.wardrobe.actors import Actor, Performer
from posegaussian.storage.model.cameras import Rig


@dataclass(frozen=True, eq=False)
class Staged:
    """A scene ready to be filmed."""

    take: Take
    """Films."""
    written: Rig
    """The cameras that are written down."""
    sources: int
    """How many of them, from the first on, are sources; the rest is held out."""
    valid: np.ndarray
    """[F, V] whether a camera has a picture of a frame."""
    rulings: tuple[Ruling, ...]
    """Every effect, in order."""


def play(scene: Scene) -> Performer:
    """The person of a scene. Raises ValueError for somebody, or a motion, that its seed may not show."""
    assert isinstance(scene.subject, Person)
    for name in (scene.subject.person, scene.subject.outfit, scene.motion.name):
        why = refusal(scene.seed, name)
        if why is not None:
            raise ValueError(why)
    subject, outfit = cast(scene.seed, scene.subject.person, scene.subject.outfit)
    style = generator(scene.seed, "style").uniform(-1.0, 1.0, 4)
    return Performer(
        subject,
        outfit,
        scene.motion.name,
        scene.motion.speed,
        scene.motion.phase,
        style,
        scene.subject.heading,
        extras=scene.subject.extras(),
    )


def _fastest(actor: Actor, rig: Rig, frames: int, interval: float) -> float:
    """Px between two frames of the fastest joint (or of a scan's vertices) in the camera where it is fastest."""

    def points(t: float) -> np.ndarray:
        found = actor.joints(t)
        return found if found is not None else actor.vertices(t)[::97]

    moments = np.unique(np.linspace(0, max(frames - 2, 0), min(frames, 24)).astype(int)) * interval
    fastest = 0.0
    for t in moments:
        a, b = points(float(t)), points(float(t + interval))
        for v in range(len(rig)):
            (pa, za), (pb, zb) = (project(x, rig.intrinsics[v], rig.world_to_camera[v]) for x in (a, b))
            ahead = (za > 0.1) & (zb > 0.1)
            fastest = max(fastest, float(np.linalg.norm(pa - pb, axis=1)[ahead].max(initial=0.0)))
    return fastest


def _filming(scene: Scene, actor: Actor) -> tuple[Rig, int]:
    """The cameras, and how many of them are sources."""
    if isinstance(scene.rig, Listed) or scene.rig.framing == "rest" or scene.rig.focal is not None:
        return make_rig(scene, (0.0, float(np.ptp(actor.mesh.vertices[:, 2]))))
    moments = np.unique(np.linspace(0, scene.frames - 1, min(scene.frames, 24)).astype(int)) / scene.frame_rate
    return framed(scene, np.stack([actor.vertices(float(t)) for t in moments]))


def stage(scene: Scene, subject: Actor | None = None) -> Staged:
    """Decide the effects and make the take. `subject` is the scan where the scene names one."""
    actor = play(scene) if subject is None else subject
    interval = 1.0 / scene.frame_rate
    rig, sources = _filming(scene, actor)
    evidence = SceneEvidence(
        None,
        _fastest(actor, rig, scene.frames, interval),
        float(rig.size.max()),
        len(rig),
        isinstance(scene.subject, Person),
    )
    rulings = tuple(
        ruled(e, p, dataclasses.replace(evidence, params=p)) for e in EFFECTS for p in [getattr(scene.effects, e.name)]
    )
    on: dict[str, list[Ruling]] = defaultdict(list)
    for r in rulings:
        if r.decision.on:
            on[r.effect.phase].append(r)
    times = np.repeat((np.arange(scene.frames) * interval)[:, None], len(rig), axis=1)
    valid = np.ones(times.shape, dtype=bool)
    for r in on["times"]:
        times, valid = resolve(r.effect.apply)(times, valid, r.params, scene.seed)
    # a held-out camera is a ruler: it is in step and drops nothing
    times[:, sources:] = (np.arange(scene.frames) * interval)[:, None]
    valid[:, sources:] = True
    for r in on["rig"]:
        bent = resolve(r.effect.apply)(rig, r.params, scene.seed)
        rig = dataclasses.replace(
            bent, distortion=np.concatenate([bent.distortion[:sources], rig.distortion[sources:]])
        )
    written = rig
    for r in on["calibration"]:
        off = resolve(r.effect.apply)(written, r.params, scene.seed)
        poses = np.concatenate([off.world_to_camera[:sources], written.world_to_camera[sources:]])
        written = dataclasses.replace(written, world_to_camera=poses)
    actors = (actor, *(resolve(r.effect.apply)(r.params, scene.seed) for r in on["meshes"]))
    return Staged(
        Take(scene.seed, actors, rig, times, interval, scene.samples, dict(on), sources),
        written,
        sources,
        valid,
        rulings,
    )
