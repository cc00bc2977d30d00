"""One picture of a scene at a time, with its truth:
the plain renderer, and the effects that are on, each in its place."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from posegaussian.stages.contract.declaration import resolve
from posegaussian.stages.geometry.projection import pixel_centres
from posegaussian.stages.imaging.camera_mapping import distort, reach
from posegaussian.stages.simulator.effects.base import Ruling
from posegaussian.stages.simulator.render.light import (
    GROUND,
    LIGHTS,
    POWERS,
    SKY,
    SRGB,
    averaged,
    decode,
    encode,
    flat_textures,
    shade,
)
from posegaussian.stages.simulator.render.mesh import Mesh, joined
from posegaussian.stages.simulator.render.raster import flat_normals, rasterize, vertex_normals
from posegaussian.stages.simulator.wardrobe.actors import Actor
from posegaussian.storage.model.cameras import Rig

KEPT_MOMENTS = 200
"""Frames whose light is kept for the other views: a megabyte each."""
OF_CAMERAS = frozenset({"shutter", "rows", "optics", "sensor", "file", "mask", "joints"})
"""Phases in which a camera and what is read from its pictures are imperfect."""


@dataclass(eq=False)
class Shot:
    """A picture with its truth."""

    frame: int
    view: int
    color: np.ndarray
    """[h, w, 3] uint8 sRGB; before black premultiplied."""
    mask: np.ndarray
    """[h, w] uint8 what a matting program gives:
    covered share of the pixel by the subject, unless an effect spoils it."""
    joints2d: np.ndarray | None
    """[17, 3] (u, v, score) px, what a pose estimator gives: the truth with score 1, unless an effect spoils it."""
    true_mask: np.ndarray
    """[h, w] uint8 covered share of the pixel by the subject."""
    depth: np.ndarray
    """[h, w] float32 metres along the optical axis at the pixel centre,
    of the subject where it is what is seen; else 0."""
    normal: np.ndarray
    """[h, w, 3] float32 unit normal of the triangle seen there, camera axes, facing the camera; else 0."""
    true_joints2d: np.ndarray | None
    """[17, 3] exact (u, v) px, and 1 where the joint's own limb is what is seen there, 0 where something hides it."""
    joints3d: np.ndarray | None
    """[17, 3] world metres, at the middle of the exposure."""


@dataclass(eq=False)
class Picture:
    """What effects of the optics and the sensor may look at."""

    frame: int
    view: int
    cover: np.ndarray
    """[h, w] share of the pixel that anything covers."""
    first_depth: np.ndarray
    """[h, w] metres of the first surface at the pixel centre, whoever's; 0 = none."""
    centre: np.ndarray
    """[3] the camera, world metres."""
    focal: float
    """px."""
    axis_distance: float
    """Metres along the optical axis to the subject's axis."""
    rays: Any
    """() -> [h, w, 3] directions in the world."""
    visible: np.ndarray
    """[17] whether a joint is seen."""

    @cached_property
    def directions(self) -> np.ndarray:
        """[h, w, 3] of the rays through the pixel centres, the lens included."""
        return self.rays()


