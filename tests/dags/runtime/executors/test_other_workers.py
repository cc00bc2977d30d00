"""Workers of others: those with other code or libraries compute nothing, TLS is used as configured, a dead scheduler
is told as such."""

from __future__ import annotations

import io
import shutil
import subprocess
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import dask
import pytest
from distributed import WorkerPlugin
from rich.console import Console

from posegaussian.dags.config.settings import RunSettings, load_configuration
from posegaussian.dags.diagnostics.progress import WarningCollector
from posegaussian.dags.planning.resources import CPU, Pool
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.provenance.code_digest import ROOT
from posegaussian.dags.runtime.events import Event, Notice, TaskBlocked, TaskDone, TaskFailed, TaskLeftOut
from posegaussian.dags.runtime.executors import dask as cluster
from posegaussian.dags.runtime.executors.dask import DaskBackend
from posegaussian.dags.runtime.executors.local_cluster import start_local
from posegaussian.dags.runtime.executors.unavailable import UnreachedBackend
from posegaussian.dags.runtime.failures import Kind
from posegaussian.dags.runtime.scheduler import Run
from posegaussian.storage.archive.receipts import scan_receipts
from posegaussian.storage.model.errors import ConfigError, SchedulerLost
from tests.support.clusters import Cluster
from tests.support.pipeline import Pipeline, assert_same_content, content, ended

METRICS = Selection(only=frozenset({"metrics"}), force=frozenset({"metrics"}))
LAST = Selection(start="rendering")


@pytest.fixture
def archive(finished: Pipeline, tmp_path: Path) -> Pipeline:
    return finished.copy(tmp_path / "archive")


class OlderLibrary(WorkerPlugin):
    """A worker of this name has another numpy."""

    def __init__(self, *names: str) -> None:
        self.names = names

    def setup(self, worker: object) -> None:
        import posegaussian.dags.provenance.builds as build

        real = build._version
        if worker.name in self.names:  # type: ignore[attr-defined]
            build._version = lambda name: "1.0" if name == "numpy" else real(name)
            build.libraries.cache_clear()
            build.here.cache_clear()


def test_a_worker_with_another_library_refuses_and_another_one_does_its_tasks(
    archive: Pipeline, finished: Pipeline
) -> None:
    backend = DaskBackend(RunSettings(workers=2, gpus=0))
    backend._client.register_plugin(OlderLibrary("cpu-1"), name="older")
    events = archive.run(selection=LAST, backend=backend)
    told = [e.sentence for e in events if isinstance(e, Notice)]
    assert len(told) == 1, told
    left_out = told[0]
    assert "has other code or libraries than this run: numpy (1.0 there, " in left_out
    assert left_out.endswith("it is given nothing")
    ran = [e for e in events if isinstance(e, TaskDone)]
    assert {e.receipt.facts["worker"] for e in ran} == {"cpu-0"}
    assert len(ran) == ended(events).done == 6
    assert_same_content(content(archive), content(finished))


def test_where_no_worker_fits_the_run_fails_with_the_sentence(archive: Pipeline) -> None:
    before = {(r.stage, r.partition): r.facts["token"] for r in scan_receipts(archive.context().sequence)}
    backend = DaskBackend(RunSettings(workers=1, gpus=0))
    backend._client.register_plugin(OlderLibrary("cpu-0"), name="older")
    events = archive.run(selection=LAST, backend=backend, expect_failure=True)
    assert ended(events).done == 0
    assert ended(events).failed + ended(events).blocked == 6
    failed = [e for e in events if isinstance(e, TaskFailed)]
    assert {e.kind for e in failed} == {Kind.UNFIT.value}
    assert failed[0].error.startswith("no worker fits this run any more: worker tcp://")
    assert "numpy (1.0 there, " in failed[0].error
    assert {(r.stage, r.partition): r.facts["token"] for r in scan_receipts(archive.context().sequence)} == before


OLD = """import sys

class Gone:
    def find_spec(self, name, path=None, target=None):
        if name.startswith("posegaussian."):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Gone())
"""
"""A version from before that module: an editable installation would find today's beside it."""


def other_code(folder: Path) -> Path:
    """A copy of the packages in which arrays are written otherwise."""
    for package in ("dags", "stages", "storage"):
        shutil.copytree(ROOT / package, folder / "posegaussian" / package, ignore=shutil.ignore_patterns("__pycache__"))
    (folder / "posegaussian/__init__.py").touch()
    with (folder / "posegaussian/storage/archive/shards.py").open("a") as file:
        file.write("EDITED = True\n")
    return folder


