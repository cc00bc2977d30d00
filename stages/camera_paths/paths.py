"""Camera paths: where pictures are rendered from, over the frames of a sequence.

`between`, `orbit` and `arc` are one camera that moves with the frames; a sequence of one frame gets 48 cameras instead,
one for each step. All other cameras stand still. A person filmed from one side only, or by one camera, can be orbited
too: the far side then shows what no camera saw, which is nothing. `between` stays where cameras stand side by side, and
`sway` near a
camera: what a single source view has to show.
"""

from __future__ import annotations

import difflib
import shlex
from dataclasses import replace

import numpy as np

from posegaussian.stages.camera_paths.framing import common_size, focal_in, framed, typical_focal, without_close_ups
from posegaussian.stages.camera_paths.path_file import read_path_file
from posegaussian.stages.camera_paths.stretch import Stretch, around, best_stretch, directions
from posegaussian.stages.contract.io import Views
from posegaussian.stages.geometry.pairs import MAX_ANGLE, SHOWN
from posegaussian.stages.geometry.subject import look_at_point, middle_rays, up_direction
from posegaussian.storage.model.cameras import CameraPath, Rig, rigid, rotation_matrix
from posegaussian.storage.model.errors import CalibrationError, UserError

STEPS = 48
"""Cameras of a moving path of a sequence that has one frame only."""
SWAY = 6.0
"""Degrees at the subject by which `sway` swings to both sides."""
RISE = 1 / 3
"""Share of it by which it swings up and down, twice as often."""
LOOP = 96
"""Frames of one swing, about."""
HALF_TURN = 1e-3
"""Radians: rotations this close to a half turn count as one;
their axis has no sign, so the rig's up decides the way."""


def make_path(
    text: str,
    rig: Rig,
    views: Views,
    source_frames: np.ndarray,
    distance: float | None = None,
    max_angle: float = MAX_ANGLE,
) -> CameraPath:
    """The target cameras of `between`, `held_out`, `orbit`, `arc CAM_A CAM_B`, `still CAM`, `sway [CAM [DEGREES]]`, or
    a file whose name ends in .json.

    Names with spaces are quoted. `rig` holds the cameras of the frames grid, `source_frames` [F] the source frame
    numbers of the sequence; `distance` is metres from a single source camera to the subject, where they are known,
    `max_angle` degrees between neighbours that depth can match. Raises UserError for a text that is none of these, for
    unknown cameras and for faults of the file.
    """
    return replace(_asked(text, rig, views, source_frames, distance, max_angle), text=text)


