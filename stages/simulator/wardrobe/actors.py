"""Who and what stands in a scene: a mesh, and where its vertices and joints are at a time."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from posegaussian.stages.simulator.render.mesh import Mesh, skin
from posegaussian.stages.simulator.subjects.bodies import load_body
from posegaussian.stages.simulator.subjects.motion import turn
from posegaussian.stages.simulator.subjects.motions import bones_at
from posegaussian.stages.simulator.subjects.skeleton import CARRIERS
from posegaussian.stages.simulator.wardrobe.description import NOTHING, Extras
from posegaussian.stages.simulator.wardrobe.garments import dressed


class Actor(Protocol):
    """Anything that may be filmed."""

    mesh: Mesh

    def vertices(self, time: float) -> np.ndarray:
        """[V, 3] in the world, metres."""

    def joints(self, time: float) -> np.ndarray | None:
        """[17, 3] COCO-17 in the world, metres; None where there are none."""

    def joint_radius(self) -> np.ndarray:
        """[17] metres from a joint to the nearest surface of its limb."""


class Performer:
    """A baked, dressed person who does something."""

    def __init__(
        self,
        subject: str,
        outfit: str,
        motion: str,
        speed: float,
        phase: float,
        style: np.ndarray,
        heading: float = 0.0,
        position: tuple[float, float] = (0.0, 0.0),
        velocity: tuple[float, float] = (0.0, 0.0),
        extras: Extras = NOTHING,
    ) -> None:
        self.body, self.mesh = load_body(subject), dressed(subject, outfit, extras)
        self._motion, self._speed, self._phase, self._style = motion, speed, phase, style
        self._place = np.eye(4)
        self._place[:3, :3] = turn("z", math.radians(heading))
        self._place[:2, 3] = position
        self._velocity = np.array(velocity)

    def _bones(self, time: float) -> np.ndarray:
        place = self._place.copy()
        place[:2, 3] += self._velocity * time
        return place @ bones_at(self.body, self._motion, self._phase + self._speed * time, self._style)

    def vertices(self, time: float) -> np.ndarray:
        """[V, 3] in the world, metres."""
        return skin(self.mesh.vertices, self.mesh.bones, self.mesh.weights, self._bones(time))

    def joints(self, time: float) -> np.ndarray:
        """[17, 3] COCO-17 in the world, metres: exact, they turn with their bones."""
        m = self._bones(time)[CARRIERS]
        return np.einsum("jab,jb->ja", m[:, :3, :3], self.body.joints) + m[:, :3, 3]

    def joint_radius(self) -> np.ndarray:
        """[17] metres."""
        return self.body.joint_radius


@dataclass
class Still:
    """A mesh that stands still, or turns about the vertical axis by so many degrees a second."""

    mesh: Mesh
    degrees: float = 0.0

    def vertices(self, time: float) -> np.ndarray:
        """[V, 3] in the world, metres."""
        return (
            self.mesh.vertices @ turn("z", math.radians(self.degrees * time)).T if self.degrees else self.mesh.vertices
        )

    def joints(self, time: float) -> None:
        """Nobody knows the joints of a scan."""

    def joint_radius(self) -> np.ndarray:
        """There are none."""
        return np.zeros(0)