def test_workers_with_other_code_are_refused_by_name_whenever_they_join(
    archive: Pipeline, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    edited, old = other_code(tmp_path / "edited"), tmp_path / "old"
    (old / "posegaussian").mkdir(parents=True)
    (old / "posegaussian/__init__.py").write_text(OLD)
    with ExitStack() as stack:
        others = Cluster(stack, tmp_path / "scheduler.json")
        others.add("edited", code=edited)
        others.add("old", code=old)
        settings = RunSettings(scheduler=others.address())
        with pytest.raises(ConfigError) as refused:
            DaskBackend(settings, archive.root)
        assert "has other code or libraries than this run: storage/archive/shards.py (" in str(refused.value)
        assert "cannot run this version of posegaussian " in str(refused.value)
        assert "No module named 'posegaussian.dags'" in str(refused.value)
        others.add("good")
        others.address()
        backend = DaskBackend(settings, archive.root)
        assert sum(s.endswith("it is given nothing") for s in backend.sentences) == 2
        assert backend.pools["CPU"].workers == 1
        others.add("late", code=edited)
        others.address()
        monkeypatch.setattr(cluster, "LOOK_AGAIN", 0.0)
        events = archive.run(selection=METRICS, backend=backend)
    (late,) = [e.sentence for e in events if isinstance(e, Notice)]
    assert "storage/archive/shards.py (" in late
    assert {e.receipt.facts["worker"] for e in events if isinstance(e, TaskDone)} == {"good"}
    assert ended(events).done == 3


def test_a_scheduler_that_dies_fails_what_it_had_and_blocks_the_rest(
    archive: Pipeline, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(cluster, "RECONNECTION", 0.2)
    events: list[Event] = []
    with ExitStack() as stack:
        others = Cluster(stack, tmp_path / "scheduler.json")
        others.add("only")
        backend = DaskBackend(RunSettings(scheduler=others.address(), window=1), archive.root)

        def tell(event: Event) -> None:
            events.append(event)
            if isinstance(event, TaskDone):
                others.scheduler.kill()
                others.scheduler.wait()

        Run([archive.plan(selection=LAST)], LAST, backend, [tell]).go()
    failed = [e for e in events if isinstance(e, TaskFailed)]
    assert failed
    assert {e.kind for e in failed} == {Kind.UNREACHED.value}
    assert "does not answer any more; what is done is kept, run again" in failed[0].error
    assert [e for e in events if isinstance(e, TaskBlocked)]
    assert not [e for e in events if isinstance(e, TaskLeftOut)]
    assert not [r for r in caplog.records if r.name.startswith("distributed")], "nor is there a traceback of Dask's"


def test_what_a_lost_scheduler_never_got_is_failed_and_blocked_and_not_left_out(archive: Pipeline) -> None:
    collector, events = WarningCollector(), []
    backend = UnreachedBackend({CPU: Pool(1)}, SchedulerLost("no workers could be started"))
    Run([archive.plan(selection=LAST)], LAST, backend, [events.append, collector]).go()
    (failed,) = [e for e in events if isinstance(e, TaskFailed)]
    assert (failed.task.stage, failed.kind, failed.error) == (
        "rendering",
        "scheduler lost",
        "no workers could be started",
    )
    assert [s for s in collector.blocked_sentences({}) if "--only" in s] == []
    assert (ended(events).failed, ended(events).blocked, ended(events).left_out) == (1, 5, 0)


def test_workers_that_die_while_they_start_are_started_again_and_then_told_as_a_failed_run(
    archive: Pipeline, monkeypatch: pytest.MonkeyPatch
) -> None:
    from posegaussian.dags.runtime.executors import local_cluster

    attempts, real = [], local_cluster._start

    def stumbling(settings: RunSettings) -> object:
        attempts.append(settings)
        if len(attempts) < 3 or settings.workers == 2:
            raise RuntimeError("Nanny failed to start.")
        return real(settings)

    monkeypatch.setattr(local_cluster, "_start", stumbling)
    start_local(RunSettings(workers=1)).close()
    assert len(attempts) == local_cluster.ATTEMPTS
    settings = archive.with_settings("run.scheduler=local", "run.workers=2", "run.gpus=0")
    console = Console(file=io.StringIO(), width=400)
    session = replace(settings.session, console=console)
    status = session.run_and_report([settings.plan(selection=METRICS)], METRICS)
    said = console.file.getvalue()  # type: ignore[attr-defined]
    assert status == 1, said
    assert "no workers could be started on this machine in 3 attempts (Nanny failed to start.)" in said
    assert "scheduler lost" in said
    assert "retry with: posegaussian run --archive" in said
    assert ", 1 failed, 2 blocked in " in said


@pytest.fixture
def certificates(tmp_path: Path) -> tuple[str, str]:
    """(certificate, key) that signs itself."""
    if shutil.which("openssl") is None:
        pytest.skip("openssl makes the certificate")
    certificate, key = str(tmp_path / "cert.pem"), str(tmp_path / "key.pem")
    subprocess.run(
        [
            "openssl",
            "req",
            "-x509",
            "-newkey",
            "rsa:2048",
            "-nodes",
            "-keyout",
            key,
            "-out",
            certificate,
            "-days",
            "1",
            "-subj",
            "/CN=posegaussian",
        ],
        check=True,
        capture_output=True,
    )
    return certificate, key


def test_a_run_over_tls_needs_the_certificates_and_works_with_them(
    archive: Pipeline, tmp_path: Path, certificates: tuple[str, str]
) -> None:
    certificate, key = certificates
    with ExitStack() as stack:
        others = Cluster(
            stack,
            tmp_path / "scheduler.json",
            "--tls-ca-file",
            certificate,
            "--tls-cert",
            certificate,
            "--tls-key",
            key,
        )
        others.add("only")
        configured = {
            "distributed.comm.tls.ca-file": certificate,
            "distributed.comm.tls.client.cert": certificate,
            "distributed.comm.tls.client.key": key,
        }
        with dask.config.set(configured):
            address = others.address()
            assert address.startswith("tls://")
            over_tls = archive.with_settings(f"run.scheduler={address}")
            backend = over_tls.session.backend()
            events = over_tls.run(selection=METRICS, backend=backend)
        assert ended(events).done == 3
        assert {e.receipt.facts["worker"] for e in events if isinstance(e, TaskDone)} == {"only"}
        with pytest.raises(
            ConfigError, match=r"needs certificates: name them in Dask's configuration, distributed\.comm\.tls"
        ):
            over_tls.session.backend()
        with (
            dask.config.set({**configured, "distributed.comm.tls.ca-file": "/nowhere.pem"}),
            pytest.raises(ConfigError, match="cannot be read"),
        ):
            over_tls.session.backend()
    assert load_configuration(None, [f"run.scheduler={address}"], folder=tmp_path).default.run.scheduler == address
