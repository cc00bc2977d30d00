"""How well two cameras agree, by what both of them see: features, outlines of masks and joints are points that must lie
on each other's epipolar lines, and no silhouette may carve another one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from posegaussian.stages.contract.facts import JOINTS2D, MASKS
from posegaussian.stages.contract.io import Block, Inputs
from posegaussian.stages.contract.trust import KINDS
from posegaussian.stages.geometry.epipolar import fundamental, signed_epipolar_distance
from posegaussian.stages.geometry.matches import epipolar_fit
from posegaussian.stages.geometry.points import to_frames
from posegaussian.stages.geometry.subject import look_at_point
from posegaussian.stages.imaging.warp import Warp
from posegaussian.stages.silhouettes.agreement import FEWEST, unexplained
from posegaussian.stages.silhouettes.hull import Silhouettes, searched_radius
from posegaussian.stages.silhouettes.tangents import outline, touching
from posegaussian.stages.survey.algorithms.joints import FRAMES, SCORE, people_of
from posegaussian.stages.survey.algorithms.look import NO_FRAMES, Look
from posegaussian.stages.survey.algorithms.sample import sample_numbers
from posegaussian.stages.survey.algorithms.silhouettes import masks_of
from posegaussian.stages.survey.algorithms.surface import Seen, compared_numbers, later, seen, shared
from posegaussian.storage.model.cameras import Rig

WITHIN = 1.0
"""Px of the captured pictures within which features and outlines count as in place: masks end at whole pixels."""
FEWEST_JOINTS = 6
"""Joints that two cameras must both see of a person."""
Outline = tuple[np.ndarray, np.ndarray]


class AgreementLook(Look):
    """survey/agreement [V, 4, 2] of one view: `agreement_of_view`."""

    def __init__(self, name: str, inputs: Inputs, view: int, sample: np.ndarray) -> None:
        """sample: the view's sampled source frames."""
        self._name, self._inputs, self._view, self._sample = name, inputs, view, sample
        self._own: dict[int, Seen] = {}
        self.numbers = compared_numbers(sample) if later(inputs, view) else NO_FRAMES
        self.joints_of_all = _few(sample)

    def see(self, number: int, picture: np.ndarray, shown: np.ndarray) -> None:
        """Features of one frame."""
        found = seen(self._inputs, self._view, number, shown)
        if found is not None:
            self._own[number] = found

    def blocks(self) -> Iterator[Block]:
        """Compared with the later views."""
        yield Block(self._name, agreement_of_view(self._inputs, self._view, self._sample, self._own), self._view)


def _few(numbers: np.ndarray) -> np.ndarray:
    return sample_numbers(numbers, FRAMES) if len(numbers) else NO_FRAMES


def agreement_of_view(
    inputs: Inputs, view: int, numbers: np.ndarray, own: Mapping[int, Seen] | None = None
) -> np.ndarray:
    """[V, 4, 2] float32: how far what a source view and each later one see lies beside their epipolar lines, by
    features, outlines and joints: median beyond a captured pixel, as a share of the longer side of the picture, and how
    many tell; 0 where none do. Last by carving, `_carved`.

    Of a few of the sampled source frames `numbers` [n]. Features tell by count of the right ones, outlines by that of
    the sides that are seen, joints by that of the frames. `own`: what is known of the view's own pictures, by frame.
    """
    out = np.zeros((len(inputs.rig), len(KINDS), 2), np.float32)
    others = later(inputs, view)
    matched, few = compared_numbers(numbers), _few(numbers)
    if MASKS in inputs.facts and view in inputs.views.sources:
        out[:, KINDS.index("carving")] = _carved(inputs, view, matched)
    if not others:
        return out
    outlines = {v: _outlines(inputs, v, few) for v in (view, *others)} if MASKS in inputs.facts else {}
    people = {v: _people(inputs, v, few) for v in (view, *others)} if JOINTS2D in inputs.facts else {}
    for v in others:
        pair, longest = (view, v), float(inputs.rig.size[[view, v]].max())
        told = (
            _features(inputs, pair, matched, own or {}, longest),
            _by_outlines(inputs.rig, pair, outlines),
            _by_joints(inputs.rig, pair, people),
        )
        pixel = WITHIN * _pixel(inputs, pair)
        for kind, (distance, count) in enumerate(told):
            out[v, kind] = max(0.0, distance - pixel) / longest, count
    return out


def _pixel(inputs: Inputs, pair: tuple[int, int]) -> float:
    """Px of the rig that a captured pixel is, of the coarser of two cameras."""
    views = list(pair)
    shrunk = inputs.rig.size[views, 0] / inputs.source_rig.size[views, 0]
    return float((inputs.captured_to_calibrated[views, 0] * shrunk).max())


