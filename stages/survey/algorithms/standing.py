"""How cameras stand by their silhouettes, before anything else is measured of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import reduce
from hashlib import blake2b
from typing import Any

import numpy as np

from posegaussian.stages.contract.facts import MASKS
from posegaussian.stages.contract.io import Block, Inputs, TaskScope
from posegaussian.stages.imaging.small_turns import turned
from posegaussian.stages.imaging.warp import Warp
from posegaussian.stages.silhouettes.coherence import FEWEST, Outlined, Standing, standing
from posegaussian.stages.survey.algorithms.look import NO_FRAMES, Look
from posegaussian.stages.survey.algorithms.sample import sample_numbers, worked_numbers
from posegaussian.stages.survey.algorithms.silhouettes import masks_of
from posegaussian.stages.survey.algorithms.surface import compared_numbers

_KEPT: dict[bytes, Standing] = {}
"""That of a few captures, as every view's task asks for it."""
KEPT = 8


class AsTheyStand(Inputs):
    """What a task may see, with the cameras as they stand."""

    def __init__(self, inputs: Inputs, found: Standing) -> None:
        """Of a task's inputs, and how its cameras stand."""
        scope = TaskScope(**{name: getattr(inputs, name) for name in TaskScope.__dataclass_fields__})
        source_rig = turned(inputs.source_rig, found.turns)
        super().__init__(replace(scope, rig=turned(inputs.rig, found.turns), source_rig=source_rig))
        self._inputs, self.standing = inputs, found

    def span(self, array: str) -> range:
        """As the task's own."""
        return self._inputs.span(array)

    def read(
        self, array: str, view: int | None = None, frames: range | None = None, first: int | None = None
    ) -> np.ndarray:
        """As the task's own."""
        return self._inputs.read(array, view, frames, first)

    def footage(self, array: str) -> tuple[np.ndarray, np.ndarray]:
        """As the task's own."""
        return self._inputs.footage(array)

    def source(self, kind: str) -> Any:
        """As the task's own."""
        return self._inputs.source(kind)


class StandingLook(Look):
    """survey/standing [5] of one view."""

    def __init__(self, name: str, inputs: Inputs, view: int) -> None:
        """name: of the array; inputs: with the cameras as they stand, as the survey gives them."""
        assert isinstance(inputs, AsTheyStand), f"{name} is asked for, so it was found first"
        self._name, self._rows, self._view = name, told(inputs.standing, inputs), view

    def blocks(self) -> Iterator[Block]:
        """Of what was found before."""
        yield Block(self._name, self._rows[self._view], self._view)


def told(found: Standing, inputs: Inputs) -> np.ndarray:
    """[V, 5] float32, as `survey/standing` holds it."""
    apart = found.apart / float(inputs.rig.size.max())
    wrong = np.isin(np.arange(len(apart)), list(found.wrong)) * (1 + found.exchanged)
    return np.column_stack([found.turns, apart, wrong]).astype(np.float32)


def as_they_stand(inputs: Inputs, sample: int) -> AsTheyStand:
    """A task's inputs with its source cameras as their masks say they stand in a few of the frames that all of them
    have, of a sample of so many."""
    sources = inputs.views.sources
    shared = [worked_numbers(inputs, v) for v in sources] if MASKS in inputs.facts else []
    numbers = reduce(np.intersect1d, shared) if shared else NO_FRAMES
    return AsTheyStand(inputs, standing_in(inputs, compared_numbers(sample_numbers(numbers, sample))))


def standing_in(inputs: Inputs, numbers: Sequence[int] | np.ndarray) -> Standing:
    """How source cameras stand by their masks in source frames `numbers`; as they are written down where there are no
    masks, or fewer than `FEWEST` of them."""
    rig, warps = inputs.rig, dict[int, Warp]()
    masks = [masks_of(inputs, int(n), warps) for n in numbers] if MASKS in inputs.facts else []
    masks = [m for m in masks if len(m) >= FEWEST]
    parts = [
        str((rig.digest, [sorted(m) for m in masks])).encode(),
        *(m[v].tobytes() for m in masks for v in sorted(m)),
    ]
    key = blake2b(b"".join(parts)).digest()
    if key not in _KEPT:
        _KEPT[key] = standing(rig, [Outlined.of(rig, m) for m in masks])
    while len(_KEPT) > KEPT:
        _KEPT.pop(next(iter(_KEPT)))
    return _KEPT[key]
