"""From what calibration files hold to a checked rig in our pixel centres."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from posegaussian.storage.files.names import check_camera_names
from posegaussian.storage.model.cameras import (
    Rig,
    camera_centre,
    distances,
    from_integer_centres,
    rigid,
    rotation_matrix,
)
from posegaussian.storage.model.errors import CalibrationError
from posegaussian.storage.model.plausible import check_rotation_vector, check_size, smaller_unit, unit_of

DISTORTION = 8
"""Coefficients a rig holds: k1 k2 p1 p2 k3 k4 k5 k6."""
_FAR = 100.0
"""Metres between cameras above which the translations are probably not in metres."""
_NEAR = 0.05
"""Metres between the cameras that are farthest apart below which they probably are not either: pictures of a person
metres away would all be one."""
MOST_SKEW = 0.5
"""Px by which a matrix's skew may move the edge of a picture and be left out."""
_ROUNDED = 1e-6
"""Skew over fx that is what rounding leaves."""
_OTHER_SIZE = 1.6
"""Principal point over the middle of the picture, in both axes, from which the intrinsics are for another size."""
_OTHER_THAN_STATED = 1.8
"""The same where the file states the size: below it pictures were cut, as far as half or twice the size is off by."""


class RawCamera(NamedTuple):
    """One camera as a file gives it."""

    name: str
    intrinsics: np.ndarray
    """[3, 3] px."""
    distortion: np.ndarray
    """[n] OpenCV order."""
    rotation: np.ndarray
    """[3] Rodrigues vector or [3, 3], world to camera."""
    translation: np.ndarray
    """[3] metres."""
    size: tuple[int, int] | None
    """(width, height) px; None: as captured."""


def numbers(value: Any, camera: str, label: str, shapes: Sequence[tuple[int, ...]]) -> np.ndarray:
    """The value as float64 in the first shape that fits; (-1,) takes any list. Raises CalibrationError."""
    try:
        out = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise CalibrationError(f"camera {camera}: {label} {value!r} is not made of numbers") from None
    for shape in shapes:
        if shape == (-1,) or out.size == np.prod(shape):
            return out.reshape(shape)
    raise CalibrationError(
        f"camera {camera}: {label} has {out.size} numbers, expected {' or '.join(str(int(np.prod(s))) for s in shapes)}"
    )


def whole_size(value: Any, camera: str) -> tuple[int, int]:
    """(width, height) px of two whole numbers; plausible ones are checked later. Raises CalibrationError."""
    size = numbers(value, camera, "picture size", [(2,)])
    if not (np.isfinite(size).all() and (size == np.round(size)).all() and (np.abs(size) < 2**31).all()):
        raise CalibrationError(f"camera {camera}: picture size {size.tolist()} px must be two whole numbers")
    return int(size[0]), int(size[1])


def raw_centre(camera: RawCamera) -> np.ndarray:
    """[3] a camera's place in the world, in the unit of its translation; not finite where its numbers are not."""
    with np.errstate(over="ignore", invalid="ignore"):
        turn = rotation_matrix(camera.rotation) if camera.rotation.size == 3 else camera.rotation
        return camera_centre(np.column_stack([turn, np.ravel(camera.translation)]))


def build_rig(cameras: Sequence[RawCamera], sizes: Sequence[tuple[int, int]], half: bool) -> Rig:
    """The checked rig of cameras in the integer-centre convention, or in ours with `half`.

    `sizes` are the captured sizes, used where a file gives none. Raises CalibrationError, naming the camera, for values
    that are not finite, rotations that are not rigid, skew that shows, and distortion beyond eight coefficients.
    """
    check_camera_names(c.name for c in cameras)
    for c, captured in zip(cameras, sizes, strict=True):
        check_size(c.name, *(c.size or captured))
        _check_model(c, c.size or captured)
        if c.rotation.size == 3 and np.isfinite(c.rotation).all():
            check_rotation_vector(c.name, c.rotation)
    intrinsics = np.stack([c.intrinsics for c in cameras])
    distortion = np.zeros((len(cameras), DISTORTION))
    world_to_camera = np.tile(np.eye(4), (len(cameras), 1, 1))
    for v, c in enumerate(cameras):
        distortion[v, : min(DISTORTION, c.distortion.size)] = c.distortion[:DISTORTION]
        world_to_camera[v, :3, :3] = rotation_matrix(c.rotation) if c.rotation.size == 3 else c.rotation
        world_to_camera[v, :3, 3] = c.translation
    size = np.array([c.size or s for c, s in zip(cameras, sizes, strict=True)], dtype=np.int64)
    names = tuple(c.name for c in cameras)
    as_read = Rig(names, intrinsics if half else from_integer_centres(intrinsics), distortion, world_to_camera, size)
    as_read.check()
    exact = np.stack([rigid(m[:3, :3], m[:3, 3]) for m in world_to_camera])
    return Rig(names, as_read.intrinsics, distortion, exact, size)