def _features(
    inputs: Inputs, pair: tuple[int, int], numbers: np.ndarray, own: Mapping[int, Seen], longest: float
) -> tuple[float, int]:
    """Px by which the right ones of the features that two cameras share miss their lines, and how many these are."""
    found = []
    for number in map(int, numbers):
        first = own.get(number) or seen(inputs, pair[0], number)
        second = seen(inputs, pair[1], number) if first is not None else None
        if first is not None and second is not None:
            both = shared(inputs, pair, number, first, second)
            found.append(np.concatenate([p[both.mapped] for p in both.pixels], axis=1))
    points = np.concatenate(found) if found else np.zeros((0, 4))
    # What stands still is matched in every frame at the same place; it counts once.
    _, once = np.unique(points.round(0), axis=0, return_index=True)
    points = points[np.sort(once)]
    fit = epipolar_fit(fundamental(inputs.rig, *pair), points[:, :2], points[:, 2:], longest)
    return (0.0, 0) if fit.error is None else (fit.error, int(fit.agree.sum()))


def _outlines(inputs: Inputs, view: int, numbers: np.ndarray) -> dict[int, Outline]:
    """Outlines of a view's masks by source frame, px of the rig."""
    had = set(map(int, inputs.source("pictures").numbers(view)))
    chosen, found = [n for n in map(int, numbers) if n in had], {}
    for number, mask in zip(chosen, inputs.source("masks").read(view, chosen) if chosen else (), strict=True):
        corners, free = outline(mask)
        crop = inputs.captured_to_calibrated[view]
        pixels, mapped = to_frames(corners, crop, inputs.source_rig, inputs.rig, view)
        found[number] = pixels[mapped], free[mapped]
    return found


def _by_outlines(rig: Rig, pair: tuple[int, int], outlines: Mapping[int, Mapping[int, Outline]]) -> tuple[float, int]:
    """Px by which the outermost points of two cameras' outlines miss their lines, and of how many sides."""
    if not outlines:
        return 0.0, 0
    first, second = (outlines[v] for v in pair)
    touched = [touching(rig, pair, first[n], second[n]) for n in sorted(first.keys() & second.keys())]
    off = [signed_epipolar_distance(fundamental(rig, *pair), x, y) for x, y in touched]
    known = np.abs(np.concatenate(off)) if off else np.zeros(0)
    return (float(np.median(known)), len(known)) if len(known) else (0.0, 0)


def _carved(inputs: Inputs, view: int, numbers: np.ndarray) -> np.ndarray:
    """[V, 2] share of a view's foreground that each other source's mask alone carves away, at its own place the share
    that others leave nothing of; and in how many of the source frames. Means over these.

    A camera that is turned along the lines of the others moves nothing off them. But its silhouette carves theirs, and
    theirs carve its own; a mask that lacks something does the first alone, one that has too much the second.
    """
    rig, found = inputs.rig, []
    warps: dict[int, Warp] = {}
    for number in map(int, numbers):
        masks = masks_of(inputs, number, warps)
        views = sorted(masks)
        if view not in views or len(views) < FEWEST:
            continue
        centre = look_at_point(rig.subset(views))
        silhouettes = Silhouettes.of(rig, masks, centre, searched_radius(rig, views, centre))
        if view not in silhouettes.views:
            continue
        shares = unexplained(rig, view, masks[view], silhouettes)
        alone = np.zeros(len(rig))
        alone[list(silhouettes.views)] = shares[-1] - shares[:-1]
        alone[view] = shares[-1]
        found.append(alone)
    out = np.zeros((len(rig), 2))
    if found:
        out[:, 0], out[list(inputs.views.sources), 1] = np.mean(found, axis=0), len(found)
    return out


def _people(inputs: Inputs, view: int, numbers: np.ndarray) -> dict[int, np.ndarray]:
    """[people, 17, 3] px of the rig by source frame."""
    had = set(map(int, inputs.source("pictures").numbers(view)))
    return {n: people_of(inputs, view, n) for n in map(int, numbers) if n in had}


def _by_joints(rig: Rig, pair: tuple[int, int], people: Mapping[int, Mapping[int, np.ndarray]]) -> tuple[float, int]:
    """Px by which joints of two cameras miss their lines, of the two people who fit best, and in how many frames."""
    if not people:
        return 0.0, 0
    matrix, (first, second) = fundamental(rig, *pair), (people[v] for v in pair)
    found = []
    for n in sorted(first.keys() & second.keys()):
        off = [d for a in first[n] for b in second[n] if (d := _apart(matrix, a, b)) is not None]
        found += [min(off)] if off else []
    return (float(np.median(found)), len(found)) if found else (0.0, 0)


def _apart(matrix: np.ndarray, first: np.ndarray, second: np.ndarray) -> float | None:
    """Median px by which the joints [17, 3] of a person as two cameras see them miss their lines."""
    both = (first[:, 2] >= SCORE) & (second[:, 2] >= SCORE)
    if both.sum() < FEWEST_JOINTS:
        return None
    return float(np.median(np.abs(signed_epipolar_distance(matrix, first[both, :2], second[both, :2]))))
