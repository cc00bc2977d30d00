"""How many workers a run starts: as many as the cores and the memory of the machine have room for."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import NoReturn

import pytest

from posegaussian.dags.budget.probe import Probe
from posegaussian.dags.config.settings import RunSettings
from posegaussian.dags.planning import resources
from posegaussian.dags.planning.plan import Plan
from posegaussian.dags.planning.resources import cpu_workers, fitted, gpu_workers, local_pools, refusals
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.planning.task_cost import needs_of
from posegaussian.dags.runtime.executors import dask
from posegaussian.stages.registry import stage as stage_named
from posegaussian.storage.model.errors import SchedulerLost
from tests.support.pipeline import NAME, Pipeline


@pytest.fixture
def archive(finished: Pipeline, tmp_path: Path) -> Pipeline:
    """A copy of the finished archive."""
    return finished.copy(tmp_path / "archive")


def machine(monkeypatch: pytest.MonkeyPatch, memory: float, cores: int = 16, devices: tuple[str, ...] = ()) -> None:
    """With so many bytes, cores, and GPUs of 80 GB."""
    monkeypatch.setattr(resources, "machine_memory", lambda: int(memory))
    monkeypatch.setattr(resources.os, "cpu_count", lambda: cores)
    monkeypatch.setattr(resources, "visible_gpus", lambda: list(devices))
    monkeypatch.setattr(resources, "device_memory", lambda device: 80_000)


def most(plan: Plan) -> int:
    """Bytes that the largest task of a plan needs."""
    made = {(t.stage, t.path) for t in plan.to_make}
    return max(needs_of(plan.context, stage_named(s), p).ram for s, p in made)


@pytest.mark.parametrize("share", [0.9, 1.0, 2.6, 100.0])
def test_where_memory_is_short_there_are_fewer_workers_than_cores(
    archive: Pipeline, monkeypatch: pytest.MonkeyPatch, share: float
) -> None:
    """As many as the largest task fits into, and one at least; so nothing is refused that one worker could do."""
    local = archive.with_settings("gaussians.footprint=0.6", "run.scheduler=local")
    plan, run = local.plan(), local.configuration.default.run
    need = most(plan)
    machine(monkeypatch, need * share)
    found, said = fitted(run, [plan])
    if share >= 1:
        assert cpu_workers(found) == min(16, int(share))
    assert len(said) == (cpu_workers(found) < 16)
    pools = local_pools(found)
    assert bool(refusals([plan], pools)) == (share < 1)
    assert bool(local.session.refusals([plan])) == (share < 1)
    told = " ".join(refusals([plan], local_pools(run.model_copy(update={"workers": 1}))))
    assert "fewer" not in told, "there is one already"
    assert "run.memory" not in told, "it may use all there is"
    for chosen in ({"workers": 16}, {"scheduler": "serial"}):
        kept = run.model_copy(update=chosen)
        assert fitted(kept, [plan]) == (kept, ()), "what is chosen stays"
    assert fitted(run, []) == (run, ())


def test_memory_that_is_asked_for_must_be_there_for_each_worker(
    archive: Pipeline, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = archive.with_settings("gaussians.footprint=0.6").plan()
    machine(monkeypatch, 8e9)
    for asked, workers in ((3000, 2), (100, 16), (9000, 1)):
        found, said = fitted(RunSettings(memory=asked), [plan])
        assert (cpu_workers(found), found.memory, len(said)) == (workers, asked, workers < 16)


def test_what_no_machine_of_this_size_could_do_takes_no_worker_from_the_rest(
    archive: Pipeline, monkeypatch: pytest.MonkeyPatch
) -> None:
    light = archive.with_settings("gaussians.footprint=0.6").plan()
    heavy = archive.with_settings("gaussians.footprint=0.7").plan()
    need = most(light)
    monkeypatch.setattr(
        resources,
        "needs_of",
        lambda context, stage, path=None, frames=None: replace(
            needs_of(context, stage, path, frames),
            ram=needs_of(context, stage, path, frames).ram * (100 if context is heavy.context else 1),
        ),
    )
    machine(monkeypatch, 4 * need)
    found, _ = fitted(RunSettings(), [light, heavy])
    assert cpu_workers(found) == 4
    assert refusals([heavy], local_pools(found))
    assert not refusals([light], local_pools(found))


@pytest.mark.parametrize(("share", "workers", "gpus"), [(2.5, 1, 1), (3.5, 1, 2), (6.2, 2, 4), (100.0, 13, 4)])
def test_workers_that_share_a_gpu_are_fewer_too(
    archive: Pipeline, monkeypatch: pytest.MonkeyPatch, share: float, workers: int, gpus: int
) -> None:
    plan = archive.with_settings("gaussians.footprint=0.6").plan()
    machine(monkeypatch, most(plan) * share, devices=("0",))
    found, said = fitted(RunSettings(), [plan])
    assert (cpu_workers(found), len(gpu_workers(found)), bool(said)) == (workers, gpus, workers < 13)
    assert not refusals([plan], local_pools(found))
    asked = RunSettings(gpus=4, workers=16)
    assert fitted(asked, [plan]) == (asked, ())
    told = " ".join(refusals([plan], local_pools(asked))) if share < 20 else "run.workers (now 16) or run.gpus (now 4)"
    assert "run.workers (now 16) or run.gpus (now 4)" in told


def test_a_run_starts_as_many_workers_as_fit(archive: Pipeline, monkeypatch: pytest.MonkeyPatch) -> None:
    local = archive.with_settings("gaussians.footprint=0.6", "run.scheduler=local")
    plan = local.plan()
    machine(monkeypatch, 3 * most(plan))
    started: list[RunSettings] = []

    def note(settings: RunSettings, root: Path) -> NoReturn:
        started.append(settings)
        raise SchedulerLost("nobody is started here")

    monkeypatch.setattr(dask, "DaskBackend", note)
    session = local.session
    session.backend([plan])
    session.run([plan], Selection())
    Probe(session.undecided(NAME, ()), session, 1).start()
    assert [s.workers for s in started] == [3, 3, 3]


def test_the_setting_that_makes_a_task_smaller_is_named_and_does(archive: Pipeline) -> None:
    """Of every stage that pictures are drawn by, the judge's own beside those of the others."""
    for stage in (stage_named(name) for name in ("judge", "depth", "refinement", "rendering")):
        owner, _, key = stage.sized_by.partition(".")
        assert key == "size"
        assert owner == ("judge" if stage.name == "judge" else "frames")
    context = archive.context()
    small = archive.with_settings("judge.size=32").context()
    assert needs_of(small, stage_named("judge")).ram < needs_of(context, stage_named("judge")).ram
