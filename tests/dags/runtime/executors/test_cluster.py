"""Pools of workers: thread limits, GPU pins (with stand-ins), workers that die or hang,
schedulers of others, refusals."""

from __future__ import annotations

import ctypes
import time
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from distributed import Client, WorkerPlugin

from posegaussian.dags.config.settings import RunSettings
from posegaussian.dags.planning import resources
from posegaussian.dags.planning.resources import CPU, GPU, Pool, local_pools, refusals
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.runtime.events import Event, TaskDone, TaskFailed, TaskRetried
from posegaussian.dags.runtime.executors.dask import DaskBackend, start_local
from posegaussian.dags.runtime.in_flight import Rules
from posegaussian.dags.runtime.scheduler import Run
from posegaussian.dags.runtime.work_order import RunTerms
from posegaussian.storage.archive.receipts import scan_receipts
from posegaussian.storage.model.errors import ConfigError
from tests.support.clusters import Cluster
from tests.support.pipeline import Pipeline, assert_same_content, content

RENDERING = Selection(start="rendering")


@pytest.fixture
def archive(finished: Pipeline, tmp_path: Path) -> Pipeline:
    return finished.copy(tmp_path / "archive")


def workers_of(pipeline: Pipeline, *stages: str) -> dict[str, set[str]]:
    """{stage: names of the workers in its receipts}."""
    found: dict[str, set[str]] = {s: set() for s in stages}
    for r in scan_receipts(pipeline.context().sequence):
        if r.stage in found:
            found[r.stage].add(r.facts["worker"])
    return found


def thread_counts() -> dict[str, int]:
    """What each library would use in this worker, as it is set before any task ran."""
    import cv2
    import numba
    import OpenImageIO
    import torch
    import zarr

    return {
        "torch": torch.get_num_threads(),
        "cv2": cv2.getNumThreads(),
        "numba": numba.config.NUMBA_NUM_THREADS,
        "OpenImageIO": OpenImageIO.get_int_attribute("threads"),
        "zarr": zarr.config.get("threading.max_workers"),
        "zarr async": zarr.config.get("async.concurrency"),
    }


def test_every_worker_limits_the_threads_of_every_library() -> None:
    with start_local(RunSettings(workers=2)) as cluster, Client(cluster, set_as_default=False) as client:
        client.wait_for_workers(2, timeout=60)
        found = client.run(thread_counts)
    assert len(found) == 2
    for counts in found.values():
        assert counts == {"torch": 1, "cv2": 1, "numba": 1, "OpenImageIO": 1, "zarr": 4, "zarr async": 4}


def test_without_a_gpu_rendering_falls_to_the_cpu_workers_with_a_sentence() -> None:
    backend = DaskBackend(RunSettings(workers=1, window=3, gpus=0))
    try:
        assert any(
            "no worker has a GPU: network, refinement and rendering run on the CPU workers" in s
            for s in backend.sentences
        )
        assert backend.pool(1) == backend.pool(0) == CPU
        assert backend.free(CPU) == 3
    finally:
        backend.close()


def test_every_gpu_task_runs_on_a_gpu_worker_and_nothing_else_does(archive: Pipeline, finished: Pipeline) -> None:
    """Stand-ins for devices: named, tagged and scheduled like GPU workers, computing on the CPU."""
    backend = DaskBackend(RunSettings(workers=1, gpus=1, window=3))
    assert "GPU work is pinned to 1 GPU worker" in backend.sentences[0]
    assert backend.free(GPU) == backend.free(CPU) == 3, "a window for each pool"
    archive.run(selection=RENDERING, backend=backend)
    found = workers_of(archive, "rendering", "metrics")
    assert found == {"rendering": {"gpu-0"}, "metrics": {"cpu-0"}}
    assert_same_content(content(archive), content(finished))


class Sabotage(WorkerPlugin):
    """In every worker, also in those started later: partition 1 of gaussians takes ever more memory, partition 2
    hangs in one C call that holds the interpreter."""

    def setup(self, worker: object) -> None:
        import posegaussian.stages.gaussians.run as gaussians

        real = gaussians.run

        def run(inputs: object, params: object) -> object:
            if inputs.partition.start == 2:  # type: ignore[attr-defined]
                hog = []
                for _ in range(60):  # 4.8 GB, were nobody to stop it
                    hog.append(np.ones(10**7))
                    time.sleep(0.02)
            if inputs.partition.start == 4:  # type: ignore[attr-defined]
                ctypes.PyDLL(None).pause()
            return real(inputs, params)  # type: ignore[arg-type]

        gaussians.run = run


