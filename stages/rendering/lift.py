"""From pixel-aligned maps of one source view to 3D Gaussians in the world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeAlias

import numpy as np
import torch

from posegaussian.stages.compiling.compiled import compiled
from posegaussian.stages.geometry.tangent_frame import tangents
from posegaussian.stages.splatting.definition.scene import Camera, Gaussians
from posegaussian.storage.model.cameras import Rig, points_from_integer_centres

Values: TypeAlias = np.ndarray | torch.Tensor
Axis: TypeAlias = tuple[torch.Tensor, torch.Tensor, torch.Tensor]
Pose: TypeAlias = Sequence[Sequence[float]]
"""A matrix, row by row."""


class Places(NamedTuple):
    """Of a list of Gaussians, the pixels of the picture that they are of."""

    pixel: Values
    """[1, n] row times the picture's width, and column."""
    width: int
    """Of the picture, px."""


@dataclass(frozen=True, eq=False)
class GaussianMaps:
    """One frame of one source view: arrays as the archive holds them, or tensors, whose gradients are kept. A list of
    Gaussians is a map of one row that says which pixels they are of."""

    color: Values  # [h, w, 3] uint8, or a tensor of sRGB 0..1
    depth: Values  # [h, w] float32, metres, 0 = none
    scale: Values  # [3, h, w] float16, metres
    normal: Values  # [3, h, w] float16, camera axes
    opacity: Values  # [2, h, w] float16, face-on and grazing
    twist: Values | None = None  # [2, h, w] float16, cosine and sine of the turn about the normal; None: no turn
    shift: Values | None = None  # [2, h, w] float16, px right of and below the pixel's centre; None: none
    places: Places | None = None  # of a list, h = 1; None: each Gaussian is of the pixel where it is in the maps

    def listed(self) -> GaussianMaps:
        """Those Gaussians alone that have depth and opacity, or what is no number, as a list; of arrays, with a
        twist and a shift."""
        depth, width = np.asarray(self.depth), np.shape(self.depth)[1]
        rows, columns = np.nonzero(~(depth <= 0) & ~(np.asarray(self.opacity)[0] <= 0))
        scale, normal, opacity, twist, shift = (a[:, None, rows, columns] for a in self.channels())
        color, depth = np.asarray(self.color)[None, rows, columns], depth[None, rows, columns]
        places = Places((rows * width + columns).astype(np.int32)[None], width)
        return GaussianMaps(color, depth, scale, normal, opacity, twist, shift, places)

    def channels(self) -> tuple[np.ndarray, ...]:
        """Scale, normal, opacity, twist and shift, of arrays; the last two of one's own."""
        given = (np.asarray(a) for a in (self.scale, self.normal, self.opacity))
        return (*given, twist_of(self), shift_of(self))

    def spread(self, height: int) -> GaussianMaps:
        """A list of arrays as maps of a picture so many pixels high, 0 where there is no Gaussian."""
        assert self.places is not None, "these are maps"
        width = self.places.width
        rows, columns = np.divmod(np.asarray(self.places.pixel)[0], width)

        def spread(values: Values) -> np.ndarray:
            whole = np.zeros((*np.shape(values)[:-2], height, width), np.asarray(values).dtype)
            whole[..., rows, columns] = np.asarray(values)[..., 0, :]
            return whole

        scale, normal, opacity, twist, shift = (spread(a) for a in self.channels())
        color = np.moveaxis(spread(np.moveaxis(np.asarray(self.color), 2, 0)), 0, 2)
        return GaussianMaps(color, spread(self.depth), scale, normal, opacity, twist, shift)


def from_list(arrays: Sequence[np.ndarray], rig: Rig) -> GaussianMaps:
    """The Gaussians of one frame of a view that the archive holds as a list: [n, ...] in the order of
    `posegaussian.stages.rendering.sources.REFINED`, of cameras `rig`."""
    color, depth, *channels, pixel = arrays
    places = Places(pixel[None], int(rig.size[:, 0].max()))
    scale, normal, opacity, twist, shift = (a.T[:, None] for a in channels)
    return GaussianMaps(color[None], depth[None], scale, normal, opacity, twist, shift, places)


