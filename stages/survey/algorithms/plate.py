"""The background of a static camera: the median of a sample of its pictures, people left out where joints tell."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from posegaussian.stages.contract.io import Block, Inputs, JointReader
from posegaussian.stages.imaging.steady_light import CHANGES, UNTOLD, steadied, stops_brighter, thinned
from posegaussian.stages.survey.algorithms.body_mask import people_cover
from posegaussian.stages.survey.algorithms.look import NO_FRAMES, Look

UNKNOWN = 255
"""Spread of a pixel whose background was never seen."""
FEWEST_SHOWN = 3
"""Frames that must show a pixel without a person."""
BLOCK = 65536
"""Values of a picture that are sorted at a time: with those of all frames they fit in a processor's cache."""
STEADY = 0.01
"""Stops by which pictures may differ and still be taken as they are."""
ROUNDS = 3
"""In which a light common to all pictures is found; a fourth changes them by less than `STEADY`."""


class PlateLook(Look):
    """survey/plate [Y, X, 3] uint8 sRGB, survey/spread [Y, X] uint8, both in captured pixels, and survey/drift [S, 3],
    as far as they are asked for.

    Y and X are the largest captured size of all views, padding is 0. The sample lies over the whole source, as nothing
    tells what is behind somebody who stands still for the few frames that may be worked on. Where the light of these
    pictures changes, by `CHANGES` in one channel, the plate has the light that the worked ones usually have.
    """

    def __init__(
        self,
        inputs: Inputs,
        view: int,
        numbers: np.ndarray,
        worked: np.ndarray,
        sample: int,
        joints: JointReader | None,
        margin: float,
    ) -> None:
        """numbers: of the plate; worked: of those whose light it gets; joints: of people to leave out, widened by
        `margin`; sample: length of the record of the frames."""
        self.numbers, self._plated, self._worked = np.union1d(numbers, worked), numbers, worked
        self._inputs, self._view, self._sample, self._joints, self._margin = inputs, view, sample, joints, margin
        self.joints = NO_FRAMES if joints is None else self.numbers
        width, height = inputs.source("pictures").size(view)
        self._stack = np.empty((len(numbers), height, width, 3), dtype=np.uint8)
        self._covered = np.zeros(self._stack.shape[:3], dtype=np.uint8)
        self._lit: dict[int, tuple[np.ndarray, np.ndarray]] = {}

    def see(self, number: int, picture: np.ndarray, shown: np.ndarray) -> None:
        """Keep a picture and where people are in it."""
        hidden, size = np.zeros(shown.shape[:2], np.uint8), (shown.shape[1], shown.shape[0])
        if self._joints is not None:
            hidden = people_cover(self._joints.read(self._view, number), self._joints.joint_set, size, self._margin)
        i = int(np.searchsorted(self._plated, number))
        if i < len(self._plated) and self._plated[i] == number:
            self._stack[i], self._covered[i] = shown, hidden
        if number in self._worked:
            self._lit[number] = thinned(shown).copy(), thinned(hidden).copy()

    def blocks(self) -> Iterator[Block]:
        """By how much each worked frame is brighter than they usually are, and in their usual light the plate, its
        frames and the spread."""
        pictures, views = self._inputs.source("pictures"), self._inputs.views.names
        x, y = (int(n) for n in np.array([pictures.size(v) for v in range(len(views))]).max(axis=0))
        changes = self._brought_to_one_light()
        plate, spread = median_and_spread(self._stack, self._covered)
        ground, known = thinned(plate), thinned(spread) < UNKNOWN
        drift = np.stack(
            [stops_brighter(p, ground, known & (h == 0)) for p, h in (self._lit[int(n)] for n in self._worked)]
        )
        told = np.asarray((drift < UNTOLD).all(axis=1))
        usual = np.median(drift[told], axis=0) if told.any() else np.zeros(3)
        if changes:
            plate = steadied(plate, -usual)
        if "survey/drift" in self._inputs.facts:
            drift = np.where(told[:, None], drift - usual, UNTOLD)
            yield Block("survey/drift", padded(drift, (self._sample, 3), UNTOLD), self._view)
        if "survey/plate" in self._inputs.facts:
            yield Block("survey/background", padded(self._plated, (self._sample,), -1), self._view)
            yield Block("survey/plate", padded(plate, (y, x, 3)), self._view)
        if "survey/spread" in self._inputs.facts:
            yield Block("survey/spread", padded(spread, (y, x)), self._view)

    def _brought_to_one_light(self) -> bool:
        """Whether the light of the plate's pictures changes; they then have one light from now on."""
        few = (np.stack([thinned(image) for image in images]) for images in (self._stack, self._covered))
        brighter = brighter_than_each_other(*few)
        told = brighter[(brighter < UNTOLD).all(axis=1)]
        changes = len(told) > 1 and bool(np.ptp(told, axis=0).max() > CHANGES)
        if changes:
            for i, stops in enumerate(brighter):
                self._stack[i] = steadied(self._stack[i], stops)
        return changes


