"""One task on one worker: take its lease, read the slice, run the kernel, write whole shards, write the receipt.

The order is what makes a kill harmless: lease, old receipt removed, shards, receipt, lease dropped. The lease is what
makes a second run harmless: it is read again before every write, and a writer that lost it stops.
"""

from __future__ import annotations

import os
import platform
import socket
import sys
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager
from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from posegaussian.dags.assets.digest import asset_digest
from posegaussian.dags.compiling.kernels import compile_once
from posegaussian.dags.compiling.warm_up import WARM_UP, warm_up_timed
from posegaussian.dags.provenance import builds
from posegaussian.dags.provenance.code_digest import here_is
from posegaussian.dags.runtime import threads
from posegaussian.dags.runtime.meters import Peak, Stopwatch
from posegaussian.dags.runtime.timeout import overran, time_limit
from posegaussian.dags.runtime.work_order import ArrayReading, WorkOrder
from posegaussian.stages.contract.declaration import Stage, resolve
from posegaussian.stages.contract.io import Block
from posegaussian.stages.contract.path_inputs import PathInputs
from posegaussian.stages.contract.timing import TimedInputs
from posegaussian.stages.registry import ASSETS
from posegaussian.stages.registry import stage as stage_named
from posegaussian.storage.archive.lease import Lease
from posegaussian.storage.archive.receipts import (
    Output,
    Receipt,
    lease_file,
    missing_files,
    read_receipt,
    remove_receipt,
    write_receipt,
)
from posegaussian.storage.archive.shards import read_array, require_array, write_array, write_table
from posegaussian.storage.archive.store import SequenceGroup
from posegaussian.storage.model.cameras import CameraPath
from posegaussian.storage.model.capture import Capture
from posegaussian.storage.model.errors import ArchiveError, OtherCode
from posegaussian.storage.model.spec import ArraySpec, TableSpec, digest
from posegaussian.storage.readers.sources import open_source


@lru_cache(maxsize=8)
def _capture(root: Path, stamp: int, late: tuple[int, ...], masked: bool) -> Capture:
    return SequenceGroup(root).capture.worked(late, masked)


class StoreInputs(PathInputs, TimedInputs):
    """What a task sees of an archive."""

    def __init__(self, order: WorkOrder) -> None:
        """Open nothing yet; arrays and sources are opened when the kernel asks for them."""
        super().__init__(order.scope)
        self._order = order
        stamp = (order.root / "zarr.json").stat().st_mtime_ns
        self._capture = _capture(order.root, stamp, order.late, order.masked)
        self._stopwatch = Stopwatch()
        self._sources: dict[str, Any] = {}
        """{kind: its reader}, which remembers what it opened."""

    def _reading(self, array: str) -> ArrayReading:
        if array not in self._order.readings:
            raise KeyError(
                f"{self._order.stage} does not declare that it reads {array} under these settings; it declares"
                f" {', '.join(self._order.readings) or 'nothing'}"
            )
        return self._order.readings[array]

    def span(self, array: str) -> range:
        """Frame indices that `read(array)` covers."""
        if array in self._order.source_spans:
            return self._order.source_spans[array]
        return self._reading(array).span

    def footage(self, array: str) -> tuple[np.ndarray, np.ndarray]:
        """(source frame numbers [n], whether each view has a picture of them [n, V]) of the frames `span(array)`."""
        span, first = self.span(array), self._order.footage[0]
        own = slice(span.start - first, span.stop - first)
        return self._order.footage[1][own], self._order.footage[2][own]

    def path_over(self, array: str) -> CameraPath:
        """The target cameras of the frames `span(array)`, of a declared array along the task's path."""
        along = [name for name in self._order.readings if "{path}" in name]
        if self._order.path is None or array not in along:
            raise KeyError(
                f"{self._order.stage} reads no {array} along its path under these settings; it reads"
                f" {', '.join(along) or 'nothing there'}"
            )
        (first, path), span = self._order.path, self.span(array)
        return path.slice(slice(span.start - first, span.stop - first))

    def read(
        self, array: str, view: int | None = None, frames: range | None = None, first: int | None = None
    ) -> np.ndarray:
        """[len(span), ...] or those frames of it; only views the stage declared can be read."""
        r = self._reading(array)
        if view not in r.files:
            raise KeyError(
                f"{self._order.stage} may not read view {view} of {array}; it declared"
                f" {sorted(v for v in r.files if v is not None) or 'no views'}"
            )
        span = r.span if frames is None else frames
        if span and not (r.span.start <= span.start and span.stop <= r.span.stop):
            raise KeyError(f"{self._order.stage} may read frames {r.span} of {array}, not {span}")
        return read_array(SequenceGroup(self._order.root), r.name, r.dims, span, view, r.files[view], first)

    def timed(self, module: str) -> AbstractContextManager[None]:
        """Wall time within counts for a module of the kernel."""
        return self._stopwatch(module)

    @property
    def seconds(self) -> dict[str, float]:
        """Wall time of each module so far."""
        return self._stopwatch.seconds

    def source(self, kind: str) -> Any:
        """The lazy reader of a declared source."""
        stage = stage_named(self._order.stage)
        declared = [r.array for r in stage.reads_for(self._order.params, self.facts) if r.is_source]
        if kind not in declared:
            raise KeyError(
                f"{stage.name} does not declare the source {kind}; it declares {', '.join(declared) or 'none'}"
            )
        if kind not in self._sources:
            self._sources[kind] = self._asset(kind) if kind in self._order.assets else open_source(self._capture, kind)
        return self._sources[kind]

    def _asset(self, name: str) -> Any:
        """Models or weights. Raises OtherCode where those of this machine are not what the run was planned with."""
        (_, asset), planned = ASSETS[name], self._order.assets[name]
        if asset_digest(asset, planned.settings) != planned.digest:
            raise OtherCode(
                f"the {name} of {here_is()} has other models or weights than this run was planned with; put the same"
                " files there, then run again"
            )
        return asset.open(planned.settings)