@dataclass(frozen=True, eq=False)
class Lifted:
    """The Gaussians of one source view: all but the opacity is the same for every target."""

    mean: torch.Tensor  # [N, 3]
    """World metres."""
    rotation: torch.Tensor  # [N, 3, 3]
    """Columns (tangent, tangent, normal), world axes."""
    scale: torch.Tensor  # [N, 3]
    """Metres."""
    faces: torch.Tensor  # [N, 2]
    """Opacity face-on and at grazing angle."""
    color: torch.Tensor  # [N, 3]
    """sRGB 0..1."""
    masked: int = 0
    """Pixels left out because their depth or opacity was not a finite number."""

    def seen_from(self, camera: Camera) -> Gaussians:
        """The Gaussians with the opacity they show to a camera.

        opacity = c face_on + (1 - c) grazing, c the cosine between the normal and the ray to the camera's centre. A
        surface turned away from the camera is its inner side: those Gaussians have opacity 0.
        """
        centre = camera.centre.tolist()
        ray = torch.stack([centre[i] - self.mean[:, i] for i in range(3)])  # [3, N]
        length = torch.sqrt(ray[0] ** 2 + ray[1] ** 2 + ray[2] ** 2).clamp(min=1e-12)
        n = self.rotation[:, :, 2]
        cosine = (n[:, 0] * ray[0] + n[:, 1] * ray[1] + n[:, 2] * ray[2]) / length
        opacity = cosine * self.faces[:, 0] + (1 - cosine) * self.faces[:, 1]
        return Gaussians(self.mean, self.rotation, self.scale, torch.where(cosine > 0, opacity, 0.0), self.color)

    def from_all_sides(self) -> Gaussians:
        """The Gaussians with their opacity face-on, whoever looks from wherever: what a splat file holds, and what a
        refined frame shows."""
        return Gaussians(self.mean, self.rotation, self.scale, self.faces[:, 0], self.color)


