"""What speaks for the unit and the direction of poses: distances between cameras, where they look, and whether given
points land where they were seen."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Sequence
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import BeforeValidator, Field

from posegaussian.storage.importers.common import ImportOptions
from posegaussian.storage.model.cameras import distances
from posegaussian.storage.model.errors import CalibrationError, SourceError
from posegaussian.storage.model.plausible import APART

AWAY, TOWARDS = 60.0, 25.0
"""Degrees between a camera's axis and the common point beyond and below which a rig looks away or at it."""
PARALLEL = 20.0
"""Degrees between any two axes below which cameras stand side by side: where such axes meet says nothing, as they may
well spread a little."""
FAR_OFF, WORTH_SAYING = 0.02, 1e-3
"""Median distance of a point from where it was seen, over the longer side: what is refused, and what is worth a word.
Tangential coefficients in the other order, say, are harmless below."""
HALF = 0.1
"""Px by which the mean of all points' offsets may miss half a pixel and still be one."""


def _split(value: Any) -> Any:
    return tuple(p.strip() for p in value.split(",")) if isinstance(value, str) else value


class UnitOptions(ImportOptions):
    """Choices of layouts whose poses have a unit of their own."""

    scale: float | None = Field(None, gt=0, le=1e6, description="Metres in a unit of the file's poses.")
    distance: Annotated[tuple[str, str, float] | None, BeforeValidator(_split)] = Field(
        None, description="CAM_A,CAM_B,METRES: a measured distance between two cameras, in place of scale."
    )


class Seen(NamedTuple):
    """Points in one image."""

    camera: str
    intrinsics: np.ndarray
    """[3, 3] px, in the convention of `pixels`."""
    distortion: np.ndarray
    """[n] OpenCV order."""
    rotation: np.ndarray
    """[3, 3] world to camera."""
    translation: np.ndarray
    """[3] world to camera, in the unit of the points."""
    pixels: np.ndarray
    """[n, 2] px where the points were seen."""
    points: np.ndarray
    """[n, 3] in the world."""
    side: int
    """Longer side of the picture, px."""


def metres(options: UnitOptions, names: Sequence[str], centres: np.ndarray, what: str) -> tuple[float, str]:
    """(metres in a unit, the sentence on how that is known) of cameras at `centres` [V, 3], in the file's unit.

    Raises SourceError for options that contradict each other, and CalibrationError where nobody says the unit and one
    unit cannot be a metre.
    """
    if options.scale is not None and options.distance is not None:
        raise SourceError("options scale and distance both say the unit; give one of them")
    if options.scale is not None:
        return options.scale, f"unit: {options.scale:g} m, as the option scale says"
    if options.distance is not None:
        a, b, wanted = options.distance
        for n in (a, b):
            if n not in names:
                raise SourceError(f"option distance: there is no camera {n}; there are {', '.join(names)}")
        found = float(np.linalg.norm(centres[names.index(a)] - centres[names.index(b)]))
        if not (0 < wanted <= 1000 and np.isfinite(found) and found > 0):
            raise SourceError(
                f"option distance: {a} and {b} lie {found:g} units apart, which cannot be {wanted:g} m; name two"
                " cameras that stand apart and a distance of up to 1000 m"
            )
        return wanted / found, f"unit: {wanted / found:.6g} m, as {a} and {b} lie {wanted:g} m apart"
    apart = distances(centres)
    two = shlex.quote(f"distance={names[0]},{names[-1]},METRES")
    ask = f"{what} says no unit; say --option {two} or --option scale=METRES"
    if len(apart) and not APART[0] <= apart[-1] <= APART[1]:
        raise CalibrationError(
            f"cameras lie up to {apart[-1]:.4g} units apart; metres would be between {APART[0]:g} and {APART[1]:g}."
            f" {ask}"
        )
    return 1.0, f"unit: taken as metres, as cameras lie up to {apart[-1] if len(apart) else 0:.3g} units apart; {ask}"


def check_direction(names: Sequence[str], rotations: np.ndarray, centres: np.ndarray, direction: str) -> list[str]:
    """A sentence on where cameras look, world-to-camera rotations [V, 3, 3] and centres [V, 3].

    Raises CalibrationError where they look away from one another's scene, while the inverted poses look at one point (a
    file whose poses have the other direction), and where all look away from one point (axes of another convention).
    Cameras side by side show neither.
    """
    if len(names) < 3 or not (np.isfinite(rotations).all() and np.isfinite(centres).all()):
        return []
    off = off_axis(rotations, centres)
    translations = -np.einsum("vij,vj->vi", rotations, centres)
    inverted = off_axis(rotations.transpose(0, 2, 1), translations)
    if not off <= AWAY and inverted < TOWARDS and _turned(rotations.transpose(0, 2, 1)) >= PARALLEL:
        raise CalibrationError(
            f"read as {direction}, as the format has it, {_no_rig(off)}; inverted, all look at one point to"
            f" {inverted:.0f} degrees: the poses were written in the other direction. Invert every pose and write the"
            " file again"
        )
    if (turned := _turned(rotations)) < PARALLEL:
        return [f"direction: {direction}, as the format has it; all cameras look one way, to {turned:.0f} degrees"]
    if off >= 180 - TOWARDS:
        raise CalibrationError(
            "every camera looks straight away from one point, so none of them sees what another sees: y and z of the"
            " cameras' axes are probably those of the other convention (OpenCV: y down, z forward; OpenGL: y up, z"
            " backward)"
        )
    if off <= TOWARDS:
        either = " (inverted they would, too, so this alone does not tell)" if inverted <= TOWARDS else ""
        return [f"direction: {direction}; all cameras look at one point to {off:.0f} degrees{either}"]
    return [f"direction: {direction}, as the format has it; {_no_rig(off)}"]


