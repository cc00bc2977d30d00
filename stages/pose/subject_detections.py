"""What the source views saw of the subject: detections from files or of the detection stage, brought to frames/*,
one person a view."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from posegaussian.stages.contract.facts import ESTIMATED, JOINTS2D, TRACKED
from posegaussian.stages.contract.io import Inputs
from posegaussian.stages.following.choice import chosen as chosen_of
from posegaussian.stages.following.choice import name_of
from posegaussian.stages.geometry.points import to_frames
from posegaussian.stages.imaging.camera_mapping import switched
from posegaussian.stages.pose.params import PoseParams
from posegaussian.stages.pose.subject_choice import subject

DETECTIONS = "detection/joints2d"


def joint_set_of(inputs: Inputs) -> str:
    """Joint set of the detections, or of the 3D joints where there are none in 2D."""
    if ESTIMATED in inputs.facts:
        assert inputs.joint_set is not None, "estimated joints belong to a joint set"
        return inputs.joint_set
    return inputs.source("joints" if JOINTS2D in inputs.facts else "joints3d").joint_set


def span_of(inputs: Inputs) -> range:
    """Frame indices whose 2D joints may be asked for: the partition and its halo;
    the partition where there are no 2D joints."""
    if JOINTS2D not in inputs.facts:
        return inputs.partition
    return inputs.span(DETECTIONS if ESTIMATED in inputs.facts else "joints")


def numbers_of(inputs: Inputs) -> np.ndarray:
    """[n] source frame numbers of `span_of(inputs)`."""
    if JOINTS2D not in inputs.facts:
        return inputs.source_frames
    return inputs.footage(DETECTIONS if ESTIMATED in inputs.facts else "joints")[0]


def subject_in_views(inputs: Inputs, params: PoseParams, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Joints [F, V, J, 3] of the subject in every view, px of frames/*, and which of the people found [F, V] it is;
    -1: none, or not told.

    F: frames of `span_of(inputs)`; zeros where a view did not see the subject, is no source, or there are no 2D joints.
    """
    frames, sources = len(span_of(inputs)), list(inputs.views.sources)
    seen, chosen = np.zeros((frames, len(inputs.rig), count, 3)), np.full((frames, len(inputs.rig)), -1)
    if JOINTS2D not in inputs.facts:
        return seen, chosen
    rig, subject_of = inputs.rig.subset(sources), _followed(inputs, params) if TRACKED in inputs.facts else None
    for f, people in enumerate(_everybody(inputs, params, count)):
        if subject_of is not None:
            for v, found in zip(sources, people, strict=True):
                if (who := int(subject_of[f, v])) >= 0:
                    seen[f, v] = found[who]
        else:
            seen[f, sources] = subject(rig, people, params.min_score, params.max_residual)
        if ESTIMATED in inputs.facts:
            chosen[f, sources] = [_which(p, s) for p, s in zip(people, seen[f, sources], strict=True)]
    return seen, chosen


def others_in_views(inputs: Inputs, params: PoseParams, count: int) -> Iterator[dict[int, np.ndarray]]:
    """Of every frame of the partition, {number: joints [S, J, 3]} of everybody who is followed but the subject, in the
    source views, px of frames/*; zeros where a view did not see them."""
    sources = list(inputs.views.sources)
    first, own = inputs.partition.start - span_of(inputs).start, subject_number(inputs, params)
    numbers = np.stack([np.asarray(inputs.read("people/number", v)) for v in sources], axis=1)
    for f, people in enumerate(_everybody(inputs, params, count)):
        if first <= f < first + len(inputs.partition):
            followed: dict[int, np.ndarray] = {}
            for v, found in enumerate(people):
                for who, joints in zip(numbers[f, v].tolist(), found, strict=False):
                    if who >= 0 and who != own:
                        followed.setdefault(who, np.zeros((len(sources), count, 3)))[v] = joints
            yield followed


def subject_number(inputs: Inputs, params: PoseParams) -> int:
    """Who of the people that are followed is the subject, from 0; -1 where nobody is. Raises ConfigError for a name
    that nobody has."""
    largest, central, count = (int(n) for n in inputs.read("tracks/choice"))
    return chosen_of(params.subject, largest, central, count)


def subject_told(inputs: Inputs, params: PoseParams) -> str:
    """Who of several people is reconstructed; nothing where there is one."""
    count = int(inputs.read("tracks/choice")[2])
    if count < 2:
        return ""
    return (
        f"{name_of(subject_number(inputs, params))} of {count} people is reconstructed (pose.subject: {params.subject})"
    )


def _followed(inputs: Inputs, params: PoseParams) -> np.ndarray:
    """[F, V] which of a picture's people is the subject; -1 none."""
    number = subject_number(inputs, params)
    own = np.stack([np.asarray(inputs.read("people/number", v)) for v in inputs.views.sources], axis=1) == number
    out = np.full((len(own), len(inputs.rig)), -1)
    out[:, list(inputs.views.sources)] = np.where(own.any(axis=2) & (number >= 0), own.argmax(axis=2), -1)
    return out


def _everybody(inputs: Inputs, params: PoseParams, count: int) -> Iterator[list[np.ndarray]]:
    """Of every frame of `span_of(inputs)`, the people [P, J, 3] of every source view, px of frames/*."""
    sources = inputs.views.sources
    read = {v: inputs.read(DETECTIONS, v) for v in sources} if ESTIMATED in inputs.facts else None
    numbers, valid = inputs.footage("joints" if read is None else DETECTIONS)
    for f in range(len(span_of(inputs))):
        yield [
            (
                in_frames(inputs, v, _found(inputs, v, int(numbers[f]), bool(valid[f, v]), count), params.joints_frame)
                if read is None
                else in_frames(inputs, v, read[v][f])
            )
            for v in sources
        ]


def _found(inputs: Inputs, view: int, number: int, valid: bool, count: int) -> np.ndarray:
    """[P, J, 3] people in the capture's files of one source view, as given; nobody in a frame without a picture."""
    return (
        np.asarray(inputs.source("joints").read(view, number)).reshape(-1, count, 3)
        if valid
        else np.zeros((0, count, 3))
    )


def in_frames(inputs: Inputs, view: int, people: np.ndarray, joints_frame: str = "video") -> np.ndarray:
    """[P, J, 3] people of one source view in pixels of frames/*; what is not finite or cannot be mapped has score 0.
    joints_frame: as of `PoseParams`."""
    people = np.asarray(people, dtype=np.float64)
    if not len(people):
        return people
    sound = np.isfinite(people).all(axis=-1) & (people[..., 2] > 0)
    people = np.where(sound[..., None], people, 0.0)
    source_rig, crops = switched(inputs.source_rig, inputs.captured_to_calibrated, inputs.facts)
    crop = crops[view] if joints_frame == "video" else np.array([1.0, 0.0, 0.0])
    pixels, mapped = to_frames(people[..., :2], crop, source_rig, inputs.rig, view)
    score = np.minimum(people[..., 2:], 1.0)
    return np.where((sound & mapped)[..., None], np.concatenate([pixels, score], axis=-1), 0.0)


def _which(people: np.ndarray, subject: np.ndarray) -> int:
    """Index of the person [P, J, 3] that the subject [J, 3] is; -1 where nobody was seen."""
    same = [i for i, p in enumerate(people) if p[:, 2].any() and np.array_equal(p, subject)]
    return same[0] if same else -1
