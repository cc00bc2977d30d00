"""What a calibrated number can be, and what it probably is where it cannot: cameras, joints, times and rates in one
place.

The bounds are wide: whatever is refused here is of another unit, of another picture or no measurement, and would cost
hours before it shows as an empty picture. Raised sentences name the thing, the number, the bound and what to look at.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from posegaussian.storage.model.errors import CalibrationError, SourceError

LONGEST_SIDE = 32768
"""Px of a picture's side."""
LARGEST_PICTURE = 2**26
"""Px of a picture: a header of a few bytes may promise what no memory holds."""
FOCAL = (0.05, 100.0)
"""Focal length over the longer side of the picture: 168 degrees to a third of a degree."""
ASPECT = 5.0
"""One focal length over the other, at most."""
OFF_CENTRE = 2.0
"""How far from the middle of the picture the principal point may lie, over the longer side."""
RADIAL, TANGENTIAL = 1000.0, 10.0
"""Distortion coefficients, of normalised coordinates: k1 to k6, and p1 and p2."""
APART = (0.2, 20.0)
"""Metres between which the largest distance of two cameras of a rig lies, unless the user says a unit."""
UNITS = {"centimetres": 1e-2, "millimetres": 1e-3}
"""Metres in a unit that calibrations are written in."""
FARTHEST = 1000.0
"""Metres from the origin at which a camera or a joint may lie."""
TURN = 4 * np.pi
"""Radians of a rotation vector; a whole turn is half of it."""
FARTHEST_PIXEL = 100_000.0
"""Px from the picture's corner at which a joint or a box may lie: three times the largest picture."""
MOST_SCORE = 100.0
"""A joint's confidence; above 1 it counts as 1."""
PERSON = (0.05, 10.0)
"""Metres that the joints of one person reach, in the median over frames."""
FEWEST = 6
"""Joints of a frame that tell a person's size."""
RATE = (0.01, 10_000.0)
"""Frames a second."""
LATEST = 1e11
"""Seconds of a frame's time; a clock that counts from 1970 is at 2e9."""


def check_size(name: str, width: float, height: float) -> None:
    """Raise CalibrationError for a picture size that no picture has."""
    if not (
        1 <= width <= LONGEST_SIDE and 1 <= height <= LONGEST_SIDE and width == int(width) and height == int(height)
    ):
        raise CalibrationError(
            f"camera {name}: picture size ({width:g}, {height:g}) px must be two whole numbers from 1 to "
            f"{LONGEST_SIDE}; is it the width and height in pixels?"
        )


def check_picture(where: str, width: int, height: int) -> None:
    """Raise SourceError for a picture or video whose header promises more px than are read."""
    if not (0 < width <= LONGEST_SIDE and 0 < height <= LONGEST_SIDE and width * height <= LARGEST_PICTURE):
        raise SourceError(
            f"cannot read {where}: it says it is {width}x{height} px; at most {LONGEST_SIDE} px a side and "
            f"{LARGEST_PICTURE} px in all are read"
        )


def check_camera(name: str, intrinsics: np.ndarray, distortion: np.ndarray, size: np.ndarray) -> None:
    """Raise CalibrationError for finite numbers of one camera that cannot be.

    intrinsics [3, 3] px, distortion [8], size [2] px.
    """
    width, height = (float(s) for s in size)
    check_size(name, width, height)
    side = max(width, height)
    for label, focal in (("fx", float(intrinsics[0, 0])), ("fy", float(intrinsics[1, 1]))):
        if not FOCAL[0] * side <= focal <= FOCAL[1] * side:
            why = (
                "is it in millimetres, or in widths of the picture? Pixels are expected"
                if focal < FOCAL[0] * side
                else "is it in pixels?"
            )
            raise CalibrationError(
                f"camera {name}: focal length {label} = {focal:g} px is beyond {FOCAL[0] * side:g} to "
                f"{FOCAL[1] * side:g} px for pictures of {width:g}x{height:g} px; {why}"
            )
    if not 1 / ASPECT <= intrinsics[0, 0] / intrinsics[1, 1] <= ASPECT:
        raise CalibrationError(
            f"camera {name}: focal lengths fx = {intrinsics[0, 0]:g} and fy = {intrinsics[1, 1]:g} px differ more "
            f"than {ASPECT:g} times; is one of them in another unit?"
        )
    for label, at, extent in (("cx", float(intrinsics[0, 2]), width), ("cy", float(intrinsics[1, 2]), height)):
        if not abs(at - extent / 2) <= OFF_CENTRE * side:
            raise CalibrationError(
                f"camera {name}: principal point {label} = {at:g} px lies more than {OFF_CENTRE * side:g} px from "
                f"the middle of pictures of {width:g}x{height:g} px; is it for pictures of another size?"
            )
    for at, value in enumerate(distortion):
        bound = TANGENTIAL if at in (2, 3) else RADIAL
        if not abs(value) <= bound:
            raise CalibrationError(
                f"camera {name}: distortion {['k1', 'k2', 'p1', 'p2', 'k3', 'k4', 'k5', 'k6'][at]} = {value:g} is "
                f"beyond {bound:g}; coefficients of OpenCV's model are expected, of coordinates without unit (not "
                "pixels)"
            )


