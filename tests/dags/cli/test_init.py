"""`posegaussian init`: a commented configuration of a capture that can be used as it stands."""

from __future__ import annotations

from pathlib import Path

import cv2
import pytest
from typer.testing import CliRunner

from posegaussian.dags.budget.expected import given
from posegaussian.dags.cli.app import app
from posegaussian.dags.config.settings import PACKAGED, load_configuration
from posegaussian.storage.model.errors import ConfigError
from tests.support.pipeline import film


@pytest.fixture
def capture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    film(tmp_path / "walk", views=5, frames=2, held_out=0, size=48, masks=False, joints=False, depth=False)
    return tmp_path / "walk"


def test_what_is_written_is_valid_and_changes_nothing_unasked(capture: Path) -> None:
    done = CliRunner().invoke(app, ["init", "walk"])
    assert done.exit_code == 0, done.output
    assert done.output.splitlines()[-1] == "next: posegaussian import images walk"
    text = Path("pipeline.yaml").read_text()
    assert '5 cameras: "cam00" (48 x 48 px)' in text
    assert '["cam02"] would be drawn' in text
    assert load_configuration().default == load_configuration(PACKAGED).default


def test_a_budget_may_choose_what_the_file_leaves_open(capture: Path) -> None:
    assert CliRunner().invoke(app, ["init", "walk"]).exit_code == 0
    dearer = {"frames.size", "depth.method", "network.weights", "refinement.steps"}
    assert not dearer & given(load_configuration())


def test_no_file_is_written_over_unasked(capture: Path) -> None:
    Path("pipeline.yaml").write_text("run: {}\n")
    refused = CliRunner().invoke(app, ["init", "walk"])
    assert isinstance(refused.exception, ConfigError)
    assert "--force" in str(refused.exception)
    assert Path("pipeline.yaml").read_text() == "run: {}\n"
    assert CliRunner().invoke(app, ["init", "walk", "--force"]).exit_code == 0
    assert "5 cameras" in Path("pipeline.yaml").read_text()


def test_crops_that_were_worked_out_are_settings_once_uncommented(capture: Path) -> None:
    for file in capture.glob("images/*/*.png"):
        cv2.imwrite(str(file), cv2.resize(cv2.imread(str(file)), (96, 96)))
    assert CliRunner().invoke(app, ["init", "walk", "--output", "own.yaml"]).exit_code == 0
    text = Path("own.yaml").read_text()
    Path("own.yaml").write_text(text.replace("  # crop:", "  crop:").replace("  #   cam", "    cam"))
    crops = load_configuration(Path("own.yaml")).default.frames.crop
    assert set(crops) == {f"cam0{i}" for i in range(5)}
    assert crops["cam00"].scale == pytest.approx(0.5)
