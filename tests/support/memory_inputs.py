"""A stand-in for the store: `Inputs` over plain numpy arrays, so that kernels are tested without an archive."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from posegaussian.stages.contract.declaration import Params, Stage, resolve
from posegaussian.stages.contract.io import Block, Views
from posegaussian.storage.model.cameras import CameraPath, Rig
from posegaussian.storage.model.spec import ArraySpec


@dataclass
class MemoryInputs:
    """Arrays are whole sequences, [F, V, ...] or [F, ...]; the partition and halo are cut here as the runner does."""

    stage: Stage
    params: Params
    arrays: dict[str, np.ndarray]
    rig: Rig
    views: Views
    partition: range
    frames: int
    view: int | None = None
    path: CameraPath | None = None
    sources: dict[str, Any] = field(default_factory=dict)
    facts: frozenset[str] = frozenset({"several_frames"})
    joint_set: str | None = "coco17"
    source_rig: Rig = None  # type: ignore[assignment]
    valid_all: np.ndarray | None = None
    captured_to_calibrated: np.ndarray = None  # type: ignore[assignment]
    time_invariant: frozenset[str] = frozenset(
        {
            "survey/plate",
            "survey/spread",
            "survey/sample",
            "survey/colors",
            "survey/motion",
            "survey/outlines",
            "survey/noise",
            "survey/light",
        }
    )
    effects: frozenset[str] | None = None
    """Effects that are on; None: all the stage declares that need no array of the survey."""

    def __post_init__(self) -> None:
        on = (
            {e.name for e in self.stage.effects}
            - {"exposure_matching", "outline_correction", "limb_bounds", "view_dependent_color", "tone_mapping"}
            if self.effects is None
            else self.effects
        )
        self.facts = self.facts | on
        self.source_rig = self.source_rig or self.rig
        if self.captured_to_calibrated is None:
            self.captured_to_calibrated = np.tile([1.0, 0.0, 0.0], (len(self.rig), 1))
        valid = self.valid_all if self.valid_all is not None else np.ones((self.frames, len(self.rig)), bool)
        self.valid = valid[list(self.partition)]
        self.source_frames = np.asarray(self.partition)
        self.time = np.asarray(self.partition) / 30.0

    def span(self, array: str) -> range:
        before, after = next((r.halo_for(self.params) for r in self.stage.reads if r.array == array), (0, 0))
        return range(max(0, self.partition.start - before), min(self.frames, self.partition.stop + after))

    def footage(self, array: str) -> tuple[np.ndarray, np.ndarray]:
        span = self.span(array)
        valid = self.valid_all if self.valid_all is not None else np.ones((self.frames, len(self.rig)), bool)
        return np.asarray(span), valid[span.start : span.stop]

    def read(self, array: str, view: int | None = None) -> np.ndarray:
        data = self.arrays[array]
        if array in self.time_invariant:
            return data if view is None else data[view]
        s = self.span(array)
        data = data[s.start : s.stop]
        return data if view is None else data[:, view]

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
    if block.view is None:
        target[part.start : part.stop] = data
    else:
        target[part.start : part.stop, block.view] = data