def execute(order: WorkOrder) -> Receipt:
    """Run one task and return its receipt, which is on disk by then.

    Where another run, or an attempt that was thought lost, made the same meanwhile, that receipt is returned instead.
    Beyond its time limit the task takes this process along. Raises TaskTimedOut when it did so to another one and the
    scheduler handed it out again, LeaseHeld when another run works on it, LeaseLost when this writer's lease was taken
    over, OtherCode when code it imported is not what it was when this process began.
    """
    sequence = SequenceGroup(order.root)
    terms = order.terms
    if error := overran(order):
        raise error
    with (
        Lease.take(lease_file(sequence, order.key), terms.run, worker_name(), terms.lease) as lease,
        time_limit(terms.timeout, lease),
    ):
        return _made_meanwhile(sequence, order) or _make(sequence, order, lease)


def worker_name() -> str:
    """Name of the Dask worker this thread works for; `main` outside of one."""
    distributed = sys.modules.get("distributed")  # a task of a Dask worker finds it imported
    try:
        return "main" if distributed is None else str(distributed.get_worker().name)
    except ValueError:
        return "main"


def _made_meanwhile(sequence: SequenceGroup, order: WorkOrder) -> Receipt | None:
    """A whole receipt of this very task, written after the run judged it."""
    receipt = read_receipt(sequence, order.key)
    if receipt is None or receipt.fingerprint != digest(order.parts) or receipt.facts.get("token") == order.seen:
        return None
    return None if missing_files(sequence, receipt) or any(o.dropped for o in receipt.outputs) else receipt


def _make(sequence: SequenceGroup, order: WorkOrder, lease: Lease) -> Receipt:
    """Compute and write, from the old receipt's removal to the new one."""
    stage = stage_named(order.stage)
    kernel = resolve(stage.run)
    if "numba" in sys.modules:  # whoever has compiled kernels has imported it by now
        compile_once()
    builds.check_imports()
    threads.limit(order.threads)
    started, clock, cpu = datetime.now(UTC), time.perf_counter(), time.process_time()
    _arrays_unchanged(sequence, stage, order)
    lease.check()
    remove_receipt(sequence, order.stage, order.partition, order.scope.view, order.path_name)
    warnings: list[str] = []
    noted: dict[str, Any] = {}
    inputs = StoreInputs(order)
    with Peak() as peak, warm_up_timed(inputs.timed):
        outputs = [
            _write(sequence, stage, order, block, lease)
            for block in _noting(stage, _checked(stage, kernel(inputs, order.params), order, warnings), noted)
        ]
    _complete(stage, order, outputs)
    _inputs_unchanged(sequence, order)
    facts = _facts(order, started, time.perf_counter() - clock, time.process_time() - cpu)
    facts |= {
        "peak_rss": peak.bytes,
        "projected_ram": order.load.ram,
        "raw_bytes": order.load.raw_bytes,
        "work": order.load.work,
        "unit": order.load.unit,
    }
    facts |= {"noted": noted} if noted else {}
    spent = {name: round(s, 6) for name, s in inputs.seconds.items()}
    facts |= {WARM_UP: spent.pop(WARM_UP, 0.0)}
    facts |= {"modules": spent} if spent else {}
    facts |= {"run": lease.holder.run, "token": lease.holder.token, "worker": lease.holder.worker}
    receipt = Receipt(
        order.stage,
        order.partition,
        order.scope.view,
        order.path_name,
        digest(order.parts),
        order.parts,
        tuple(outputs),
        tuple(warnings),
        facts,
    )
    builds.check_imports()
    lease.check()
    write_receipt(sequence, receipt)
    return receipt


