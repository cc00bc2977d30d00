"""A stage's task whose arrays lie in memory: later stages' own kernels, run on a few reduced frames."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from posegaussian.stages.contract.facts import Facts
from posegaussian.stages.contract.io import Block, Inputs, TaskScope, Views


class Frames(Inputs):
    """Frames in memory: what kernels yield is put among the arrays, and read by the next."""

    def __init__(self, scope: TaskScope, arrays: dict[str, np.ndarray]) -> None:
        """`arrays`: [F, V, ...] by name, over the frames of the scope's partition."""
        super().__init__(scope)
        self._scope, self._arrays = scope, arrays

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """What there is, by name."""
        return self._arrays

    def span(self, array: str) -> range:
        """All frames there are."""
        return self.partition

    def read(
        self, array: str, view: int | None = None, frames: range | None = None, first: int | None = None
    ) -> np.ndarray:
        """Whole, or one view's; of all frames, or of some."""
        data = self._arrays[array]
        chosen = data if view is None else data[:, view]
        chosen = chosen if frames is None else chosen[frames.start : frames.stop]
        return chosen if first is None else chosen[:, :first]

    def footage(self, array: str) -> tuple[np.ndarray, np.ndarray]:
        """Of all frames."""
        return self.source_frames, self.valid

    def source(self, kind: str) -> Any:
        """Raise: files were read when the frames were."""
        raise KeyError(f"there are arrays alone here, and no {kind}")

    def put(self, blocks: Iterable[Block]) -> None:
        """Keep what a kernel yields, view by view, in the place of what had its name."""
        made: dict[str, np.ndarray] = {}
        for block in blocks:
            data = np.asarray(block.data)
            if block.view is None:
                made[block.array] = data
                continue
            whole = made.setdefault(block.array, np.zeros((len(data), len(self.rig), *data.shape[1:]), data.dtype))
            whole[:, block.view] = data
        self._arrays.update(made)

    def with_facts(self, facts: Facts) -> Frames:
        """The same arrays under other facts; what is put from then on is not shared."""
        return Frames(replace(self._scope, facts=facts), dict(self._arrays))

    def with_array(self, name: str, data: np.ndarray) -> Frames:
        """The same with another array in the place of one."""
        return Frames(self._scope, {**self._arrays, name: data})

    def without(self, view: int) -> Frames:
        """The same arrays, but the view is no source: nothing of it is drawn."""
        views = Views(self.views.names, tuple(v for v in self.views.sources if v != view), self.views.held_out)
        return Frames(replace(self._scope, views=views), self._arrays)