@dataclass(eq=False)
class Take:
    """A scene made ready: actors, true cameras, moments and the effects that are on."""

    seed: int
    actors: tuple[Actor, ...]
    """The subject first."""
    rig: Rig
    """The cameras that film."""
    times: np.ndarray
    """[F, V] seconds of the middle of every exposure."""
    interval: float
    """Seconds from frame to frame."""
    samples: int
    """Samples a side of a pixel."""
    on: dict[str, list[Ruling]]
    """{phase: rulings that are on, in order}."""
    sources: int
    """Cameras from this one on are held out: rulers, whose lens, shutter, sensor and labels are perfect."""
    calls: dict[str, int] = field(default_factory=dict)
    """How often each effect was computed."""
    _lit: dict[int, np.ndarray] = field(default_factory=dict, repr=False)

    def _run(self, ruling: Ruling, *given: Any) -> Any:
        self.calls[ruling.effect.name] = self.calls.get(ruling.effect.name, 0) + 1
        return resolve(ruling.effect.apply)(*given)

    def _of(self, phase: str, view: int | None = None) -> list[Ruling]:
        """Rulings of a phase that are on, for a view."""
        return [] if view is not None and view >= self.sources and phase in OF_CAMERAS else self.on.get(phase, [])

    @cached_property
    def mesh(self) -> Mesh:
        """All actors together."""
        return joined([a.mesh for a in self.actors])

    @cached_property
    def _paint(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, bool]:
        texels, info, gloss = flat_textures(self.mesh)
        shiny = self._of("gloss")
        for ruling in shiny:
            gloss = self._run(ruling, gloss, ruling.params)
        return texels, info, gloss, bool(shiny)

    def prepare(self) -> None:
        """Make what all pictures share, before threads ask for it."""
        _ = self._paint, self.mesh

    def _posed(self, time: float) -> np.ndarray:
        """[V, 3] vertices of all actors at a time."""
        out = []
        for actor in self.actors:
            v = actor.vertices(time)
            for ruling in self._of("cloth"):
                if actor.mesh.slack.any():
                    v = self._run(ruling, v, actor.vertices(time - ruling.params.lag), actor.mesh.slack)
            out.append(v)
        return np.concatenate(out)

    def _pictured(self, vertices: np.ndarray, view: int) -> tuple[np.ndarray, np.ndarray]:
        """[V, 3] (u, v, depth) and [V, 3] in the camera's frame; what the lens cannot picture has depth -1."""
        camera = vertices @ self.rig.world_to_camera[view, :3, :3].T + self.rig.world_to_camera[view, :3, 3]
        with np.errstate(divide="ignore", invalid="ignore"):
            plane = camera[:, :2] / camera[:, 2:]
        out = np.column_stack([plane, camera[:, 2]])
        bend = self.rig.distortion[view]
        if bend.any():
            within = (camera[:, 2] > 0) & (np.linalg.norm(plane, axis=1) <= reach(bend))
            out[within, :2] = distort(plane[within], bend)
            out[~within, 2] = -1.0
        k = self.rig.intrinsics[view]
        out[:, :2] = out[:, :2] @ k[:2, :2].T + k[:2, 2]
        return np.where(out[:, 2:] > 0, out, [0.0, 0.0, -1.0]), camera

    def _seen(self, time: float, view: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Vertices in the world, in the picture and in the camera's frame, each at the moment its row is read."""
        rows = self._of("rows", view)
        if not rows:
            vertices = self._posed(time)
            return (vertices, *self._pictured(vertices, view))
        readout = self._run(rows[-1], rows[-1].params, self.interval)
        first, last = self._posed(time - readout / 2), self._posed(time + readout / 2)
        vertices = 0.5 * (first + last)
        for _ in range(2):  # the row depends on the moment and the moment on the row
            p, _ = self._pictured(vertices, view)
            share = np.clip(p[:, 1:2] / self.rig.size[view, 1], 0.0, 1.0)
            vertices = (1.0 - share) * first + share * last
        return (vertices, *self._pictured(vertices, view))

    def _light(self, time: float) -> np.ndarray:
        """[V, 1 + lights] share of sky and lamps that reaches the vertices in the frame nearest to a time: the same
        for all views."""
        rulings = self._of("light")
        if not rulings:
            return np.ones((len(self.mesh.vertices), 1 + len(LIGHTS)))
        moment = round(time / self.interval)
        if moment in self._lit:
            return self._lit[moment]
        vertices = self._posed(moment * self.interval)
        normals, lit = vertex_normals(vertices, self.mesh.tris), np.ones((len(vertices), 1 + len(LIGHTS)))
        for ruling in rulings:
            lit = self._run(ruling, lit, vertices, normals, self.mesh.tris, ruling.params)
        if len(self._lit) < KEPT_MOMENTS:
            self._lit[moment] = lit
        return lit

    def _exposed(self, time: float, view: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """One moment: [h, w, 3] sRGB 0..1 premultiplied, [h, w] share covered by anything, and by the subject."""
        mesh, s = self.mesh, self.samples
        w, h = (int(n) for n in self.rig.size[view])
        vertices, p, _ = self._seen(time, view)
        index = rasterize(p, mesh.tris, w, h, s)[1]
        normals = vertex_normals(vertices, mesh.tris)
        texels, info, gloss, shiny = self._paint
        light = shade(
            index,
            p,
            vertices,
            normals,
            mesh.tris,
            mesh.uv,
            mesh.layer,
            texels,
            info,
            gloss,
            self._light(time),
            self.rig.centres[view],
            s,
            shiny,
            LIGHTS,
            POWERS,
            SKY,
            GROUND,
        )
        return averaged(light, index, len(self.actors[0].mesh.tris), s, SRGB)

    def shoot(self, frame: int, view: int) -> Shot:
        """The picture of one camera at one frame, with its truth.
        Depends on nothing but the scene, the frame and the view."""
        time = float(self.times[frame, view])
        shutter = self._of("shutter", view)
        moments = self._run(shutter[-1], shutter[-1].params, self.interval) if shutter else np.zeros(1)
        exposed = [self._exposed(time + dt, view) for dt in moments]
        color, cover, own = (
            (np.mean([e[k] for e in exposed], axis=0) for k in range(3)) if len(exposed) > 1 else exposed[0]
        )
        if len(exposed) > 1:  # light adds up, bytes do not
            color = encode(np.mean([decode(e[0]) for e in exposed], axis=0))
        depth, first_depth, normal, joints, joints3d = self._truth(time, frame, view)
        visible = joints[:, 2] > 0 if joints is not None else np.zeros(0, bool)
        camera = self.rig.world_to_camera[view]
        picture = Picture(
            frame,
            view,
            cover.astype(np.float32),
            first_depth,
            self.rig.centres[view],
            float(self.rig.intrinsics[view, 0, 0]),
            float(camera[2, 3]),
            lambda: self._rays(view),
            visible,
        )
        bytes_ = np.rint(255.0 * self._developed(color, picture)).astype(np.uint8)
        for ruling in self._of("file", view):
            bytes_ = self._run(ruling, bytes_, picture, ruling.params, self.seed)
        true_mask = np.rint(255.0 * own).astype(np.uint8)
        mask, found = true_mask, None if joints is None else np.column_stack([joints[:, :2], np.ones(len(joints))])
        for ruling in self._of("mask", view):
            mask = self._run(ruling, mask, picture, ruling.params, self.seed)
        for ruling in self._of("joints", view):
            found = None if found is None else self._run(ruling, found, picture, ruling.params, self.seed)
        return Shot(frame, view, bytes_, mask, found, true_mask, depth, normal, joints, joints3d)

    def _developed(self, color: np.ndarray, picture: Picture) -> np.ndarray:
        """SRGB 0..1 after optics and sensor; as it was where none of them is on."""
        phases = (*self._of("background"), *self._of("optics", picture.view), *self._of("sensor", picture.view))
        if not phases:
            return color
        light = decode(color)
        for ruling in phases:
            light = self._run(ruling, light, picture, ruling.params, self.seed)
        return encode(light)

    def _rays(self, view: int) -> np.ndarray:
        k, bend = self.rig.intrinsics[view], self.rig.distortion[view]
        wanted = (pixel_centres((int(self.rig.size[view, 0]), int(self.rig.size[view, 1]))) - k[:2, 2]) @ np.linalg.inv(
            k[:2, :2]
        ).T
        plane = wanted.copy()
        if bend.any():
            for _ in range(12):  # the fixed point of x = wanted - (distort(x) - x)
                plane = wanted - (distort(plane.reshape(-1, 2), bend).reshape(plane.shape) - plane)
        return np.concatenate([plane, np.ones_like(plane[..., :1])], axis=-1) @ self.rig.rotations[view]

    def _truth(
        self, time: float, frame: int, view: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray | None, np.ndarray | None]:
        """Depth of the subject, depth of the first surface, normals, joints in the picture and in the world."""
        w, h = (int(n) for n in self.rig.size[view])
        _, p, camera = self._seen(time, view)
        depth, index = rasterize(p, self.mesh.tris, w, h, 1)
        own = (index >= 0) & (index < len(self.actors[0].mesh.tris))
        normal = flat_normals(camera, self.mesh.tris, np.where(own, index, -1))
        first = np.where(index >= 0, depth, 0.0)
        joints3d = self.actors[0].joints(time)
        joints = None
        if joints3d is not None:
            uvz = self._pictured(joints3d, view)[0]
            column, row = np.floor(uvz[:, 0]).astype(np.int64), np.floor(uvz[:, 1]).astype(np.int64)
            inside = (uvz[:, 2] > 0) & (column >= 0) & (column < w) & (row >= 0) & (row < h)
            before = first[np.clip(row, 0, h - 1), np.clip(column, 0, w - 1)]
            # cloth and hair add up to 3 cm to the limb; what is in front by more than that is something else
            near = (before == 0) | (uvz[:, 2] - before <= 1.3 * self.actors[0].joint_radius() + 0.03)
            joints = np.column_stack([uvz[:, :2], inside & near])
        return np.where(own, depth, 0.0).astype(np.float32), first, normal, joints, joints3d