def brighter_than_each_other(stack: np.ndarray, covered: np.ndarray) -> np.ndarray:
    """[n, 3] stops by which pictures [n, h, w, 3] uint8 are brighter than their plate, pixels that are `covered` [n, h,
    w] left out; `UNTOLD` where the background does not tell.

    The plate is that of pictures brought to one light, which is found in rounds.
    """
    alike, brighter = stack, np.zeros((len(stack), 3))
    for _ in range(ROUNDS):
        plate, spread = median_and_spread(alike, covered)
        known = (covered == 0) & (spread < UNKNOWN)
        brighter = np.stack([stops_brighter(p, plate, k) for p, k in zip(stack, known, strict=True)])
        if (np.abs(brighter) <= STEADY).all():
            break
        alike = np.stack([steadied(p, b) for p, b in zip(stack, brighter, strict=True)])
    return brighter


def padded(data: np.ndarray, shape: tuple[int, ...], value: float = 0) -> np.ndarray:
    """`data` in the first corner of an array of `shape`, `value` elsewhere."""
    out = np.full(shape, value, dtype=data.dtype)
    out[tuple(slice(n) for n in data.shape)] = data
    return out


def median_and_spread(stack: np.ndarray, covered: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lower median [h, w, 3] and largest median absolute deviation of the channels [h, w], uint8, of [n, h, w, 3]
    uint8.

    Samples with `covered` [n, h, w] not 0 do not count; a pixel that fewer than three samples show uncovered takes the
    median of all and the spread 255 (`UNKNOWN`). Of an even number the median is the lower middle value: one that
    occurred.
    """
    n, height, width, channels = stack.shape
    plate, spread = np.zeros((height, width, channels), dtype=np.uint8), np.zeros((height, width), dtype=np.uint8)
    pairs, rows = list(_comparators(n)), max(1, BLOCK // max(1, width * channels))
    for top in range(0, height, rows):
        part = slice(top, top + rows)
        hidden: np.ndarray = covered[:, part] != 0
        shown = n - hidden.sum(axis=0)
        unknown = shown < min(FEWEST_SHOWN, n)
        rank = (np.where(unknown, n, shown) - 1) // 2
        # What is hidden becomes 255 and comes last, where no rank reaches.
        last = [
            (
                np.repeat(np.where(unknown, False, h).view(np.uint8) * np.uint8(255), channels, axis=1).reshape(
                    *h.shape, channels
                )
                if h.any()
                else None
            )
            for h in hidden
        ]
        plate[part] = middle = _ranked(
            [v if h is None else np.maximum(v, h) for v, h in zip(stack[:, part], last, strict=True)], rank, pairs
        )
        off = [np.maximum(v, middle) - np.minimum(v, middle) for v in stack[:, part]]
        found = _ranked([v if h is None else np.maximum(v, h) for v, h in zip(off, last, strict=True)], rank, pairs)
        spread[part] = np.where(unknown, UNKNOWN, found.max(axis=-1))
    return plate, spread


def _ranked(values: list[np.ndarray], rank: np.ndarray, pairs: list[tuple[int, int]]) -> np.ndarray:
    """[r, w, c] the value of rank `rank` [r, w] (0: the least) of each place of n arrays [r, w, c] uint8.

    A sorting network over whole rows is some twenty times as quick as numpy's sort along the first axis.
    """
    planes, spare = [v.copy() for v in values], np.empty_like(values[0])
    for a, b in pairs:
        np.minimum(planes[a], planes[b], out=spare)
        np.maximum(planes[a], planes[b], out=planes[b])
        planes[a], spare = spare, planes[a]
    ranks = np.unique(rank)
    return (
        planes[int(ranks[0])]
        if len(ranks) == 1
        else np.take_along_axis(np.stack(planes), rank[None, ..., None], axis=0)[0]
    )


def _comparators(n: int) -> Iterator[tuple[int, int]]:
    """Pairs (i, j), i < j, of a network that sorts n values: merge exchange (Knuth, The Art of Computer Programming
    3, 5.2.2, algorithm M)."""
    top = 1 << ((n - 1).bit_length() - 1) if n > 1 else 0
    p = top
    while p > 0:
        q, r, d = top, 0, p
        while d > 0:
            yield from ((i, i + d) for i in range(n - d) if i & p == r)
            d, q, r = q - p, q // 2, p
        p //= 2
