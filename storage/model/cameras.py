"""Cameras as data, and the only place where half a pixel is added or taken away.

Convention of the whole project: OpenCV axes (x right, y down, z forward), x_cam = R X + t, metres; the centre of the
top-left pixel is (0.5, 0.5), so a picture of width w spans [0, w]. OpenCV, and nearly every calibration file, puts
that centre at (0, 0) instead.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from posegaussian.storage.model.errors import CalibrationError, ConfigError
from posegaussian.storage.model.plausible import check_camera, check_place
from posegaussian.storage.model.spec import digest

PIXEL_CENTRE = 0.5
"""Coordinate of the centre of pixel 0, px."""

INTRINSICS_AXES, POSE_AXES = ("intrinsics_row", "intrinsics_column"), ("pose_row", "pose_column")
"""Names of the matrices' axes in an archive: 3 and 4 long, so they are not called alike."""


def must_be_cameras(setting: str, named: Iterable[str], names: Sequence[str], sequence: str) -> None:
    """Raise ConfigError for the first camera that a setting names and a sequence does not have."""
    for name in named:
        if name not in names:
            raise ConfigError(f"{setting}: sequence {sequence} has no camera {name!r}; it has {', '.join(names)}")


def from_integer_centres(intrinsics: np.ndarray) -> np.ndarray:
    """Intrinsics [..., 3, 3] of OpenCV's integer-centre convention -> ours (principal point + 0.5 px)."""
    out = np.array(intrinsics, dtype=np.float64)
    out[..., :2, 2] += PIXEL_CENTRE
    return out


def to_integer_centres(intrinsics: np.ndarray) -> np.ndarray:
    """Our intrinsics [..., 3, 3] -> OpenCV's integer-centre convention (principal point - 0.5 px)."""
    out = np.array(intrinsics, dtype=np.float64)
    out[..., :2, 2] -= PIXEL_CENTRE
    return out


def points_from_integer_centres(points: np.ndarray) -> np.ndarray:
    """Pixel coordinates [..., 2] of the integer-centre convention -> ours."""
    return np.asarray(points, dtype=np.float64) + PIXEL_CENTRE


def points_to_integer_centres(points: np.ndarray) -> np.ndarray:
    """Our pixel coordinates [..., 2] -> the integer-centre convention, as `cv2.remap` maps want them."""
    return np.asarray(points, dtype=np.float64) - PIXEL_CENTRE


def camera_centre(world_to_camera: np.ndarray) -> np.ndarray:
    """[3] centre in the world, metres, of a camera [4, 4]: -R^T t."""
    return np.asarray(-world_to_camera[:3, :3].T @ world_to_camera[:3, 3])