def check_place(name: str, translation: np.ndarray, middle: np.ndarray, apart: float) -> None:
    """Raise CalibrationError for a finite translation [3] m of a camera whose rig has its `middle` [3] m there and
    cameras up to `apart` m from one another, 0 of one camera."""
    if (far := float(np.abs(translation).max())) <= FARTHEST:
        return
    if APART[0] <= apart <= APART[1]:
        x, y, z = (f"{n:g}" for n in np.round(middle))
        why = (
            f"cameras lie up to {apart:.3g} m apart, so the unit is right and the origin far off: subtract"
            f" ({x}, {y}, {z}) m from every camera's place (-R^T t), and from all else that is given in the world"
        )
    else:
        unit = unit_of(apart) or "millimetres? Divide it by 1000, or move the origin to the scene"
        why = f"is it in {unit}"
    raise CalibrationError(
        f"camera {name}: its translation holds {far:g} m, at most {FARTHEST:g} m are plausible; {why}"
    )


def unit_of(apart: float) -> str:
    """What follows "in": the units in which cameras that lie `apart` m from one another, as read, would lie as those of
    a rig do, and what to multiply them by; empty where there is none."""
    units, lengths, factors = _fitting(apart, UNITS)
    if not units:
        return ""
    return (
        f"{' or in '.join(units)}? Then cameras lie up to {lengths} apart: multiply translations by {factors}, or set"
        " the option scale where the layout has it"
    )


def smaller_unit(apart: float) -> str:
    """What follows "as if": the units that metres were taken for where cameras that lie `apart` m from one another, as
    read, would lie as those of a rig do in metres, and what to multiply them by; empty where there is none."""
    units, lengths, factors = _fitting(apart, {unit: 1 / metres for unit, metres in UNITS.items()})
    if not units:
        return ""
    return (
        f"they were {' or '.join(units)}? Then cameras lie up to {lengths} apart: multiply translations by {factors},"
        " or the option scale where the layout has it"
    )


def _fitting(apart: float, factors: Mapping[str, float]) -> tuple[list[str], str, str]:
    """The units by whose factor cameras `apart` m from one another come to lie as those of a rig do, how far that is,
    and the factors, in words."""
    fitting = {unit: factor for unit, factor in factors.items() if APART[0] <= apart * factor <= APART[1]}
    lengths = " or ".join(f"{apart * factor:.3g} m" for factor in fitting.values())
    return list(fitting), lengths, " or ".join(f"{factor:g}" for factor in fitting.values())


def check_rotation_vector(name: str, vector: np.ndarray) -> None:
    """Raise CalibrationError for a Rodrigues vector [3] of more than two turns."""
    if not np.linalg.norm(vector) <= TURN:
        raise CalibrationError(
            f"camera {name}: the rotation vector has the length {np.linalg.norm(vector):g}, radians of at most "
            f"{TURN:.3g} are expected; is it in degrees, or Euler angles?"
        )


def check_pixels(where: str, what: str, points: np.ndarray) -> None:
    """Raise SourceError for finite picture coordinates [..., 2] px that lie at no picture."""
    if (wrong := np.abs(points) > FARTHEST_PIXEL).any():
        raise SourceError(
            f"{where}: {what} holds the coordinate {points[wrong][0]:g} px, at most {FARTHEST_PIXEL:g} are "
            "plausible; is it in pixels of the picture?"
        )


def check_scores(where: str, what: str, scores: np.ndarray) -> None:
    """Raise SourceError for finite confidences that are none."""
    if (wrong := np.abs(scores) > MOST_SCORE).any():
        raise SourceError(
            f"{where}: {what} holds the confidence {scores[wrong][0]:g}, 0 to 1 is expected; is the order (x, y, "
            "confidence)?"
        )


def check_joints3d(where: str, points: np.ndarray) -> None:
    """Raise SourceError for joints [F, M, 3] in metres, NaN where missing, that lie at no scene."""
    known = np.isfinite(points).all(axis=-1)
    if (wrong := np.abs(points[known]) > FARTHEST).any():
        raise SourceError(
            f"{where}: a marker lies {np.abs(points[known]).max():g} m from the origin, at most {FARTHEST:g} m are "
            f"plausible; is the file's unit right? It may be millimetres ({int(wrong.any(axis=-1).sum())} markers)"
        )


def check_person(where: str, points: np.ndarray) -> None:
    """Raise SourceError for joints [F, M, 3] of one person, metres, NaN where missing,
    of another size than a person."""
    known = np.isfinite(points).all(axis=-1)
    reach = [float(np.ptp(p[k], axis=0).max()) for p, k in zip(points, known, strict=True) if k.sum() >= FEWEST]
    if reach and not PERSON[0] <= (middle := float(np.median(reach))) <= PERSON[1]:
        raise SourceError(
            f"{where}: the markers of a frame are {middle:g} m apart, {PERSON[0]:g} to {PERSON[1]:g} m are plausible "
            f"of a person; is the file's unit right? It may be {'millimetres' if middle > 1 else 'metres'}"
        )


def check_rate(where: str, rate: float) -> None:
    """Raise SourceError for a frame rate, 1/s, that no camera has."""
    if not RATE[0] <= rate <= RATE[1]:
        raise SourceError(
            f"{where}: {rate:g} frames/s are beyond {RATE[0]:g} to {RATE[1]:g}; set the option frame_rate"
        )


def check_time(where: str, seconds: float) -> None:
    """Raise SourceError for a frame's time that is not finite or beyond all clocks."""
    if not abs(seconds) <= LATEST:
        raise SourceError(
            f"{where}: frame_time {seconds:g} must be finite and within {LATEST:g} s; is it in milli- or nanoseconds?"
        )
