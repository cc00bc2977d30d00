"""How well two cameras agree, by what both of them see: features, outlines of masks and joints are points that must lie
on each other's epipolar lines."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from posegaussian.stages.contract.facts import ESTIMATED, JOINTS2D
from posegaussian.stages.contract.io import Block, Inputs
from posegaussian.stages.contract.trust import JOINTS_AGREE, KINDS
from posegaussian.stages.geometry.epipolar import fundamental, signed_epipolar_distance
from posegaussian.stages.imaging.camera_mapping import unreduced_size
from posegaussian.stages.survey.algorithms.joints import SCORE, people_of
from posegaussian.stages.survey.algorithms.links import InCommon, few_of, in_common, links_of_view
from posegaussian.stages.survey.algorithms.look import NO_FRAMES, Look
from posegaussian.stages.survey.algorithms.sample import compared_numbers
from posegaussian.stages.survey.algorithms.surface import Seen, later, seen
from posegaussian.storage.model.cameras import Rig

WITHIN = 1.0
"""Px of the captured pictures within which features and outlines count as in place: masks end at whole pixels."""
FEWEST_JOINTS = 6
"""Joints that two cameras must both see of a person."""
FEWEST_DETECTED = 3
"""Frames in which a detector must find them to speak against a camera: who hardly sees anybody sees them wrongly. Of a
walker seen from behind it found 7 joints in one frame of five, all of them elsewhere, and a camera that is right was
left out by these; so it was by one of two frames. What is found wrongly hardly ever lies on the other's lines: for a
camera a single frame speaks, so that masks alone, with a piece of floor or without a foot, leave nobody out."""


class AgreementLook(Look):
    """survey/agreement [V, 3, 2] and survey/links [V, POINTS, 4] of one view, as far as they are asked for:
    `agreement_of_view`, `links_of_view`."""

    def __init__(self, names: tuple[str, str], inputs: Inputs, view: int, sample: np.ndarray) -> None:
        """names: of the two arrays; sample: the view's sampled source frames, those with somebody."""
        self._agreement, self._links = names
        self._inputs, self._view, self._sample = inputs, view, sample
        self._own: dict[int, Seen] = {}
        self.numbers = compared_numbers(sample) if later(inputs, view) else NO_FRAMES
        self.joints_of_all = few_of(sample) if self._agreement in inputs.facts else NO_FRAMES

    def see(self, number: int, picture: np.ndarray, shown: np.ndarray) -> None:
        """Features of one frame."""
        found = seen(self._inputs, self._view, number, shown)
        if found is not None:
            self._own[number] = found

    def blocks(self) -> Iterator[Block]:
        """Compared with the later views."""
        inputs, view = self._inputs, self._view
        pairs = in_common(inputs, view, self._sample, self._own)
        if self._agreement in inputs.facts:
            yield Block(self._agreement, agreement_of_view(inputs, view, self._sample, pairs), view)
        if self._links in inputs.facts:
            yield Block(self._links, links_of_view(inputs.rig, view, pairs), view)


def agreement_of_view(inputs: Inputs, view: int, numbers: np.ndarray, pairs: Mapping[int, InCommon]) -> np.ndarray:
    """[V, 3, 2] float32: how far what a source view and each later one see lies beside their epipolar lines, by
    features, outlines and joints: median beyond a captured pixel, as a share of the longer side of the picture, and how
    many tell; 0 where none do.

    Of a few of the sampled source frames `numbers` [n]. Features tell by count of the right ones, outlines by that of
    the sides that are seen, joints by that of the frames. `pairs`: what the view shares with each later one.
    """
    out = np.zeros((len(inputs.rig), len(KINDS), 2), np.float32)
    few = few_of(numbers)
    people = {v: _people(inputs, v, few) for v in (view, *pairs)} if JOINTS2D in inputs.facts and pairs else {}
    for v, shared in pairs.items():
        longest = float(inputs.rig.size[[view, v]].max())
        told = (
            (shared.features.off, len(shared.features.first)),
            (shared.outlines.off, len(shared.outlines.first)),
            _by_joints(inputs.rig, (view, v), people, FEWEST_DETECTED if ESTIMATED in inputs.facts else 1),
        )
        pixel = WITHIN * _pixel(inputs, (view, v))
        for kind, (distance, count) in enumerate(told):
            out[v, kind] = max(0.0, distance - pixel) / longest, count
    return out


def _pixel(inputs: Inputs, pair: tuple[int, int]) -> float:
    """Px of the rig that a captured pixel is, of the coarser of two cameras."""
    views = list(pair)
    shrunk = (inputs.rig.size / unreduced_size(inputs.rig, inputs.source_rig))[views, 0]
    return float((inputs.captured_to_calibrated[views, 0] * shrunk).max())


def _people(inputs: Inputs, view: int, numbers: np.ndarray) -> dict[int, np.ndarray]:
    """[people, 17, 3] px of the rig by source frame."""
    had = set(map(int, inputs.source("pictures").numbers(view)))
    return {n: people_of(inputs, view, n) for n in map(int, numbers) if n in had}


def _by_joints(
    rig: Rig, pair: tuple[int, int], people: Mapping[int, Mapping[int, np.ndarray]], fewest: int
) -> tuple[float, int]:
    """Px by which joints of two cameras miss their lines, of the two people who fit best, and in how many frames;
    nothing where these are fewer than `fewest` and do not agree."""
    if not people:
        return 0.0, 0
    matrix, (first, second) = fundamental(rig, *pair), (people[v] for v in pair)
    found = []
    for n in sorted(first.keys() & second.keys()):
        off = [d for a in first[n] for b in second[n] if (d := _apart(matrix, a, b)) is not None]
        found += [min(off)] if off else []
    if not found:
        return 0.0, 0
    median = float(np.median(found))
    agree = median <= JOINTS_AGREE * float(rig.size[list(pair)].max())
    return (median, len(found)) if agree or len(found) >= fewest else (0.0, 0)


def _apart(matrix: np.ndarray, first: np.ndarray, second: np.ndarray) -> float | None:
    """Median px by which the joints [17, 3] of a person as two cameras see them miss their lines."""
    both = (first[:, 2] >= SCORE) & (second[:, 2] >= SCORE)
    if both.sum() < FEWEST_JOINTS:
        return None
    return float(np.median(np.abs(signed_epipolar_distance(matrix, first[both, :2], second[both, :2]))))