def distances(places: np.ndarray) -> np.ndarray:
    """Distances between all pairs of places [n, 3], ascending; of many places those of every k-th."""
    some = places[:: max(1, len(places) // 500)]
    a, b = np.triu_indices(len(some), 1)
    with np.errstate(over="ignore", invalid="ignore"):
        return np.sort(np.linalg.norm(some[a] - some[b], axis=1))


@dataclass(frozen=True, eq=False)
class Rig:
    """V calibrated cameras of one sequence."""

    names: tuple[str, ...]
    """Unique camera names, in the order of every `view` axis."""
    intrinsics: np.ndarray
    """[V, 3, 3] px, our pixel centres."""
    distortion: np.ndarray
    """[V, 8] OpenCV k1 k2 p1 p2 k3 k4 k5 k6; zero where the model is shorter."""
    world_to_camera: np.ndarray
    """[V, 4, 4] rigid, metres."""
    size: np.ndarray
    """[V, 2] int (width, height) in px of the picture the intrinsics refer to."""

    def __len__(self) -> int:
        return len(self.names)

    def index(self, name: str) -> int:
        """Index of a camera; CalibrationError names the known ones."""
        if name not in self.names:
            raise CalibrationError(f"no camera named {name!r}; the rig has {', '.join(self.names)}")
        return self.names.index(name)

    def subset(self, views: Sequence[int]) -> Rig:
        """The rig of the given views, in the given order."""
        v = list(views)
        return Rig(
            tuple(self.names[i] for i in v),
            self.intrinsics[v],
            self.distortion[v],
            self.world_to_camera[v],
            self.size[v],
        )

    @property
    def rotations(self) -> np.ndarray:
        """[V, 3, 3] world to camera."""
        return self.world_to_camera[:, :3, :3]

    @property
    def centres(self) -> np.ndarray:
        """[V, 3] camera centres in the world, metres: `camera_centre` of all at once."""
        return -np.einsum("vji,vj->vi", self.rotations, self.world_to_camera[:, :3, 3])

    @property
    def digest(self) -> str:
        """Content digest: equal cameras, equal digest."""
        return digest([list(self.names), self.intrinsics, self.distortion, self.world_to_camera, self.size])

    def check(self) -> None:
        """Raise CalibrationError for names that repeat and for cameras that are not finite, rigid, positive or
        plausible.

        A rotation is accepted when R R^T differs from the identity by at most 1e-3 (text files round to few digits).
        """
        for name in self.names:
            if self.names.count(name) > 1:
                raise CalibrationError(
                    f"camera name {name!r} occurs {self.names.count(name)} times; names must be unique"
                )
        for v, name in enumerate(self.names):
            for label in ("intrinsics", "distortion", "world_to_camera"):
                values = getattr(self, label)[v]
                if not np.isfinite(values).all():
                    raise CalibrationError(
                        f"camera {name}: {label} holds {values[~np.isfinite(values)][0]};"
                        " calibrate again or leave the camera out"
                    )
            fx, fy = self.intrinsics[v, 0, 0], self.intrinsics[v, 1, 1]
            if fx <= 0 or fy <= 0:
                raise CalibrationError(f"camera {name}: focal lengths ({fx:g}, {fy:g}) px must be positive")
            check_camera(name, self.intrinsics[v], self.distortion[v], self.size[v])
            r = self.rotations[v]
            error = np.abs(r @ r.T - np.eye(3)).max()
            if error <= 1e-3 and np.linalg.det(r) < 0:
                raise CalibrationError(
                    f"camera {name}: the rotation is a mirror image (determinant -1);"
                    " one of its axes has the wrong sign"
                )
            if error > 1e-3:
                raise CalibrationError(f"camera {name}: the rotation is off a rigid one by {error:.2g} (bound 1e-3)")
            if not np.array_equal(self.world_to_camera[v, 3], [0, 0, 0, 1]):
                raise CalibrationError(
                    f"camera {name}: the last row of world_to_camera is {self.world_to_camera[v, 3].tolist()}, a rigid"
                    " motion's is [0, 0, 0, 1]"
                )
        middle, apart = self.centres.mean(axis=0), distances(self.centres)
        for name, pose in zip(self.names, self.world_to_camera, strict=True):
            check_place(name, pose[:3, 3], middle, float(apart[-1]) if len(apart) else 0.0)


def rotation_matrix(vector: np.ndarray) -> np.ndarray:
    """[3, 3] of a Rodrigues vector [3]: exp of its cross-product matrix (Rodrigues' formula)."""
    angle = float(np.linalg.norm(vector))
    if angle < 1e-300:
        return np.eye(3)
    x, y, z = np.asarray(vector, dtype=np.float64) / angle
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * (k @ k)


def rigid(rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
    """[4, 4] world_to_camera from R [3, 3] (projected onto the nearest rotation) and t [3], metres."""
    u, _, vt = np.linalg.svd(np.asarray(rotation, dtype=np.float64))
    out = np.eye(4)
    out[:3, :3] = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    out[:3, 3] = np.asarray(translation, dtype=np.float64).reshape(3)
    return out


@dataclass(frozen=True, eq=False)
class CameraPath:
    """C target cameras over F frames: where pictures are rendered from."""

    kind: str
    """between, held_out, orbit, arc, still, sway or file."""
    names: tuple[str, ...]
    """[C] camera names, used for folders and metrics."""
    intrinsics: np.ndarray
    """[F, C, 3, 3] px, our pixel centres."""
    world_to_camera: np.ndarray
    """[F, C, 4, 4] rigid, metres."""
    size: np.ndarray
    """[C, 2] int (width, height) px; arrays are padded to the largest."""
    served: np.ndarray
    """[F, C] bool: whether the camera serves that frame."""
    text: str = ""
    """What asked for the path, as sentences name it."""

    @property
    def name(self) -> str:
        """`<kind>-<8 hex of its cameras>`, the folder of its pictures in the archive.

        Cameras that stand still are hashed once, so that a sequence that grows keeps the pictures it has.
        """
        moving = (self.intrinsics, self.world_to_camera, self.served)
        still = len(self.served) > 0 and all(bool((a == a[:1]).all()) for a in moving)
        body = [list(self.names), self.size, *(a[:1] if still else a for a in moving)]
        return f"{self.kind}-{digest(body)[:8]}"

    def slice(self, frames: slice) -> CameraPath:
        """The same cameras over some of the frames."""
        moving = {n: getattr(self, n)[frames] for n in ("intrinsics", "world_to_camera", "served")}
        return replace(self, **moving)
