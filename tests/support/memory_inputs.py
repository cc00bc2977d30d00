"""A stand-in for the store: `Inputs` over plain numpy arrays, so that kernels are tested without an archive."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from copy import copy
from dataclasses import fields
from typing import Any

import numpy as np

from posegaussian.stages.contract.declaration import Params, Stage, resolve
from posegaussian.stages.contract.facts import Facts
from posegaussian.stages.contract.io import Block, TaskScope, Views
from posegaussian.stages.contract.path_inputs import PathInputs
from posegaussian.stages.contract.timing import TimedInputs
from posegaussian.storage.model.cameras import CameraPath, Rig
from posegaussian.storage.model.spec import LISTED, ArraySpec

TIME_INVARIANT = frozenset(
    {
        "survey/plate",
        "survey/spread",
        "survey/sample",
        "survey/motion",
        "survey/outlines",
        "survey/gaps",
        "survey/slopes",
        "survey/noise",
        "survey/unrest",
        "survey/light",
        "survey/drift",
        "tracks/people",
        "tracks/choice",
    }
)
NEEDING_THE_SURVEY = {
    "light_steadying",
    "noise_averaging",
    "exposure_matching",
    "outline_redrawing",
    "outline_correction",
    "gap_opening",
    "limb_bounds",
    "pose_blending",
    "tone_mapping",
    "surface_closing",
}
"""Effects that read an array of the survey, or follow from one that does."""


class MemoryInputs(PathInputs, TimedInputs):
    """Arrays are whole sequences, [F, V, ...] or [F, ...]; the partition and halo are cut here as the runner does."""

    def __init__(
        self,
        stage: Stage,
        params: Params,
        arrays: dict[str, np.ndarray],
        rig: Rig,
        views: Views,
        partition: range,
        frames: int,
        view: int | None = None,
        path: CameraPath | None = None,
        sources: dict[str, Any] | None = None,
        facts: frozenset[str] = frozenset({"several_frames"}),
        joint_set: str | None = "coco17",
        source_rig: Rig | None = None,
        valid_all: np.ndarray | None = None,
        captured_to_calibrated: np.ndarray | None = None,
        effects: frozenset[str] | None = None,
    ) -> None:
        """Of one task. `path`: of the whole sequence. `effects`: those that are on; None: all the stage declares that
        need no array of the survey."""
        on = {e.name for e in stage.effects} - NEEDING_THE_SURVEY if effects is None else effects
        crops = np.tile([1.0, 0.0, 0.0], (len(rig), 1)) if captured_to_calibrated is None else captured_to_calibrated
        self.stage, self.params, self.arrays, self.frames, self.sources = stage, params, arrays, frames, sources or {}
        self.valid_all = np.ones((frames, len(rig)), bool) if valid_all is None else valid_all
        self.whole_path = path
        numbers, valid = np.asarray(partition), self.valid_all[list(partition)]
        super().__init__(
            TaskScope(
                partition=partition,
                source_frames=numbers,
                time=numbers / 30.0,
                valid=valid,
                views=views,
                view=view,
                rig=rig,
                source_rig=source_rig or rig,
                captured_to_calibrated=crops,
                path=None if path is None else path.slice(slice(partition.start, partition.stop)),
                facts=Facts(facts | on),
                joint_set=joint_set,
            )
        )

    def but(self, **scope: Any) -> MemoryInputs:
        """The same with another scope."""
        other = copy(self)
        TaskScope.__init__(other, **{f.name: scope.get(f.name, getattr(self, f.name)) for f in fields(TaskScope)})
        return other

    def span(self, array: str) -> range:
        own = (r for r in self.stage.reads if r.array == array)
        before, after = next((r.halo_for(self.params, self.facts) for r in own), (0, 0))
        return range(max(0, self.partition.start - before), min(self.frames, self.partition.stop + after))

    def footage(self, array: str) -> tuple[np.ndarray, np.ndarray]:
        span = self.span(array)
        return np.asarray(span), self.valid_all[span.start : span.stop]

    def path_over(self, array: str) -> CameraPath:
        assert self.whole_path is not None, "a task along a path"
        span = self.span(array)
        return self.whole_path.slice(slice(span.start, span.stop))

    def read(
        self, array: str, view: int | None = None, frames: range | None = None, first: int | None = None
    ) -> np.ndarray:
        data = self.arrays[array]
        if array in TIME_INVARIANT:
            return data if view is None else data[view]
        s = self.span(array) if frames is None else frames
        data = data[s.start : s.stop]
        data = data if view is None else data[:, view]
        return data if first is None else data[:, :first]

    def source(self, kind: str) -> Any:
        return self.sources[kind]

    def timed(self, module: str) -> AbstractContextManager[None]:
        return nullcontext()


def run_stage(
    stage: Stage,
    params: Params,
    arrays: dict[str, np.ndarray],
    rig: Rig,
    views: Views,
    frames: int,
    length: int | None = None,
    **more: Any,
) -> dict[str, Any]:
    """Run a stage over a whole sequence in partitions of `length` frames and put the blocks together.

    Returns {array: [F, V, ...]} (views without a block are missing from a dict {view: array} when they differ), tables
    as lists of column dicts.
    """
    length = length or frames
    whole: dict[str, Any] = {}
    for start in range(0, frames, length):
        part = range(start, min(start + length, frames))
        inputs = MemoryInputs(stage, params, arrays, rig, views, part, frames, **more)
        for block in resolve(stage.run)(inputs, params):
            _place(stage, whole, block, part, frames, len(rig))
    return whole


def _place(stage: Stage, whole: dict[str, Any], block: Block, part: range, frames: int, views: int) -> None:
    spec = next(w for w in stage.writes if w.name == block.array)
    if not isinstance(spec, ArraySpec):
        whole.setdefault(spec.name, []).append(block.data)
        return
    data = np.asarray(block.data)
    assert data.dtype == np.dtype(spec.dtype), f"{spec.name}: {data.dtype} is not the declared {spec.dtype}"
    if not spec.per_frame:
        target = whole.setdefault(spec.name, np.zeros((views, *data.shape), data.dtype) if spec.per_view else data)
        if block.view is not None:
            target[block.view] = data
        return
    assert data.shape[0] == len(part), f"{spec.name}: {data.shape[0]} frames for a partition of {len(part)}"
    shape = (frames, views, *data.shape[1:]) if block.view is not None else (frames, *data.shape[1:])
    target = whole.setdefault(spec.name, np.zeros(shape, data.dtype))
    if LISTED in spec.dims:  # a view's and a partition's list may be longer than another's
        longest = max(target.shape[2], data.shape[1])
        target, data = (_longer(a, axis, longest) for a, axis in ((target, 2), (data, 1)))
        whole[spec.name] = target
    if block.view is None:
        target[part.start : part.stop] = data
    else:
        target[part.start : part.stop, block.view] = data


def _longer(array: np.ndarray, axis: int, length: int) -> np.ndarray:
    return np.pad(array, [(0, length - n if i == axis else 0) for i, n in enumerate(array.shape)])