def test_a_worker_that_dies_or_hangs_takes_only_its_own_task_along(archive: Pipeline) -> None:
    events: list[Event] = []
    selection = Selection(only=frozenset({"gaussians"}), force=frozenset({"gaussians"}))
    backend = DaskBackend(RunSettings(workers=1, window=3, gpus=0, memory=1200))
    backend._client.register_plugin(Sabotage(), name="sabotage")
    Run(
        [archive.plan(selection=selection)],
        selection,
        backend,
        [events.append],
        rules=Rules(RunTerms("r", timeout=6.0)),
    ).go()
    failed = {e.task.partition: e for e in events if isinstance(e, TaskFailed)}
    assert {p: e.kind for p, e in failed.items()} == {1: "memory or crash", 2: "timed out"}
    assert (
        "its worker cpu-0 died: killed for memory, or crashed; it was tried once more alone; give it more memory"
        in failed[1].error
    )
    assert "it took longer than 6 s (run.timeout); raise run.timeout" in failed[2].error
    assert [(e.task.stage, e.task.partition) for e in events if isinstance(e, TaskRetried)] == [("gaussians", 1)], (
        "what only waited on the worker is no suspect"
    )
    assert [e.task.partition for e in events if isinstance(e, TaskDone)] == [0]


def test_a_scheduler_and_workers_of_others_are_used_by_address(
    archive: Pipeline, finished: Pipeline, tmp_path: Path
) -> None:
    """Separate processes, one worker with the GPU resource and one without; neither declares a CPU resource."""
    with ExitStack() as stack:
        others = Cluster(stack, tmp_path / "scheduler.json")
        others.add("plain")
        settings = RunSettings(scheduler=others.address())
        with pytest.raises(ConfigError, match="does not see the archive /nowhere; mount it there"):
            DaskBackend(settings, Path("/nowhere"))
        others.add("with-gpu", "--resources", "GPU=1")
        others.address()
        backend = DaskBackend(settings, archive.root)
        assert set(backend.pools) == {CPU, GPU}
        assert backend.pools[GPU].devices == 1
        archive.run(selection=RENDERING, backend=backend)
    ran = workers_of(archive, "rendering", "metrics")
    assert ran["rendering"] == {"with-gpu"}
    assert ran["metrics"] == {"plain"}, "CPU work goes to workers without a GPU"
    assert_same_content(content(archive), content(finished))


def needing(monkeypatch: pytest.MonkeyPatch, **more: int) -> None:
    """Have the rendering stage ask for more."""
    from posegaussian.stages.registry import STAGES

    asked = [
        (
            replace(s, needs=lambda shape, params, s=s: replace(s.needs(shape, params), **more))
            if s.name == "rendering"
            else s
        )
        for s in STAGES
    ]
    monkeypatch.setattr(resources, "STAGES", tuple(asked))


def test_what_no_worker_can_serve_is_refused_with_what_to_change(
    archive: Pipeline, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = archive.plan(selection=RENDERING)
    served = {CPU: Pool(2, 0, 8 * 2**30), GPU: Pool(1, 1, 8 * 2**30)}
    assert refusals([plan], served) == []
    needing(monkeypatch, gpu=2)
    (sentence,) = refusals([plan], served)
    assert sentence.startswith("rendering of sequence person asks for 2 GPUs a task, the best equipped worker has 1")
    assert "--resources GPU=2" in sentence
    assert "run.gpus=0" in sentence
    assert refusals([plan], {CPU: served[CPU]}) == [], "without any GPU it runs on the CPU workers"
    assert refusals([archive.plan()], served) == [], "what is fresh asks for nothing"
    needing(monkeypatch, ram=2**40)
    (sentence,) = refusals([plan], local_pools(RunSettings(memory=4000, workers=3, gpus=0)))
    assert "MB for one task, a CPU worker may use 4000 MB; use fewer run.workers (now 3), raise run.memory" in sentence


def test_plan_refuses_what_this_machine_cannot_serve(archive: Pipeline, monkeypatch: pytest.MonkeyPatch) -> None:
    from typer.testing import CliRunner

    from posegaussian.dags.cli.app import app

    needing(monkeypatch, gpu=2)
    words = [
        "plan",
        "--archive",
        str(archive.root),
        "--from",
        "rendering",
        "--scheduler",
        "local",
        "--set",
        "run.gpus=1",
    ]
    words = [w for w in words if w not in ("--scheduler", "local")]
    for a in [*archive.assignments, "run.scheduler=local"]:
        words += ["--set", a]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 2, done.output
    assert "asks for 2 GPUs a task" in done.output