def _no_rig(off: float) -> str:
    """What is odd about cameras that look `off` degrees past a common point, NaN where they stand in one place."""
    if np.isnan(off):
        return "all cameras stand in one place"
    return f"the cameras look past one another, at no common point ({off:.0f} degrees off)"


def _turned(rotations: np.ndarray) -> float:
    """The largest angle between the axes of two cameras, degrees."""
    axes = rotations[:, 2]
    return float(np.degrees(np.arccos(np.clip(axes @ axes.T, -1, 1).min())))


def off_axis(rotations: np.ndarray, centres: np.ndarray) -> float:
    """Degrees between the axes of cameras and the point nearest to all axes, in the median; NaN where all stand in one
    place."""
    axes = rotations[:, 2]
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    spread = distances(centres)
    if not spread[-1] > 1e-6 * max(1e-12, float(np.abs(centres).max())):
        return float("nan")
    point = np.linalg.lstsq(across.sum(axis=0), np.einsum("vij,vj->i", across, centres), rcond=1e-9)[0]
    to = point - centres
    length = np.maximum(np.linalg.norm(to, axis=1), 1e-3 * spread[-1])
    return float(np.median(np.degrees(np.arccos(np.clip(np.einsum("vi,vi->v", axes, to) / length, -1, 1)))))


def check_points(seen: Iterable[Seen], direction: str) -> list[str]:
    """A sentence on how far given points land from where images saw them.

    Raises CalibrationError, naming the worst camera, where they do not fit: poses of the other direction, distortion in
    another order, or a camera of another size.
    """
    offsets: dict[str, list[np.ndarray]] = {}
    sides: dict[str, int] = {}
    for s in seen:
        offsets.setdefault(s.camera, []).append(_offsets(s))
        sides[s.camera] = s.side
    if not offsets:
        return []
    found = {n: np.concatenate(o) for n, o in offsets.items()}
    middle = {n: float(np.median(np.linalg.norm(o, axis=1))) for n, o in found.items()}
    worst = max(middle, key=lambda n: middle[n] / sides[n])
    everything = np.concatenate(list(found.values()))
    if not middle[worst] <= FAR_OFF * sides[worst]:
        raise CalibrationError(
            f"camera {worst}: the file's points land {middle[worst]:.0f} px from where its images saw them, in the"
            f" median of {len(found[worst])}; at most {FAR_OFF * sides[worst]:.0f} px are plausible. Are the poses"
            f" {direction}, and intrinsics and distortion those of this camera and size?"
        )
    notes = [
        f"points: {len(everything)} observations land {np.median(list(middle.values())):.2f} px from where they were"
        f" seen, camera {worst} {middle[worst]:.2f} px"
        + (
            "; that is much: are intrinsics and distortion right?"
            if middle[worst] > WORTH_SAYING * sides[worst]
            else ""
        )
    ]
    near = everything[np.linalg.norm(everything, axis=1) < 3]
    mean, error = near.mean(axis=0), near.std(axis=0) / np.sqrt(max(1, len(near)))
    if len(near) > 20 and (np.abs(np.abs(mean) - 0.5) < HALF).all() and (error < HALF / 2).all():
        notes.append(
            f"points land ({mean[0]:+.2f}, {mean[1]:+.2f}) px beside where they were seen, on average: principal points"
            " have another pixel centre than the points; the option pixel_center=integer moves them by half a pixel"
        )
    return notes


def _offsets(s: Seen) -> np.ndarray:
    """[n, 2] px from where a point was seen to where it lands; very far for one behind the camera."""
    import cv2

    local = s.points @ s.rotation.T + s.translation
    ahead = local[:, 2] > 0
    landed = np.full((len(local), 2), 1e6)
    if ahead.any():
        place = local[ahead]
        landed[ahead] = cv2.projectPoints(place, np.zeros(3), np.zeros(3), s.intrinsics, s.distortion)[0].reshape(-1, 2)
    return np.nan_to_num(np.clip(landed, -1e6, 1e6), nan=1e6) - s.pixels
