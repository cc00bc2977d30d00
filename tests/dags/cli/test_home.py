"""A `~` that quotes kept from the shell, or that stands in a file, is the home folder."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from posegaussian.dags.cli.app import app
from posegaussian.dags.config.settings import load_configuration
from posegaussian.dags.simulation.simulate import read_scene
from posegaussian.dags.training.config import load_training
from posegaussian.storage.archive.store import local_path
from posegaussian.storage.model.home import word_at_home
from tests.support.pipeline import film


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "home").mkdir()
    (tmp_path / "work").mkdir()
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.chdir(tmp_path / "work")
    return tmp_path / "home"


@pytest.mark.parametrize(
    ("word", "meant"),
    [
        ("~", "{}"),
        ("~/a b", "{}/a b"),
        ("--output=~/a", "--output={}/a"),
        ("archive=~/a", "archive={}/a"),
        ("--option=calibration=~/c.toml", "--option=calibration={}/c.toml"),
        ("--set=metrics.lpips_weights=~/w.pt", "--set=metrics.lpips_weights={}/w.pt"),
        ("a/~", "a/~"),
        ("arc cam~1 cam~2", "arc cam~1 cam~2"),
        ("~nobody_is_called_so/a", "~nobody_is_called_so/a"),
        ("", ""),
    ],
)
def test_words_are_what_a_shell_makes_of_them_without_quotes(home: Path, word: str, meant: str) -> None:
    assert word_at_home(word) == meant.format(home)


def test_every_path_of_a_command_may_start_at_home(home: Path) -> None:
    film(home / "capture", views=2, frames=1, held_out=0)
    (home / "own.yaml").write_text('archive: "~/archive"\npartition: {frames: 1}\n')

    def done(*words: str) -> str:
        result = CliRunner().invoke(app, list(words))
        assert result.exit_code == 0, (result.output, result.exception)
        return result.output

    done("import", "images", "~/capture", "--config", "~/own.yaml")
    assert (home / "archive" / "capture" / "zarr.json").is_file()
    done("import", "images", "~/capture", "--archive=~/second", "--option", "held_out=cam01")
    done("import", "images", "~/capture", "--set", "archive=~/third")
    assert (home / "second" / "capture").is_dir()
    assert (home / "third" / "capture").is_dir()
    done("plan", "--archive", "~/archive", "--picture", "~/plan.md")
    assert (home / "plan.md").is_file()
    assert list(Path.cwd().iterdir()) == []


def test_every_path_in_a_file_may_start_at_home(home: Path) -> None:
    for name, text in {
        "own.yaml": (
            'archive: ~/a\nrendering: {paths: [~/cams.json, "arc a b"]}\nnetwork: {weights:'
            ' "~/w.safetensors"}\nsequences: {walk: {detection: {model: ~/m.yaml}}}\n'
        ),
        "scene.yaml": "seed: 1\nframes: 1\nsubject: {obj: ~/scan.obj}\nrig: {cameras: 4, size: [64, 96], fill: 0.5}\n",
        "train.yaml": "preset: fast\nstart: ~/w.safetensors\n",
    }.items():
        Path(name).write_text(text)
    (home / "w.safetensors").write_bytes(b"")
    read = load_configuration(Path("own.yaml"), ["rendering.paths=[~/other.json]"])
    assert read.default.archive == f"{home}/a"
    assert read.default.rendering.paths == [f"{home}/other.json"]
    assert load_configuration(Path("own.yaml")).default.rendering.paths == [f"{home}/cams.json", "arc a b"]
    assert read.default.network.weights == f"{home}/w.safetensors"
    assert read.for_sequence("walk").detection.model == f"{home}/m.yaml"
    assert str(read_scene(Path("scene.yaml")).subject.obj) == f"{home}/scan.obj"
    assert load_training(Path("train.yaml")).start == f"{home}/w.safetensors"
    assert local_path("~/a") == home / "a"