def _arrays_unchanged(sequence: SequenceGroup, stage: Stage, order: WorkOrder) -> None:
    """Raise ArchiveError where another run replaced an array that the task is to write: the receipt that is there
    belongs to that one, and stays."""
    for spec in stage.writes_for(order.scope.facts):
        if isinstance(spec, ArraySpec):
            require_array(sequence, spec, order.path_name or "", order.shape)


def _inputs_unchanged(sequence: SequenceGroup, order: WorkOrder) -> None:
    """Raise when what was read may not be what was ordered: a receipt is removed before any of its shards is
    touched."""
    receipts = {key: read_receipt(sequence, key) for key in {p.key for p in order.promises}}
    for p in order.promises:
        receipt = receipts[p.key]
        if receipt is None or receipt.present.get((p.array, p.view)) != p.digest:
            raise ArchiveError(
                f"{p.array} was replaced or dropped by another run while {order.stage} read it; two runs with different"
                " settings share this archive: let one end, then run again"
            )


def _checked(stage: Stage, blocks: Iterator[Block], order: WorkOrder, warnings: list[str]) -> Iterator[Block]:
    """The kernel's blocks, each past the stage's check; the check's warnings and the kernel's own notes are kept."""
    check = resolve(stage.check) if stage.check else None
    for block in blocks:
        prefix = "" if block.view is None else f"{order.scope.views.names[block.view]}: "
        found = check(block, order.params) if check is not None else []
        warnings += [prefix + w.removeprefix(f"view {block.view}: ") for w in (*block.notes, *found)]
        yield block


def _noting(stage: Stage, blocks: Iterator[Block], noted: dict[str, Any]) -> Iterator[Block]:
    """The blocks as they are; the values of those that a receipt is to keep are added to `noted`."""
    names = {w.name for w in stage.writes if isinstance(w, ArraySpec) and w.noted}
    for block in blocks:
        if block.array in names:
            noted[block.array] = np.asarray(block.data).tolist()
        yield block


def _write(sequence: SequenceGroup, stage: Stage, order: WorkOrder, block: Block, lease: Lease) -> Output:
    """Write one block whole, as long as the lease is ours."""
    spec = next((w for w in stage.writes_for(order.scope.facts) if w.name == block.array), None)
    if spec is None:
        raise ValueError(f"{stage.name} yields {block.array}, which it does not declare")
    path = order.path_name or ""
    if isinstance(spec, TableSpec):
        return write_table(sequence, spec, path, order.partition, block.data, lease.check)
    return write_array(
        sequence, spec, path, order.scope.partition, order.partition, block.view, np.asarray(block.data), lease.check
    )


def _complete(stage: Stage, order: WorkOrder, outputs: list[Output]) -> None:
    """Raise when the kernel left out a declared output: an absent shard would read as zeros."""
    got, scope = {(o.array, o.view) for o in outputs}, order.scope
    own = [scope.view] if scope.view is not None else range(len(scope.rig))
    for spec in stage.writes_for(order.scope.facts):
        name = spec.name.format(path=order.path_name or "")
        if not isinstance(spec, ArraySpec) or not spec.per_view:
            wanted: set[tuple[str, int | None]] = {(name, None)}
        else:
            wanted = {(name, v) for v in own}
        if wanted - got:
            missing = sorted(f"{a} view {v}" for a, v in wanted - got)
            raise ValueError(f"{stage.name} did not yield {', '.join(missing)}")


def _facts(order: WorkOrder, started: datetime, seconds: float, cpu_seconds: float) -> dict[str, Any]:
    """Circumstances: never part of the fingerprint."""
    torch = sys.modules.get("torch")
    return ({"path_text": order.path_text} if order.path_text else {}) | {
        "started": started.isoformat(timespec="milliseconds"),
        "seconds": round(seconds, 4),
        "cpu_seconds": round(cpu_seconds, 4),
        "host": socket.gethostname(),
        "pid": os.getpid(),
        "device": "cuda" if order.gpu and torch and torch.cuda.is_available() else "cpu",
        "machine": platform.machine(),
        "threads": order.threads,
        "libraries": builds.libraries(),
        "sources": order.pictures,
    }