def moved_by_skew(intrinsics: np.ndarray, size: Sequence[int] | np.ndarray) -> float:
    """Px by which the skew of intrinsics [3, 3] moves the edge of pictures of (width, height) px."""
    return float(abs(intrinsics[0, 1] / intrinsics[1, 1]) * max(size) / 2)


def without_skew(rig: Rig) -> tuple[Rig, list[str]]:
    """(the rig without the little skew that `build_rig` lets pass, a sentence on it where it is more than rounding)."""
    skew = np.abs(rig.intrinsics[:, 0, 1])
    of = np.flatnonzero(skew > _ROUNDED * rig.intrinsics[:, 0, 0])
    moved = max((moved_by_skew(rig.intrinsics[v], rig.size[v]) for v in of), default=0.0)
    names = ", ".join(rig.names[v] for v in of)
    intrinsics = rig.intrinsics.copy()
    intrinsics[:, 0, 1] = 0
    said = [f"skew of {names} is left out: it moves a picture's edge by up to {moved:.2g} px"] if len(of) else []
    return replace(rig, intrinsics=intrinsics), said


def _check_model(c: RawCamera, size: Sequence[int]) -> None:
    k = c.intrinsics
    if np.isfinite(k).all() and (not np.array_equal(k[2], [0, 0, 1]) or k[1, 0] != 0):
        raise CalibrationError(
            f"camera {c.name}: intrinsics must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], got {k.tolist()}"
        )
    if k[1, 1] and (moved := moved_by_skew(k, size)) > MOST_SKEW:
        raise CalibrationError(
            f"camera {c.name}: skew {k[0, 1]:g} px must be 0, or move the picture's edge by at most {MOST_SKEW:g} px,"
            f" where it moves it by {moved:.1f} px; calibrate without skew"
        )
    if np.any(c.distortion[DISTORTION:]):
        raise CalibrationError(
            f"camera {c.name}: {c.distortion.size} distortion coefficients, only the first {DISTORTION} (k1 k2 p1 p2 k3"
            " k4 k5 k6) are read"
        )


def check_principal_point(
    where: str, intrinsics: np.ndarray, stated: tuple[int, int] | None, captured: tuple[int, int]
) -> None:
    """Raise CalibrationError for intrinsics [3, 3] px that are for pictures of another size (width, height) px than the
    file's `stated` one; where it states none, than the `captured` one.

    A file that states the size may be of pictures that were cut beside their principal point, which is doubted
    (`of_another_size`) and taken; only what looks like half or twice of it is not.
    """
    size = stated or captured
    if of_another_size(intrinsics, size, _OTHER_SIZE if stated is None else _OTHER_THAN_STATED):
        raise CalibrationError(
            f"{where}: the principal point {intrinsics[:2, 2].tolist()} px is not near the middle of"
            f" {size[0]}x{size[1]} px; the intrinsics are for pictures of another size, so scale them or the"
            " pictures"
        )


def of_another_size(intrinsics: np.ndarray, size: Sequence[int] | np.ndarray, times: float = _OTHER_SIZE) -> bool:
    """Whether the principal point of intrinsics [3, 3] px says that they are for pictures of another size than (width,
    height) px, that many times as large or small."""
    with np.errstate(invalid="ignore"):
        halves = intrinsics[[0, 1], 2] / (np.array(size) / 2)
    return bool((halves > times).all() or (halves < 1 / times).all())


def rig_notes(rig: Rig) -> list[str]:
    """Sentences about a rig: how far its cameras are apart; that there is one only, or that they are improbably far or
    near."""
    notes = []
    apart = distances(rig.centres)
    if len(apart):
        notes.append(f"cameras lie {apart[0]:.3g} to {apart[-1]:.3g} m apart")
    else:
        notes.append("one camera only: depth is a relief from its mask, or your own depth maps")
    far = np.ptp(rig.centres, axis=0).max()
    if far > _FAR:
        unit = unit_of(float(apart[-1])) or "metres?"
        notes.append(f"cameras lie {apart[-1]:.0f} m apart where translations are read as metres; are they in {unit}")
    elif len(apart) and apart[-1] < _NEAR:
        unit = smaller_unit(float(apart[-1])) or "they were another unit?"
        notes.append(f"cameras lie {apart[-1]:.2g} m apart at most; were translations in metres read as if {unit}")
    return notes
