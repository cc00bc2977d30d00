"""Steps that turn the cameras together with the Gaussians: what no turn of a camera explains is left to these."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from posegaussian.stages.imaging.small_turns import following, turned
from posegaussian.stages.refinement.steps.attributes import ViewGaussians
from posegaussian.stages.refinement.steps.loss import Filmed
from posegaussian.stages.refinement.steps.optimise import MEAN, NEWEST, RATES, SQUARE, HostWalk, move
from posegaussian.stages.splatting.definition.scene import Camera
from posegaussian.storage.model.cameras import Rig

STEPS = 40
"""Of every frame."""
BESIDE = RATES | {"scale": 0.03, "depth": 0.4, "shift": 0.0}
"""Rates of the Gaussians beside the cameras: all of a view's shifted alike would be its camera turned, and what turns
gain was measured with these."""
RATE = 0.1
"""Px by which a camera's first move turns its picture."""


class TurnedCameras:
    """Cameras that steps turn about their centres, by Adam; several walks may turn the same ones."""

    def __init__(self, rig: Rig) -> None:
        self.given = self.rig = rig
        self.focals = rig.intrinsics[:, 0, 0]
        self.pixels, self.mean, self.square = (np.zeros((3, len(rig)), np.float32) for _ in range(3))
        self.average = self.pixels.copy()
        self.count = 0

    def turn(self, slopes: np.ndarray, slower: float) -> None:
        """Against slopes [V, 3] by turns in the cameras' own axes, at a rate divided by `slower`; one that is not
        finite counts as 0."""
        self.count += 1
        rate, unbiased = np.float32(RATE / slower / (1 - MEAN**self.count)), np.float32(1 / (1 - SQUARE**self.count))
        by_pixel = np.ascontiguousarray((slopes.T / self.focals).astype(np.float32))
        move(self.pixels, by_pixel, self.mean, self.square, rate, unbiased)
        self.average += np.float32(NEWEST) * (self.pixels - self.average)
        self.rig = turned(self.given, self._turns(self.pixels))

    @property
    def reached(self) -> np.ndarray:
        """[V, 3] rad: the mean over the last pictures. Over as many steps, as for Gaussians, it would lag: two people
        like captures, off by 0.3 px, gain 0.07 and 0.09 dB at left-out views by these steps, and 0.01 and 0.00 so."""
        return self._turns(self.average)

    def _turns(self, pixels: np.ndarray) -> np.ndarray:
        return (pixels.astype(np.float64) / self.focals).T


class TurningWalk(HostWalk):
    """Steps that turn the cameras, too, of Gaussians that are bound to their own camera."""

    def __init__(
        self,
        gaussians: Mapping[int, ViewGaussians],
        filmed: Mapping[int, Filmed],
        order: Sequence[int],
        cameras: TurnedCameras,
    ) -> None:
        super().__init__(gaussians, filmed, order, BESIDE)
        self.order, self.cameras = order, cameras

    def _learn(self, picture: int, slower: float) -> None:
        view, given, rig = self.order[picture], self.pictures[picture].camera, self.cameras.rig
        self.gaussians.rays.poses[:] = rig.world_to_camera[list(self.gaussians.views), :3]
        gaussians = self._with_slopes(
            picture, Camera(given.intrinsics, rig.world_to_camera[view], given.width, given.height)
        )
        by_mean = gaussians.mean.grad
        if by_mean is not None:
            self.cameras.turn(self._by_turns(view, gaussians.mean.detach().numpy(), by_mean.numpy()), slower)
        self.adam.step(self.gaussians.slopes(gaussians), slower)

    def _by_turns(self, view: int, means: np.ndarray, by_mean: np.ndarray) -> np.ndarray:
        """[V, 3] slopes by turns of all cameras in their own axes, of slopes [N, 3] by the Gaussians' means [N, 3] in
        the picture of a view.

        A camera that turns by w about its centre c sees the world turned by w, x - c -> w x (x - c), and takes its own
        Gaussians along the other way. That these turn in place, too, is left out: they are small.
        """
        rig, starts = self.cameras.rig, self.gaussians.rays.starts
        places, slopes = means.astype(np.float64), by_mean.astype(np.float64)
        out = np.zeros((len(rig), 3))
        for k, v in enumerate(self.gaussians.views):
            own = slice(starts[k], starts[k + 1])
            out[v] -= np.cross(places[own] - rig.centres[v], slopes[own]).sum(axis=0)
        out[view] += np.cross(places - rig.centres[view], slopes).sum(axis=0)
        return np.einsum("vij,vj->vi", rig.rotations, out)


def turns_with_gaussians(
    rig: Rig, frames: Sequence[tuple[Mapping[int, ViewGaussians], Mapping[int, Filmed], Sequence[int]]]
) -> np.ndarray:
    """[V, 3] rad by which cameras, turned together with the Gaussians of some frames (each with pictures and their
    order), explain the pictures best, but for what follows a subject that is shifted, which pictures hardly tell; 0 of
    cameras without Gaussians, and without any frame."""
    cameras, out = TurnedCameras(rig), np.zeros((len(rig), 3))
    walks = [TurningWalk(*frame, cameras) for frame in frames]
    for _ in range(STEPS):
        for walk in walks:
            walk.step()
    if views := sorted({v for gaussians, _, _ in frames for v in gaussians}):
        together, turns = following(rig.subset(views)), cameras.reached[views].ravel()
        out[views] = (turns - together @ (together.T @ turns)).reshape(-1, 3)
    return out
