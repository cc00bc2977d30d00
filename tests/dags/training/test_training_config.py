"""Settings of a training: the packaged file says the defaults, faults say their place, differences are named."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from posegaussian.dags.training.config import PACKAGED, differences, forbidden, load_training
from posegaussian.stages.network.model.presets import PRESETS, Preset
from posegaussian.stages.training.config import TrainingConfig
from posegaussian.storage.model.errors import ConfigError
from tests.dags.cli.test_cli import assert_says, posegaussian


def test_the_packaged_file_says_every_default_in_the_order_of_the_model() -> None:
    said = yaml.safe_load(PACKAGED.read_text(encoding="utf-8"))
    assert said == TrainingConfig().model_dump(mode="json")
    assert list(said) == list(TrainingConfig.model_fields)
    assert load_training() == TrainingConfig()


def test_every_line_of_it_has_a_comment_and_every_field_a_sentence() -> None:
    for number, line in enumerate(PACKAGED.read_text(encoding="utf-8").splitlines(), 1):
        assert not line.strip() or "#" in line, f"{PACKAGED.name}:{number}: {line} has no comment"
    for name, info in TrainingConfig.model_fields.items():
        assert info.description, name
        assert info.description.endswith("."), name


@pytest.mark.parametrize("preset", sorted(PRESETS))
def test_the_default_variant_of_a_preset_is_the_preset(preset: str) -> None:
    """But for what it is shown: views alone, and pairs of rings of four."""
    made = TrainingConfig(preset=preset).network()  # type: ignore[arg-type]
    assert made == replace(PRESETS[preset], alone=True, widest=92.0)
    six = TrainingConfig(preset=preset, cameras=(6, 8), single=0)  # type: ignore[arg-type]
    assert six.network() == PRESETS[preset]


def test_chosen_variants_reach_the_network() -> None:
    config = TrainingConfig(
        fusion="gated",
        pose_in=("decoder",),
        rotation_head="quaternion",
        opacity_head="single",
        normalisation="batch",
        downsampling="pool",
        residual=False,
        further_views=True,
        stages=4,
        widths=(8, 16, 24, 32),
        hidden=40,
        correlation_levels=3,
        correlation_radius=2,
        stem_stride=1,
        pose_cell=1,
        single=0,
        cameras=(3,),
    )
    assert config.network() == Preset(
        "fast",
        stages=4,
        widths=(8, 16, 24, 32),
        hidden=40,
        correlation_levels=3,
        correlation_radius=2,
        stem_stride=1,
        pose_cell=1,
        widest=95.0,
        fusion="gated",
        pose_in=frozenset({"decoder"}),
        rotation_head="quaternion",
        opacity_head="single",
        normalisation="batch",
        downsampling="pool",
        residual=False,
        further_views=True,
    )
    assert TrainingConfig(pose_in=()).network().pose_in == frozenset()


def test_frames_show_every_training_scene_and_no_other() -> None:
    config = TrainingConfig(scenes={"first": 10, "count": 3}, frames_per_scene=2)  # type: ignore[arg-type]
    assert [config.scene_seed(i) for i in range(8)] == [10, 10, 11, 11, 12, 12, 10, 10]
    assert [config.validation_seed(i) for i in range(config.validation.count)] == [8000, 8001, 8002, 8003]
    assert [config.phase(s) for s in (0, 1499, 1500, 3999)] == ["depth", "depth", "joint", "joint"]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("presett: base", 'train.yaml:1:1 presett: unknown key; did you mean "preset"?'),
        ("scenes:\n  frist: 1", 'train.yaml:2:3 scenes.frist: unknown key; did you mean "first"?'),
        ("batch: 2\nclip: 0", "train.yaml:2:1 clip: input should be greater than 0, got 0"),
        (
            "scenes: {first: 7999, count: 2}",
            "train.yaml:1:1 scenes: scenes for training have seeds of 0 to 7999, these are 7999 to 8000",
        ),
        ("validation: {first: 9000}", "train.yaml:1:1 validation: scenes for validation have seeds of 8000 to 8999"),
        ("crop: 260", "train.yaml:1:1 crop: a crop of 260 px is no multiple of 8 px"),
        ("size: 64", "crop: a crop of 128 px does not fit into pictures of 64 px"),
        ("cameras: [6, 6]", "train.yaml:1:1 cameras: each may be named once"),
        ("cameras: [2]", "train.yaml:1:1 cameras: a ring has 3 to 64 cameras, got 2"),
        ("residual: 3", "train.yaml:1:1 residual:"),
        ("start: nowhere.safetensors", "train.yaml:1:1 start: there is no file nowhere.safetensors"),
    ],
)
def test_a_fault_is_a_sentence_with_its_place(tmp_path: Path, text: str, said: str) -> None:
    file = tmp_path / "train.yaml"
    file.write_text(text)
    with pytest.raises(ConfigError) as e:
        load_training(file)
    assert said in str(e.value)


def test_assignments_lie_on_top(tmp_path: Path) -> None:
    file = tmp_path / "train.yaml"
    file.write_text("batch: 4\nscenes: {count: 10}\n")
    config = load_training(file, ["batch=8", "scenes.first=5"])
    assert (config.batch, config.scenes.first, config.scenes.count) == (8, 5, 10)
    with pytest.raises(ConfigError, match="--set batch: input should be greater"):
        load_training(file, ["batch=0"])


def test_differences_are_named_and_only_lengths_are_harmless() -> None:
    old = TrainingConfig().model_dump(mode="json")
    new = TrainingConfig(
        batch=3, depth_steps=9, joint_steps=9, validate_every=9, checkpoint_every=9, scenes={"count": 7}
    ).model_dump(mode="json")  # type: ignore[arg-type]
    changes = differences(old, new)
    assert changes.keys() == {
        "batch",
        "depth_steps",
        "joint_steps",
        "validate_every",
        "checkpoint_every",
        "scenes.count",
    }
    assert forbidden(changes) == {"batch": "8 -> 3", "scenes.count": "480 -> 7"}
    assert differences({"a": 1}, {}) == {"a": "1 -> not set"}
    assert differences(old, old) == {}


def test_the_command_says_faults_of_its_configuration(tmp_path: Path) -> None:
    (tmp_path / "own.yaml").write_text("preset: huge\n")
    assert_says(
        posegaussian("train", "--config", "own.yaml", cwd=tmp_path),
        "own.yaml:1:1 preset: input should be 'paper', 'base' or 'fast', got 'huge'",
    )
    assert_says(posegaussian("train", "--device", "tpu", cwd=tmp_path), "--device tpu: auto, cpu or cuda")


def test_help_and_configuration_import_nothing_heavy(tmp_path: Path) -> None:
    code = (
        "import sys; from posegaussian.dags.cli.app import app; from typer.testing import CliRunner; runs ="
        " [CliRunner().invoke(app, words).exit_code for words in (['--help'], ['train', '--help'], ['train', '--set',"
        " 'batch=0'])]; import posegaussian.dags.training.loop, posegaussian.dags.training.frame_producers,"
        " posegaussian.dags.training.state, posegaussian.dags.training.card; print(runs, [m for m in ('torch',"
        " 'safetensors', 'cv2', 'numba', 'av', 'distributed', 'OpenImageIO', 'matplotlib') if m in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=Path(__file__).parents[3]
    )
    assert done.stdout.strip() == "[0, 0, 1] []", done.stdout + done.stderr
