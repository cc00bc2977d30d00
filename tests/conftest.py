"""Shared fixtures: the analytic person as a capture folder, and archives made from it."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from tests.support.pipeline import Pipeline, film


def pytest_configure() -> None:
    """One thread a library, before any is imported: tests are quick and alike on every machine. Without a GPU,
    Triton's kernels are interpreted."""
    from posegaussian.dags.runtime import threads

    threads.limit(1)
    # The same examples every time, and none is wrong for being slow: machines are shared.
    settings.register_profile("suite", derandomize=True, deadline=None, suppress_health_check=[HealthCheck.too_slow])
    settings.load_profile("suite")
    os.fsync = without_waiting
    # What this machine has fetched changes no test; those of BlazePose itself run where POSEGAUSSIAN_TEST_MODELS names
    # a folder of models.
    os.environ["POSEGAUSSIAN_MODELS"] = os.environ.get(
        "POSEGAUSSIAN_TEST_MODELS", str(Path(__file__).parent / "no_models")
    )
    from posegaussian.dags.planning.resources import visible_gpus

    if not visible_gpus():
        os.environ.setdefault("TRITON_INTERPRET", "1")


def without_waiting(handle: int) -> None:
    """In place of `os.fsync`: a bad handle is an error as before, a good one is not waited for.

    Only a power cut loses what was not synced, and no test cuts the power: what a killed process wrote is there. A run
    syncs hundreds of files, at some milliseconds each; processes that tests start sync theirs. Tests of when and in
    which order files are synced put their own function here.
    """
    os.fstat(handle)


@pytest.fixture(scope="session")
def captures() -> Path:
    """Folder of the real captures; the test is skipped where there is none."""
    folder = Path(os.environ.get("POSEGAUSSIAN_CAPTURES", "../shared"))
    if not (folder / "captures").is_dir():
        pytest.skip(f"no real captures at {folder} (set POSEGAUSSIAN_CAPTURES)")
    return folder


@pytest.fixture(scope="session")
def person_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six frames of the kicking person at 48 px, six source cameras and one held-out, as an `images` capture."""
    folder = tmp_path_factory.mktemp("person")
    film(folder, views=6, size=48, frames=6, held_out=1)
    return folder


@pytest.fixture(scope="session")
def finished(person_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Pipeline:
    """The person's archive after an undisturbed serial run. Read it, do not change it."""
    pipeline = Pipeline(tmp_path_factory.mktemp("finished") / "archive", person_folder)
    pipeline.register()
    pipeline.run()
    return pipeline
