"""The pipeline in tests: film, register, run in this process, compare archives by content."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from rich.console import Console

from posegaussian.dags.config.settings import Configuration, load_configuration
from posegaussian.dags.importing.register import find_capture, register
from posegaussian.dags.planning.context import Context
from posegaussian.dags.planning.plan import Plan
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.runtime.events import Event, RunEnded, TaskDone
from posegaussian.dags.runtime.eviction import Keeper
from posegaussian.dags.runtime.executors.serial import SerialBackend
from posegaussian.dags.runtime.in_flight import Backend
from posegaussian.dags.runtime.scheduler import Run
from posegaussian.dags.session.session import Session
from posegaussian.stages.simulator.subjects.capsule_person import PersonCapture, capture_person
from posegaussian.storage.archive.receipts import scan_receipts
from posegaussian.storage.archive.store import Archive
from posegaussian.storage.exporters.images_layout import write_capture

NAME = "person"
FORCED = {
    "calibration_correction": "off",
    "temporal_smoothing": "on",
    "noise_averaging": "off",
    "exposure_matching": "off",
    "outline_correction": "off",
    "gap_opening": "off",
    "outline_redrawing": "off",
    "limb_bounds": "off",
    "pose_blending": "off",
    "source_detail": "on",
    "silhouette_clipping": "on",
    "hole_filling": "on",
    "outline_evening": "on",
}
"""Effects that are decided by the survey, and what they are in most tests."""
HEATMAPS = ("keep={pose/heatmaps: always, smoothing/heatmaps: always}",)
"""Heatmaps are made."""

COMPILED = {"codec_pipeline.path": "zarrs.ZarrsCodecPipeline"}
"""Reads arrays of many small chunks in a seventh of the time that zarr itself takes."""


def film(
    folder: Path,
    views: int = 6,
    size: int = 48,
    frames: int = 6,
    held_out: int = 1,
    motion: str = "kick",
    **leave_out: bool,
) -> PersonCapture:
    """Write the person as an `images` capture; masks=False, joints=False, depth=False leave those out."""
    person = capture_person(views=views, size=size, frames=frames, held_out=held_out, motion=motion)
    write_capture(
        folder,
        person.rig,
        person.color,
        mask=person.mask if leave_out.get("masks", True) else None,
        joints2d=person.joints2d if leave_out.get("joints", True) else None,
        depth=person.depth if leave_out.get("depth", True) else None,
        frame_rate=person.frame_rate,
    )
    return person


@dataclass
class Pipeline:
    """One archive with one sequence, and settings to run it with."""

    root: Path
    folder: Path
    settings: list[str] = field(default_factory=list)
    partition: int = 2
    held_out: str = "[mid00]"

    @property
    def assignments(self) -> list[str]:
        # Every quick stage has something to do, and none waits for the survey or the judge; tests of what these decide
        # set it back to auto. Heatmaps are asked for by name: without the network nobody reads them.
        forced = [f"effects.{e}={state}" for e, state in FORCED.items()]
        matched = [] if any(s.startswith("views.sources") for s in self.settings) else ["depth.method=sgbm"]
        fixed = ["run.scheduler=serial", "views.trust=all", "network.weights=none", "refinement.steps=0"]
        fixed += [*HEATMAPS, *matched, *forced]
        return [f"partition.frames={self.partition}", f"views.held_out={self.held_out}", *fixed, *self.settings]

    @property
    def configuration(self) -> Configuration:
        return load_configuration(None, self.assignments, folder=self.root)

    @property
    def options(self) -> list[str]:
        """What the command line needs to mean this archive under these settings."""
        return ["--archive", str(self.root), *(word for a in self.assignments for word in ("--set", a))]

    def start(self, *more: str, command: str = "run", **options: Any) -> subprocess.Popen:
        """The command line on this archive, as a process of its own."""
        return subprocess.Popen(
            [sys.executable, "-m", "posegaussian.dags.cli.app", command, *self.options, *more],
            cwd=self.root,
            env={**os.environ, "PYTHONPATH": os.getcwd()},
            text=True,
            **options,
        )

    @property
    def session(self) -> Session:
        return Session(self.configuration, str(self.root), Console(quiet=True))

    def register(self) -> None:
        settings = self.configuration.for_sequence(NAME)
        register(
            Archive.open(str(self.root), create=True), NAME, find_capture("images", self.folder, [], settings), settings
        )

    def with_settings(self, *more: str) -> Pipeline:
        return Pipeline(self.root, self.folder, [*self.settings, *more], self.partition, self.held_out)

    def copy(self, to: Path) -> Pipeline:
        shutil.copytree(self.root, to)
        return Pipeline(to, self.folder, self.settings, self.partition, self.held_out)

    def context(self, *paths: str) -> Context:
        return self.session.context(NAME, paths)

    def plan(self, *paths: str, selection: Selection | None = None) -> Plan:
        return self.session.plan(NAME, selection or Selection(), paths)

    def run(
        self,
        *paths: str,
        selection: Selection | None = None,
        backend: Backend | None = None,
        expect_failure: bool = False,
    ) -> list[Event]:
        """Run and return the events; a failed task fails the test with its own words unless expected."""
        events: list[Event] = []
        selection = selection or Selection()
        plan = self.plan(*paths, selection=selection)
        ended = Run([plan], selection, backend or SerialBackend(), [events.append, Keeper([plan])]).go()
        if not expect_failure:
            assert (ended.failed, ended.blocked) == (0, 0), [e for e in events if "Failed" in type(e).__name__]
        return events

    def ran(self, *paths: str, selection: Selection | None = None) -> dict[str, int]:
        """Run; how many tasks of each stage were computed."""
        counts: dict[str, int] = {}
        for e in self.run(*paths, selection=selection):
            if isinstance(e, TaskDone):
                counts[e.task.stage] = counts.get(e.task.stage, 0) + 1
        return counts


def ended(events: list[Event]) -> RunEnded:
    last = events[-1]
    assert isinstance(last, RunEnded)
    return last


def content(pipeline: Pipeline, but: tuple[str, ...] = ()) -> dict[str, bytes | list]:
    """{array: dtype, shape and all bytes} of every array, and {table: rows}, of the sequence; names starting with
    `but` left out."""
    root = pipeline.root / NAME
    found: dict[str, bytes | list] = {}
    for meta in sorted(root.rglob("zarr.json")):
        name = meta.parent.relative_to(root).as_posix()
        if json.loads(meta.read_bytes()).get("node_type") != "array" or name.startswith(but or ("\0",)):
            continue
        with zarr.config.set(COMPILED):
            values = np.asarray(zarr.open_array(meta.parent, mode="r")[...])
        found[name] = f"{values.dtype}{values.shape}".encode() + values.tobytes()
    import pyarrow.parquet as pq

    for file in sorted(root.rglob("metrics/**/*.parquet")):
        table = "metrics/" + file.parent.name
        if table.startswith(but or ("\0",)):
            continue
        found[table] = [*found.get(table, []), *pq.read_table(file).to_pylist()]
    return found


def receipts(pipeline: Pipeline) -> dict[tuple, tuple]:
    """{task: (fingerprint, outputs)} of all receipts."""
    sequence = Archive.open(str(pipeline.root)).sequence(NAME)
    return {
        (r.stage, r.partition, r.view, r.path): (r.fingerprint, tuple((o.array, o.view, o.digest) for o in r.outputs))
        for r in scan_receipts(sequence)
    }


def assert_same_content(a: dict, b: dict) -> None:
    assert a.keys() == b.keys()
    different = [name for name in a if a[name] != b[name]]
    assert not different, f"content differs: {different}"
