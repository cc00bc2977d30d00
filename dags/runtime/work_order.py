"""What a worker is told of one task, and the rules of the run it belongs to: plain data, about ten kilobytes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from posegaussian.dags.planning.fingerprint import PlannedAsset
from posegaussian.dags.planning.task_cost import Load
from posegaussian.stages.contract.io import TaskScope
from posegaussian.storage.archive.receipts import ReceiptKey, ShardFile
from posegaussian.storage.model.cameras import CameraPath


@dataclass(frozen=True)
class ArrayReading:
    """How one array is read: its name, dimensions, frames, and the files that hold each view."""

    name: str
    dims: tuple[str, ...]
    span: range
    files: dict[int | None, tuple[ShardFile, ...]]


@dataclass(frozen=True)
class RunTerms:
    """The rules of the run a task belongs to; nothing here can change a result."""

    run: str = "alone"
    """Name of the run."""
    lease: float = 60.0
    """Seconds a lease holds without renewal."""
    timeout: float | None = None
    """Seconds a task may take; None: any time."""
    kept: int | None = None
    """Bytes of results of other settings that may lie aside; None: as they are, and nothing is put aside."""


@dataclass(frozen=True)
class Promise:
    """What a task counts on: a receipt that promises an output of a certain content."""

    key: ReceiptKey
    array: str
    view: int | None
    digest: str


@dataclass(frozen=True, repr=False)
class WorkOrder:
    """Everything a worker needs to know about one task, about ten kilobytes."""

    root: Path
    """Folder of the sequence."""
    stage: str
    params: Any
    partition: int | None
    path_name: str | None
    scope: TaskScope
    """What the kernel is told."""
    late: tuple[int, ...]
    """Frames by which each view is late."""
    masked: bool
    """Whether pictures that lack a mask are left out."""
    path: tuple[int, CameraPath] | None
    """First frame index of the partition and of what is read along the path, and from there on the target cameras."""
    path_text: str | None
    """What the path was asked for as."""
    readings: dict[str, ArrayReading]
    """By declared name."""
    shape: dict[str, int]
    """Lengths of the dimensions of the arrays that it writes to."""
    parts: dict[str, Any]
    """Fingerprint parts."""
    source_spans: dict[str, range]
    """Frame indices that the task works on, by declared source."""
    footage: tuple[int, np.ndarray, np.ndarray]
    """First frame index of all spans, and from there on the source frame numbers [n] and which views have a picture
    of them [n, V]."""
    assets: dict[str, PlannedAsset]
    """Models and weights that the task may open, by source."""
    pictures: str | None
    """Digest of the pictures a sequence-wide stage was taken from."""
    threads: int
    gpu: int
    """GPUs the stage asks for."""
    load: Load = Load()
    """What the task is expected to take, kept beside what it took."""
    promises: tuple[Promise, ...] = ()
    """What the inputs must still be when the task is done."""
    seen: str | None = None
    """Token of the receipt that was judged and found stale; a receipt with another one was made since."""
    terms: RunTerms = RunTerms()
    """The rules of the run."""

    @property
    def key(self) -> ReceiptKey:
        """Which receipt it leads to."""
        return ReceiptKey(self.stage, self.partition, self.scope.view, self.path_name)