@dataclass(frozen=True, eq=False)
class Pixels:
    """Which entries of the maps of one source view make a Gaussian, and where their pixels look."""

    index: torch.Tensor  # [N]
    """Row times the maps' width, and column."""
    pixel: torch.Tensor  # [N]
    """Row times the picture's width, and column: of maps that are no list the same."""
    x: torch.Tensor  # [N]
    """Of the ray through the pixel's centre, or as far beside it as it is shifted, at unit depth, camera axes."""
    y: torch.Tensor  # [N]
    pitch: tuple[float, float, float]
    """Of x by a pixel to the right and by one down, of y by one down."""
    pose: Pose
    """World to camera, 4 x 4."""
    masked: int
    """Pixels left out because their depth or opacity was not a finite number."""

    @classmethod
    def of(
        cls,
        depth: torch.Tensor,
        face_on: torch.Tensor,
        intrinsics: np.ndarray,
        world_to_camera: np.ndarray,
        places: Places | None = None,
        shift: Values | None = None,
    ) -> Pixels:
        """Those with depth [h, w] m, finite and in front of the camera, and some opacity [h, w], of whatever dtype.
        intrinsics [3, 3] px in our pixel centres; world_to_camera [4, 4]; `places`: of a list; shift [2, h, w] px."""
        index = torch.nonzero((positive(depth) & positive(face_on)).reshape(-1))[:, 0]
        finite = torch.isfinite(depth.detach().reshape(-1)[index])
        # Not a number is in no relation to 0, and counted where the other of the two is there or is none either.
        masked = int((~finite).sum()) + _not_numbers(depth, face_on)
        index = index if finite.all() else index[finite]
        width = depth.shape[1] if places is None else places.width
        pixel = index if places is None else torch.as_tensor(places.pixel).to(index).reshape(-1)[index]
        rows, columns = pixel // width, pixel % width
        k, centre = intrinsics.tolist(), float(points_from_integer_centres(np.zeros(())))
        y = (rows.to(depth.dtype) + (centre - k[1][2])) / k[1][1]
        x = (columns.to(depth.dtype) + (centre - k[0][2]) - k[0][1] * y) / k[0][0]
        pitch = (1 / k[0][0], -k[0][1] / (k[0][0] * k[1][1]), 1 / k[1][1])
        centred = cls(index, pixel, x, y, pitch, world_to_camera.tolist(), masked)
        return centred if shift is None else centred._shifted(*centred.at(shift))

    def _shifted(self, right: torch.Tensor, down: torch.Tensor) -> Pixels:
        """Rays that pass so many px [N] beside where these do."""
        by_right, slant, by_down = self.pitch
        return replace(self, x=self.x + by_right * right + slant * down, y=self.y + by_down * down)

    def __len__(self) -> int:
        return len(self.x)

    def at(self, values: Values) -> torch.Tensor:
        """[C, N] channels of maps [C, h, w] at the pixels, in the dtype and on the device of the rays."""
        flat = torch.as_tensor(values).to(self.x.device).flatten(1)
        return flat.index_select(1, self.index).to(self.x.dtype)

    def colors(self, values: Values) -> torch.Tensor:
        """[N, 3] sRGB 0..1 of a picture [h, w, 3], uint8 or sRGB 0..1."""
        color = torch.as_tensor(values).to(self.x.device).flatten(0, 1).index_select(0, self.index)
        return color.to(self.x.dtype) / 255 if color.dtype == torch.uint8 else color.to(self.x.dtype)

    def lift(
        self,
        depth: torch.Tensor,
        normal: torch.Tensor,
        scale: torch.Tensor,
        faces: torch.Tensor,
        color: torch.Tensor,
        twist: torch.Tensor | None = None,
    ) -> Lifted:
        """Gaussians of values at the pixels: depth [N] m, normal [3, N] of any length in camera axes, scale [N, 3] m,
        faces [N, 2], color [N, 3], twist [2, N] of any length."""
        given = (self.x, self.y, depth, normal, *(() if twist is None else (twist,)))
        if all(a.device.type == "cpu" and not a.requires_grad for a in given):
            return Lifted(*self._placed(depth, normal, twist), scale, faces, color, self.masked)
        axis = _unit(*normal)
        mean = _to_world(
            self.pose, (self.x * depth - self.pose[0][3], self.y * depth - self.pose[1][3], depth - self.pose[2][3])
        )
        across = tangents(*axis) if twist is None else _turned(tangents(*axis), *twist)
        rotation = torch.stack([_to_world(self.pose, v) for v in (*across, axis)], dim=2)  # [N, 3 world, 3 axes]
        return Lifted(mean, rotation, scale, faces, color, self.masked)

    def _placed(
        self, depth: torch.Tensor, normal: torch.Tensor, twist: torch.Tensor | None
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Centres [N, 3] and axes [N, 3, 3] on the CPU, in one pass, several times as fast; the last bit may differ."""
        kind = depth.numpy().dtype
        turn = np.zeros((2, len(depth)), kind) if twist is None else twist.numpy()
        mean, rotation = np.empty((len(depth), 3), kind), np.empty((len(depth), 3, 3), kind)
        ends, pose = np.array([0, len(depth)]), np.array(self.pose, kind)[None, :3]
        place(depth.numpy(), normal.numpy(), turn, self.x.numpy(), self.y.numpy(), ends, pose, mean, rotation)
        return torch.from_numpy(mean), torch.from_numpy(rotation)


def lift(
    maps: GaussianMaps, intrinsics: np.ndarray, world_to_camera: np.ndarray, dtype: torch.dtype, device: torch.device
) -> Lifted:
    """One Gaussian for every pixel, or entry of a list, that has depth and opacity, differentiable in the maps.

    Position: depth times the ray through the pixel's centre, or so many px beside it as there is a shift. Orientation:
    the normal and the tangents that follow from it, turned by the twist where there is one. intrinsics [3, 3] px in our
    pixel centres; world_to_camera [4, 4]. Pixels whose depth is not finite, or whose opacity is no number, make no
    Gaussian and are counted; the rasterizer masks what else is not finite. Nothing but sums, products, quotients and
    square roots of single elements is taken, so the result does not depend on the number of threads.
    """
    depth, opacity = torch.as_tensor(maps.depth).to(device, dtype), torch.as_tensor(maps.opacity).to(device)
    pixels = Pixels.of(depth, opacity[0], intrinsics, world_to_camera, maps.places, maps.shift)
    (z,) = pixels.at(depth[None])
    return pixels.lift(
        z,
        pixels.at(maps.normal),
        pixels.at(maps.scale).T.contiguous(),
        pixels.at(opacity).T.contiguous(),
        pixels.colors(maps.color),
        None if maps.twist is None else pixels.at(maps.twist),
    )


def twist_of(maps: GaussianMaps) -> np.ndarray:
    """[2, h, w] float16 of one's own: the maps' twist; (1, 0), no turn, where they have none."""
    if maps.twist is not None:
        return np.array(maps.twist)
    twist = np.zeros((2, *np.shape(maps.depth)), np.float16)
    twist[0] = 1
    return twist


def shift_of(maps: GaussianMaps) -> np.ndarray:
    """[2, h, w] float16 of one's own: the maps' shift; 0 where they have none."""
    return np.zeros((2, *np.shape(maps.depth)), np.float16) if maps.shift is None else np.array(maps.shift)


def positive(values: torch.Tensor) -> torch.Tensor:
    """[h, w] bool: what is larger than 0. On the CPU NumPy compares float32 seven times as fast as torch."""
    if values.device.type != "cpu":
        return values > 0
    return torch.from_numpy((values.detach().float() if values.dtype == torch.float16 else values.detach()).numpy() > 0)


def _not_numbers(depth: torch.Tensor, face_on: torch.Tensor) -> int:
    """Pixels of which depth or opacity [h, w] is no number, and the other is not there to say that there is nothing."""
    depth, face_on = depth.detach(), face_on.detach()
    if not torch.isnan(depth.sum() + face_on.sum()):
        return 0
    lacking = torch.isnan(depth) | torch.isnan(face_on)
    return int((lacking & ~(depth <= 0) & ~(face_on <= 0)).sum())


def _turned(across: tuple[Axis, Axis], cosine: torch.Tensor, sine: torch.Tensor) -> tuple[Axis, Axis]:
    """Two tangents turned about the normal, from the first towards the second; where the turn has no length, as they
    are."""
    squared = cosine * cosine + sine * sine
    none = squared == 0
    length = torch.sqrt(torch.where(none, 1.0, squared))
    c, s = torch.where(none, 1.0, cosine / length), sine / length
    (ax, ay, az), (bx, by, bz) = across
    first = c * ax + s * bx, c * ay + s * by, c * az + s * bz
    return first, (c * bx - s * ax, c * by - s * ay, c * bz - s * az)


def _unit(x: torch.Tensor, y: torch.Tensor, z: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """The normal at unit length; one without a length faces the camera, and gets no gradient."""
    squared = x * x + y * y + z * z
    flat = squared == 0
    length = torch.sqrt(torch.where(flat, 1.0, squared))
    return x / length, y / length, torch.where(flat, -1.0, z / length)


def _to_world(pose: Pose, vector: Sequence[torch.Tensor]) -> torch.Tensor:
    """[N, 3] = R^T v for v 3 x [N], written out: a matrix product's rounding may depend on the number of threads."""
    return torch.stack(
        [pose[0][i] * vector[0] + pose[1][i] * vector[1] + pose[2][i] * vector[2] for i in range(3)], dim=1
    )


@compiled(error_model="numpy", inline="always")
def unit(x, y, z):  # type: ignore[no-untyped-def]
    """A normal at unit length, and its length; one without a length faces the camera."""
    length = np.sqrt(x * x + y * y + z * z)
    if length == 0:
        return np.float32(0), np.float32(0), np.float32(-1), length
    return x / length, y / length, z / length, length


@compiled(error_model="numpy", inline="always")
def turn(cosine, sine):  # type: ignore[no-untyped-def]
    """A turn at unit length, and its length; one without a length is none."""
    length = np.sqrt(cosine * cosine + sine * sine)
    if length == 0:
        return np.float32(1), np.float32(0), length
    return cosine / length, sine / length, length


@compiled(error_model="numpy")
def place(depth, normal, twist, x, y, starts, poses, mean, rotation):  # type: ignore[no-untyped-def]
    """Into mean [N, 3] and rotation [N, 3, 3] of Gaussians of several views' pixels, those of view v from starts[v] to
    starts[v + 1], poses [V, 3, 4]; others as `Pixels.lift` has them."""
    one = np.float32(1)
    for view in range(len(poses)):
        p = poses[view]
        for n in range(starts[view], starts[view + 1]):
            z = depth[n]
            px, py, pz = x[n] * z - p[0, 3], y[n] * z - p[1, 3], z - p[2, 3]
            nx, ny, nz, _ = unit(normal[0, n], normal[1, n], normal[2, n])
            c, s, _ = turn(twist[0, n], twist[1, n])
            k = one / (one - nz)
            xy = k * nx * ny
            ax, ay, az = one - k * nx * nx, -xy, nx  # the tangents that follow from the normal
            bx, by, bz = xy, k * ny * ny - one, -ny
            tx, ty, tz = c * ax + s * bx, c * ay + s * by, c * az + s * bz
            ux, uy, uz = c * bx - s * ax, c * by - s * ay, c * bz - s * az
            for i in range(3):
                right, down, ahead = p[0, i], p[1, i], p[2, i]
                mean[n, i] = right * px + down * py + ahead * pz
                rotation[n, i, 0] = right * tx + down * ty + ahead * tz
                rotation[n, i, 1] = right * ux + down * uy + ahead * uz
                rotation[n, i, 2] = right * nx + down * ny + ahead * nz
