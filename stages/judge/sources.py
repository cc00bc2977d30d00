"""Frames in memory that are made from the capture's own sources: by the kernels that make them in a run."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from posegaussian.stages.contract.io import Block, Inputs, TaskScope
from posegaussian.stages.judge.memory import Frames


class FromSources(Frames):
    """Some frames of a task, whose sources and constants of the sequence are the task's own."""

    def __init__(self, scope: TaskScope, task: Inputs, arrays: dict[str, np.ndarray] | None = None) -> None:
        """Of a task that covers the scope's frames; with the arrays that were made so far."""
        super().__init__(scope, {} if arrays is None else arrays)
        self._task = task

    def source(self, kind: str) -> Any:
        """The task's reader."""
        return self._task.source(kind)

    def read(
        self, array: str, view: int | None = None, frames: range | None = None, first: int | None = None
    ) -> np.ndarray:
        """What was made of these frames, else what the task reads: constants of the whole sequence."""
        if array in self._arrays:
            return super().read(array, view, frames, first)
        return self._task.read(array, view, frames, first)

    def put(self, blocks: Iterable[Block]) -> None:
        """Keep what tasks of one view each yield, beside what was kept of other views, and what belongs to no view."""
        for block in blocks:
            data = np.asarray(block.data)
            if block.view is None:
                self._arrays[block.array] = data
                continue
            empty = np.zeros((len(data), len(self.rig), *data.shape[1:]), data.dtype)
            self._arrays.setdefault(block.array, empty)[:, block.view] = data

    def of_view(self, view: int) -> FromSources:
        """The same as a task of one view sees it."""
        return FromSources(replace(self._scope, view=view), self._task, self._arrays)
