"""Pages of a simulated and of a filmed person, whole sequences: what they promise, printed as the benchmark prints it.

`pytest -s tests/end_to_end/test_pages.py` shows size, fidelity and pictures a second without a GPU; the figures of
docs/guide/page.md are of larger pictures, by `python -m benchmarks.renderer.page`.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from rich.console import Console
from typer.testing import CliRunner

from benchmarks.renderer import page
from benchmarks.report import show
from posegaussian.dags.cli.app import app
from posegaussian.dags.planning.results import Results
from posegaussian.dags.session.session import Session
from tests.support.browser import needed
from tests.support.pipeline import film

QUICK = [
    "run.scheduler=serial",
    "depth.method=hull",
    "network.weights=none",
    "refinement.steps=0",
    "survey.sample=5",
    "effects.exposure_matching=off",
    "effects.pose_blending=off",
    "rendering.paths=[]",
]
"""Nothing is judged: how good the person is has tests of its own."""


@pytest.fixture(autouse=True)
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    needed()
    monkeypatch.setattr(page, "SECONDS", 2.0)


def shown(capture: Path, folder: Path, path: str, *settings: str) -> dict[str, float]:
    """The benchmark's row of a capture's page, which it prints."""
    words = ["--archive", str(folder / "archive")]
    words += [word for s in (*QUICK, *settings) for word in ("--set", s)]
    runner = CliRunner()
    assert runner.invoke(app, ["import", "auto", str(capture), "--sequence", "person", *words]).exit_code == 0
    done = runner.invoke(app, ["run", *words])
    assert done.exit_code == 0, done.output
    session = Session.open(None, [*QUICK, *settings], str(folder / "archive"), Console(quiet=True))
    found = page.row(Results(session.context("person", (path,))), capture.name, folder, path, 12, None)
    print()
    show([found])
    return found


def kept(found: dict[str, float]) -> None:
    """30 frames of 60 000 Gaussians take 20 MB at most, and its pictures are the renderer's."""
    assert found["bytes a Gaussian"] < 20e6 / (30 * 60_000)
    assert found["least dB"] > 35
    assert found["pictures a second"] > 0


def test_a_simulated_person_of_thirty_frames(tmp_path: Path) -> None:
    film(tmp_path / "simulated", views=6, size=128, frames=30, held_out=0)
    found = shown(tmp_path / "simulated", tmp_path, "orbit")
    assert found["frames"] == 30
    kept(found)


@pytest.mark.captures
def test_a_filmed_person_of_twenty_four_frames(captures: Path, tmp_path: Path) -> None:
    settings = ("frames.range=0:48:2", "frames.size=320", "detection.estimator=files")
    found = shown(captures / "captures" / "balance", tmp_path, "between", *settings)
    assert found["frames"] == 24
    kept(found)