def _asked(
    text: str, rig: Rig, views: Views, source_frames: np.ndarray, distance: float | None, max_angle: float
) -> CameraPath:
    """As `make_path`, without its text."""
    frames = len(source_frames)
    if text.strip().endswith(".json"):
        return read_path_file(text.strip(), source_frames)
    try:
        words = shlex.split(text)
    except ValueError as e:
        raise UserError(f"camera path {text!r}: {e}; put names with spaces in one pair of quotes") from None
    kind, cameras = (words[0], words[1:]) if words else ("", [])
    wanted = {"between": (0,), "held_out": (0,), "orbit": (0,), "arc": (2,), "still": (1,), "sway": (0, 1, 2)}
    if kind not in wanted:
        near = difflib.get_close_matches(kind, wanted, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise UserError(
            f'camera path {text!r} is none of "between", "held_out", "orbit", "arc CAM_A CAM_B", "still CAM", "sway'
            f' [CAM [DEGREES]]" and a .json file{hint}'
        )
    if kind == "sway" and len(cameras) < 3:
        return _sway(rig, views, cameras, text, frames, distance)
    if len(cameras) not in wanted[kind]:
        raise UserError(
            f"camera path {text!r}: {kind} takes {' or '.join(map(str, wanted[kind]))} camera names, got {len(cameras)}"
        )
    indices = [_camera(name, text, rig) for name in cameras]
    if kind == "held_out":
        if not views.held_out:
            raise UserError(
                "camera path 'held_out': no camera is held out; name some in views.held_out, or render orbit, arc,"
                " still or a file"
            )
        return _standing(kind, list(views.held_out), rig, frames)
    if kind == "still":
        return _standing(kind, indices, rig, frames)
    if kind == "between":
        return _side_by_side(rig, views, frames, max_angle)
    # A camera that is held out or not believed does not say where the subject is; a single one alone cannot.
    seeing = rig.subset(views.sources) if len(views.sources) > 1 else rig
    if kind == "arc":
        return _arc(rig, seeing, indices[0], indices[1], frames)
    subject = look_at_point(seeing) if distance is None else _ahead(rig, views, views.sources[0], distance)
    return _orbit(seeing, subject, frames)


def _camera(name: str, text: str, rig: Rig) -> int:
    try:
        return rig.index(name)
    except CalibrationError as e:
        near = difflib.get_close_matches(name, rig.names, n=1)
        raise UserError(f"camera path {text!r}: {e}" + (f"; did you mean {near[0]!r}?" if near else "")) from None


def _standing(kind: str, indices: list[int], rig: Rig, frames: int) -> CameraPath:
    """Some cameras of the rig, as they are, in every frame."""
    names = tuple(rig.names[i] for i in indices)
    k, pose = (np.repeat(a[None, indices], frames, axis=0) for a in (rig.intrinsics, rig.world_to_camera))
    return CameraPath(kind, names, k, pose, rig.size[indices], np.ones((frames, len(indices)), bool))


def _moving(kind: str, intrinsics: np.ndarray, poses: np.ndarray, size: np.ndarray, frames: int) -> CameraPath:
    """Steps [S, 3, 3] and [S, 4, 4] as one camera over S frames, or as S cameras of the only frame."""
    if frames > 1:
        return CameraPath(kind, (kind,), intrinsics[:, None], poses[:, None], size[None], np.ones((frames, 1), bool))
    steps = len(poses)
    names = tuple(f"{kind}_{s:02d}" for s in range(steps))
    return CameraPath(
        kind, names, intrinsics[None], poses[None], np.repeat(size[None], steps, axis=0), np.ones((1, steps), bool)
    )


def _orbit(rig: Rig, subject: np.ndarray, frames: int) -> CameraPath:
    """Once around the subject [3], starting beside the first camera, right-handed about the rig's up.

    Radius and height are the cameras' means about that axis. A picture has the most common size, its middle as
    principal point, and shows the subject as large as the median camera does among those whose pictures stand or lie
    like it: cameras above and below stand farther away than their means. The last frame stops one step short of the
    first: a loop has no double.
    """
    up = up_direction(rig)
    offset = rig.centres - subject
    height = offset @ up
    flat = offset - height[:, None] * up
    radius = float(np.linalg.norm(flat, axis=1).mean())
    if radius < 1e-3 * max(1.0, float(np.abs(height).max())):
        raise UserError(
            "camera path 'orbit': all cameras stand straight above or below the subject, so there is no radius; render"
            " still, arc or a .json file"
        )
    first = flat[np.argmax(np.linalg.norm(flat, axis=1) > 1e-3 * radius)]
    side = first / np.linalg.norm(first)
    steps = frames if frames > 1 else STEPS
    angle = 2 * np.pi * np.arange(steps) / steps
    around = np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * np.cross(up, side)
    poses = _looking_at(subject, subject + radius * around + height.mean() * up, up)
    size = common_size(rig)
    focal = typical_focal(rig, size, np.linalg.norm(offset, axis=1), float(np.hypot(radius, height.mean())))
    k = np.array([[focal, 0, size[0] / 2], [0, focal, size[1] / 2], [0, 0, 1]])
    return _moving("orbit", np.repeat(k[None], steps, axis=0), poses, size, frames)


def _side_by_side(rig: Rig, views: Views, frames: int, max_angle: float) -> CameraPath:
    """Along the source cameras that stand side by side, upright and with the subject in the middle of the picture.

    All the way around where they do, at even speed, the last frame one step short of the first; else from one end of
    the stretch to the other and back, slowly at the ends; up and down past cameras above each other. Height, distance
    and focal length go from camera to camera without a kink, and never beyond both; past a close-up the person stays
    whole. Raises UserError where no two source cameras that stand near enough can be matched.
    """
    stretch = best_stretch(rig, views.sources, max_angle)
    if stretch is None:
        raise UserError(
            f"camera path 'between': no two of the source cameras {', '.join(rig.names[v] for v in views.sources)} can"
            f" be matched within {min(max_angle, SHOWN):g} degrees (see `posegaussian inspect`), so nothing lies"
            " between; render sway, orbit, arc, still or a .json file"
        )
    steps = frames if frames > 1 else STEPS
    phase = np.arange(steps) / steps
    subject, axis, height, flat = around(rig, views.sources)
    size = common_size(rig.subset(stretch.views))
    focal = without_close_ups(focal_in(rig, size), np.hypot(height, flat), stretch.views)
    azimuth, (rise, radius, length) = _along(
        rig, views, stretch, phase if stretch.closed else (1 - np.cos(2 * np.pi * phase)) / 2, height, flat, focal
    )
    side, on = directions(rig, views.sources, stretch.views[0])
    centres = (
        subject
        + radius[:, None] * (np.cos(azimuth)[:, None] * side + np.sin(azimuth)[:, None] * on)
        + rise[:, None] * axis
    )
    up = up_direction(rig.subset(views.sources))
    k = np.zeros((steps, 3, 3))
    k[:, 0, 0] = k[:, 1, 1] = length
    k[:, 0, 2], k[:, 1, 2], k[:, 2, 2] = size[0] / 2, size[1] / 2, 1
    return _moving("between", k, _looking_at(subject, centres, up), size, frames)


def _along(
    rig: Rig, views: Views, stretch: Stretch, share: np.ndarray, *values: np.ndarray
) -> tuple[np.ndarray, list[np.ndarray]]:
    """Azimuth [S] from the stretch's first camera at shares [S] of the way, and what each of `values` [V] is there:
    a camera's own beside it, a smooth step between two."""
    order = [*stretch.views, stretch.views[0]] if stretch.closed else list(stretch.views)
    subject, (side, on) = around(rig, views.sources)[0], directions(rig, views.sources, order[0])
    offset = rig.centres[order] - subject
    steps = np.diff(np.arctan2(offset @ on, offset @ side)) % (2 * np.pi)
    knots = np.concatenate([[0.0], np.cumsum(steps)])
    azimuth = share * knots[-1]
    hop = np.clip(np.searchsorted(knots, azimuth, side="right") - 1, 0, len(steps) - 1)
    t = (azimuth - knots[hop]) / steps[hop]
    smooth = t * t * (3 - 2 * t)
    return azimuth, [v[order][hop] + smooth * (v[order][hop + 1] - v[order][hop]) for v in values]


def _looking_at(subject: np.ndarray, centres: np.ndarray, up: np.ndarray) -> np.ndarray:
    """[S, 4, 4] world_to_camera of upright cameras at centres [S, 3] that have the subject on their optical axes."""
    forward = _unit(subject - centres)
    right = _unit(np.cross(forward, up))
    rotation = np.stack([right, np.cross(forward, right), forward], axis=1)
    translation = (-rotation @ centres[:, :, None])[..., 0]
    return np.stack([rigid(r, t) for r, t in zip(rotation, translation, strict=True)])


def _unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors [S, 3] of length 1. Squares are summed by a product of matrices, as `np.linalg.norm` does for a single
    one: along an axis it sums them otherwise, and pictures would differ in their last bits from those of a loop."""
    return np.asarray(vectors / np.sqrt(vectors[:, None, :] @ vectors[:, :, None])[:, 0])


def _ahead(rig: Rig, views: Views, view: int, distance: float | None) -> np.ndarray:
    """[3] the subject before a camera: in the middle of its picture `distance` metres along its optical axis where that
    is known, of a single source camera, else the point where the source cameras look."""
    if distance is not None and len(views.sources) == 1:
        return rig.centres[view] + distance * middle_rays(rig)[view]
    return look_at_point(rig.subset(views.sources))


def _sway(rig: Rig, views: Views, words: list[str], text: str, frames: int, distance: float | None) -> CameraPath:
    """A source camera that swings about the subject in the middle of its picture, sideways by some degrees and less up
    and down, a lying eight that begins at the camera itself.

    It is turned as a whole about the point `distance` ahead, or as deep as the source cameras look where that is not
    given, so the subject stays where it is in the picture. A whole number of swings fills the sequence, so that it can
    be played in a loop.
    """
    view = _camera(words[0], text, rig) if words else views.sources[0]
    try:
        swing = float(words[1]) if len(words) > 1 else SWAY
    except ValueError:
        raise UserError(
            f"camera path {text!r}: {words[1]!r} is no number of degrees, as in 'sway {words[0]} 5'"
        ) from None
    if not 0 < swing <= 90:
        raise UserError(f"camera path {text!r}: {swing:g} degrees are not between 0 and 90")
    r, t = rig.rotations[view], rig.world_to_camera[view, :3, 3]
    depth = float(r[2] @ (_ahead(rig, views, view, distance) - rig.centres[view]))
    if depth <= 0:
        raise UserError(f"camera path {text!r}: the point where the source cameras look lies behind {rig.names[view]}")
    steps = frames if frames > 1 else STEPS
    phase = 2 * np.pi * max(1, round(steps / LOOP)) * np.arange(steps) / steps
    pivot = depth * (r @ middle_rays(rig)[view])
    poses = []
    for sideways, upwards in zip(
        np.deg2rad(swing) * np.sin(phase), np.deg2rad(swing) * RISE * np.sin(2 * phase), strict=True
    ):
        turn = rotation_matrix(np.array([0.0, sideways, 0.0])) @ rotation_matrix(np.array([upwards, 0.0, 0.0]))
        poses.append(rigid(turn @ r, turn @ (t - pivot) + pivot))
    return _moving(
        "sway", np.repeat(rig.intrinsics[view][None], steps, axis=0), np.stack(poses), rig.size[view], frames
    )


def _arc(rig: Rig, seeing: Rig, a: int, b: int, frames: int) -> CameraPath:
    """From camera a to camera b about the point where the cameras `seeing` the subject look; both end points are exact.

    Orientations are slerped. The subject's position in camera axes is interpolated too, its direction and its distance
    apart, and the centre follows: C = X - R^T x. So the distance to the subject runs from one camera's to the other's
    and the subject stays where it is in the picture, whatever the origin of the world. Translations are never
    interpolated. The size is the larger one on each axis; the cameras' pictures are scaled whole into the middle of it,
    and their intrinsics interpolated linearly.
    """
    subject = look_at_point(seeing)
    ra, rb = rig.rotations[a], rig.rotations[b]
    xa, xb = (rig.rotations[i] @ subject + rig.world_to_camera[i, :3, 3] for i in (a, b))
    turn = _rotation_vector(rb.T @ ra, up_direction(seeing))  # world axes: camera axes a turn into those of b
    steps = frames if frames > 1 else STEPS
    share = np.linspace(0, 1, steps)
    poses = []
    for s in share:
        rotation = ra @ rotation_matrix(turn * s).T
        poses.append(rigid(rotation, _between(xa, xb, float(s)) - rotation @ subject))
    poses[0], poses[-1] = rig.world_to_camera[a], rig.world_to_camera[b]
    size = np.maximum(rig.size[a], rig.size[b])
    ka, kb = (framed(rig.intrinsics[i], rig.size[i], size) for i in (a, b))
    k = ka + share[:, None, None] * (kb - ka)
    k[-1] = kb
    return _moving("arc", k, np.stack(poses), size, frames)


def _between(a: np.ndarray, b: np.ndarray, share: float) -> np.ndarray:
    """[3] the vector a share of the way from a to b: direction by slerp, length linearly."""
    la, lb = np.linalg.norm(a), np.linalg.norm(b)
    angle = np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)
    if angle < 1e-9:
        return a + share * (b - a)
    direction = (np.sin((1 - share) * angle) * a / la + np.sin(share * angle) * b / lb) / np.sin(angle)
    return direction * ((1 - share) * la + share * lb)


def _rotation_vector(rotation: np.ndarray, up: np.ndarray) -> np.ndarray:
    """[3] axis times angle of a rotation matrix, angle in [0, pi];
    of a half turn, the axis that has `up` on its side."""
    skew = (
        np.array([rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]])
        / 2
    )
    angle = float(np.arctan2(np.linalg.norm(skew), (np.trace(rotation) - 1) / 2))
    if angle < 1e-12:
        return np.zeros(3)
    if np.pi - angle > HALF_TURN:
        return skew / np.linalg.norm(skew) * angle
    symmetric = (rotation + rotation.T) / 2 - np.cos(angle) * np.eye(3)  # (1 - cos) axis axis^T
    axis = symmetric[:, np.argmax(np.diag(symmetric))]
    axis = axis / np.linalg.norm(axis)
    if axis @ skew < 0:  # the way of a turn just short of half
        axis = -axis
    return axis * angle if axis @ up >= 0 else -axis * (2 * np.pi - angle)
