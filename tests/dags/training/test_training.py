"""A training goes on whatever ends it, and ends in the same bytes; its folder is whole; what cannot go on says why."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest
from safetensors import safe_open

from posegaussian.dags.training.config import load_training
from posegaussian.dags.training.frame_producers import FrameError, read_frame
from posegaussian.dags.training.loop import Parts, TrainingOrder, train
from posegaussian.dags.training.run_folder import RunFolder, log_row
from posegaussian.stages.network.card import read_card
from posegaussian.stages.training.config import TrainingConfig
from posegaussian.storage.archive.checkpoints import read_latest, steps_kept
from posegaussian.storage.model.errors import ConfigError, NotWritten, UserError

PARTS = Parts(
    "tests.support.fake_frames", "tests.support.fake_frames:frames_of_step", "tests.support.fake_trainer:Trainer"
)
SHORT = (
    "frames_per_scene=2",
    "depth_steps=40",
    "joint_steps=20",
    "validate_every=20",
    "checkpoint_every=10",
    "window=4",
    "steps_per_frame=4",
)
CONFIG = TrainingConfig(
    frames_per_scene=2,
    depth_steps=40,
    joint_steps=20,
    validate_every=20,
    checkpoint_every=10,
    window=4,
    steps_per_frame=4,
)
ROOT = Path(__file__).resolve().parents[3]
CODE = f"""
import sys
sys.path.insert(0, {str(ROOT)!r})
from posegaussian.dags.training import loop
loop.PARTS = loop.Parts({PARTS.frames!r}, {PARTS.frames_of_step!r}, {PARTS.trainer!r})
from posegaussian.dags.cli.app import main
main()
"""


@pytest.fixture(autouse=True)
def _surroundings() -> Iterator[None]:
    """A training sets threads through the environment."""
    before = dict(os.environ)
    yield
    os.environ.clear()
    os.environ.update(before)


def run(folder: Path, config: TrainingConfig = CONFIG, **more: object) -> list[str]:
    said: list[str] = []
    train(TrainingOrder(config, folder, **{"workers": 0, "device": "cpu", **more}), said.append, PARTS)  # type: ignore[arg-type]
    return said


def start(folder: Path, step_s: float, *words: str) -> subprocess.Popen:
    assignments = [w for s in SHORT for w in ("--set", s)]
    command = [
        sys.executable,
        "-c",
        CODE,
        "train",
        "--output",
        str(folder),
        "--threads",
        "1",
        "--device",
        "cpu",
        *assignments,
        *words,
    ]
    environment = {**os.environ, "POSEGAUSSIAN_FAKE": json.dumps({"step_s": step_s})}
    return subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True
    )


def wait_for_step(folder: Path, process: subprocess.Popen, step: int) -> None:
    deadline = time.monotonic() + 120
    while not steps_kept(folder / "checkpoints") or len(rows(folder)) < step:
        assert process.poll() is None, process.communicate()[0]
        assert time.monotonic() < deadline
        time.sleep(0.01)


def rows(folder: Path) -> list[dict]:
    lines = (folder / "log.jsonl").read_text().split("\n")[:-1]
    return [json.loads(line) for line in lines]


def assert_alike(folder: Path, undisturbed: Path) -> None:
    """Equal to the byte: last checkpoints, log and averaged weights; the card tells minutes, and those differ."""
    ours, theirs = read_latest(folder / "checkpoints")[0], read_latest(undisturbed / "checkpoints")[0]
    assert ours is not None
    assert theirs is not None
    assert (ours.step, ours.data) == (theirs.step, theirs.data)
    assert rows(folder) == rows(undisturbed)
    with (
        safe_open(folder / "weights.safetensors", "np") as a,
        safe_open(undisturbed / "weights.safetensors", "np") as b,
    ):
        assert sorted(a.keys()) == sorted(b.keys())
        assert all(a.get_tensor(k).tobytes() == b.get_tensor(k).tobytes() for k in a.keys())  # noqa: SIM118


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("undisturbed")
    assert run(folder)[-1].startswith("done: 60 steps")
    return folder


def test_the_folder_holds_all_that_is_promised(undisturbed: Path) -> None:
    assert sorted(f.name for f in undisturbed.iterdir()) == [
        ".lock",
        "checkpoints",
        "config.yaml",
        "frames",
        "log.jsonl",
        "training.png",
        "weights.md",
        "weights.safetensors",
    ]
    assert steps_kept(undisturbed / "checkpoints") == [60, 50]
    steps = [r for r in rows(undisturbed) if r["kind"] == "step"]
    assert [r["step"] for r in steps] == list(range(1, 61))
    assert [r["phase"] for r in steps] == ["depth"] * 40 + ["joint"] * 20
    assert steps[-1]["loss"] < 0.3 * steps[0]["loss"]
    assert [r["step"] for r in rows(undisturbed) if r["kind"] == "validation"] == [20, 40, 60]
    card = read_card(undisturbed / "weights.safetensors")
    assert card.validation[0] == ("measure", "step 20", "step 60")
    assert "step 60 of 60" in card.data
    assert "8000 to 8003" in card.seeds


def test_what_is_done_is_not_done_again(undisturbed: Path) -> None:
    before = (undisturbed / "weights.safetensors").stat().st_mtime_ns
    assert run(undisturbed)[-1].startswith("done: 60 steps")
    assert (undisturbed / "weights.safetensors").stat().st_mtime_ns == before


def test_killed_in_the_middle_it_loses_at_most_one_interval_and_ends_in_the_same_bytes(
    undisturbed: Path, tmp_path: Path
) -> None:
    process = start(tmp_path, 0.05, "--workers", "1")
    wait_for_step(tmp_path, process, 26)
    children = psutil.Process(process.pid).children(recursive=True)
    process.kill()
    process.wait()
    done = max(r["step"] for r in rows(tmp_path))
    kept = steps_kept(tmp_path / "checkpoints")[0]
    assert done - kept <= CONFIG.checkpoint_every
    assert done < CONFIG.steps, "the kill came too late to prove anything"
    _, alive = psutil.wait_procs(children, timeout=30)
    assert not alive, "a process that makes frames outlived its training"
    said = run(tmp_path)
    assert said[0].startswith(f"step {kept} of 60")
    assert_alike(tmp_path, undisturbed)


def test_ctrl_c_ends_it_in_order_with_a_checkpoint_of_the_last_step(undisturbed: Path, tmp_path: Path) -> None:
    process = start(tmp_path, 0.05, "--workers", "1")
    wait_for_step(tmp_path, process, 14)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to the other processes, too
    said = process.communicate(timeout=60)[0]
    assert process.returncode == 130, said
    assert "Traceback" not in said, said
    assert "Ctrl-C once more ends at once" in said
    assert steps_kept(tmp_path / "checkpoints")[0] == max(r["step"] for r in rows(tmp_path)), "no step is lost"
    run(tmp_path)
    assert_alike(tmp_path, undisturbed)


def test_minutes_end_it_with_a_checkpoint(undisturbed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as m:
        m.setenv("POSEGAUSSIAN_FAKE", '{"step_s": 0.1}')
        said = run(tmp_path, minutes=0.02)
    step = max(r["step"] for r in rows(tmp_path))
    assert 0 < step < 20
    assert said[-1].endswith(
        f"at step {step} of 60 (weights are written from step 20 on); the same command goes on from there"
    )
    assert steps_kept(tmp_path / "checkpoints")[0] == step
    run(tmp_path)
    assert_alike(tmp_path, undisturbed)


def test_processes_for_frames_change_nothing_and_stay_within_bounds(undisturbed: Path, tmp_path: Path) -> None:
    said = run(tmp_path, workers=2)
    assert said[-1].startswith("done: 60 steps")
    assert_alike(tmp_path, undisturbed)
    assert {f.name for f in (tmp_path / "frames").rglob("*.npz")} == {
        f.name for f in (undisturbed / "frames").rglob("*.npz")
    }


def test_a_damaged_checkpoint_is_gone_back_from(
    undisturbed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    half = CONFIG.model_copy(update={"depth_steps": 30, "joint_steps": 0})
    run(tmp_path, half)
    last = tmp_path / "checkpoints" / "00000030.checkpoint"
    last.write_bytes(last.read_bytes()[:-1] + b"?")
    said = run(tmp_path, half)
    assert "step 30 is damaged" in said[0]
    assert "going on from step 20" in said[0]
    assert [r["step"] for r in rows(tmp_path) if r["kind"] == "step"] == list(range(1, 31))


def test_a_log_that_ends_in_half_a_line_is_whole_again(undisturbed: Path, tmp_path: Path) -> None:
    run(tmp_path, CONFIG.model_copy(update={"depth_steps": 20, "joint_steps": 0}))
    with (tmp_path / "log.jsonl").open("a") as f:
        f.write('{"kind": "step", "step": 21, "loss": 1.0}\n{"kind": "step", "st')
    run(tmp_path, CONFIG.model_copy(update={"depth_steps": 25, "joint_steps": 0}))
    assert [r["step"] for r in rows(tmp_path) if r["kind"] == "step"] == list(range(1, 26))


def test_another_configuration_is_refused_by_name_and_lengths_are_not(tmp_path: Path) -> None:
    run(tmp_path, CONFIG.model_copy(update={"depth_steps": 10, "joint_steps": 0}))
    with pytest.raises(
        ConfigError, match=r"at step 10 with another configuration \(batch: 8 -> 3\); choose another --output"
    ):
        run(tmp_path, CONFIG.model_copy(update={"batch": 3}))
    said = run(tmp_path, CONFIG.model_copy(update={"depth_steps": 12, "joint_steps": 0}))
    assert said[0] == "depth_steps: 10 -> 12, from here on"
    assert said[-1].startswith("done: 12 steps")


def test_two_trainings_in_one_folder_are_one_too_many(tmp_path: Path) -> None:
    with RunFolder(tmp_path).locked(), pytest.raises(UserError, match="another training is running in"):
        run(tmp_path)
    run(tmp_path, CONFIG.model_copy(update={"depth_steps": 2, "joint_steps": 0}))


def test_a_full_disk_is_told_of_the_log_that_it_did_not_take(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path)

    def write() -> None:
        with folder.locked():
            folder.resume()
            folder._log = Path("/dev/full").open("a", encoding="utf-8")  # noqa: SIM115
            folder.note(log_row("step", 1, {"loss": 1.0}))

    with pytest.raises(NotWritten, match=r"cannot write .*log\.jsonl: the disk is full"):
        write()


def test_steps_that_were_skipped_are_told_at_the_end_and_on_the_card(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("POSEGAUSSIAN_FAKE", '{"infinite": [10, 59]}')
    told = "49 of 60 steps were skipped, their loss was not finite"
    assert run(tmp_path)[-1].startswith(f"done: 60 steps, {told}, ")
    assert read_card(tmp_path / "weights.safetensors").data.endswith(f"step 60 of 60; {told}")
    assert run(tmp_path)[-1].startswith(f"done: 60 steps, {told}, "), "what goes on knows them, too"


def test_fifty_steps_skipped_in_a_row_end_it_with_a_checkpoint_and_advice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("POSEGAUSSIAN_FAKE", '{"infinite": [3, 60]}')
    with pytest.raises(UserError, match=r"50 steps in a row up to step 53 were skipped.*another --output with a learn"):
        run(tmp_path)
    assert steps_kept(tmp_path / "checkpoints")[0] == 53


def test_what_goes_on_needs_no_weights_to_start_from(tmp_path: Path) -> None:
    weights = tmp_path / "weights.safetensors"
    weights.touch()
    config, output = tmp_path / "train.yaml", tmp_path / "output"
    config.write_text(f"start: {weights}\n")
    begun = CONFIG.model_copy(update={"start": str(weights)})
    run(output, begun.model_copy(update={"depth_steps": 10, "joint_steps": 0}))
    weights.unlink()
    assert load_training(config, [], output).start == str(weights)
    assert run(output, begun)[-1].startswith("done: 60 steps")
    assert f"continued from {weights}" in read_card(output / "weights.safetensors").seeds
    with pytest.raises(ConfigError, match="there is no file"):
        load_training(config, [], tmp_path / "another")


def test_frames_that_come_round_again_are_made_once(tmp_path: Path) -> None:
    few = TrainingConfig.model_validate(
        {**CONFIG.model_dump(), "scenes": {"count": 3}, "frames_per_scene": 2, "window": 4, "steps_per_frame": 1}
    )
    run(tmp_path, few, workers=1)
    assert sorted(f.name for f in (tmp_path / "frames").rglob("0*.npz")) == [
        f"{s:04d}-{m:02d}.npz" for s in range(3) for m in range(2)
    ]


@pytest.mark.parametrize("workers", [0, 1])
def test_a_frame_that_cannot_be_made_is_named_by_its_seed_and_costs_no_step(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, workers: int
) -> None:
    monkeypatch.setenv("POSEGAUSSIAN_FAKE", '{"raises": 7, "step_s": 0.05}')
    with pytest.raises(
        FrameError,
        match=r"training frame 7 \(scene seed 3, moment 1\) cannot be made: ValueError: the person left the picture",
    ):
        run(tmp_path, workers=workers)
    assert "Traceback" in next((tmp_path / "frames").rglob("0003-01.npz.failed.txt")).read_text()
    done = [r["step"] for r in rows(tmp_path)]
    assert steps_kept(tmp_path / "checkpoints")[:1] == done[-1:]


def test_a_process_that_dies_is_replaced_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    short = CONFIG.model_copy(update={"depth_steps": 6, "joint_steps": 0})
    monkeypatch.setenv("POSEGAUSSIAN_FAKE", json.dumps({"dies": [2, str(tmp_path / "died")]}))
    assert run(tmp_path / "a", short, workers=1)[-1].startswith("done: 6 steps")
    assert (tmp_path / "died").exists()
    monkeypatch.setenv("POSEGAUSSIAN_FAKE", '{"dies_always": 2}')
    with pytest.raises(
        FrameError,
        match=(
            r"training frame 2 \(scene seed 1, moment 0\) cannot be made: 2 processes died over it.*fewer than 1"
            r" --workers"
        ),
    ):
        run(tmp_path / "b", short, workers=1)


def test_a_damaged_frame_is_made_again_and_frames_are_shared(undisturbed: Path, tmp_path: Path) -> None:
    shared = tmp_path / "frames"
    short = CONFIG.model_copy(update={"depth_steps": 6, "joint_steps": 0})
    run(tmp_path / "a", short, frames=shared)
    assert not (tmp_path / "a" / "frames").exists()
    files = sorted(shared.rglob("0*.npz"))
    data = bytearray(files[1].read_bytes())
    data[len(data) // 2] ^= 255
    files[1].write_bytes(data)
    untouched = files[2].stat().st_mtime_ns
    said = run(tmp_path / "b", short, frames=shared)
    assert any("0000-01.npz is damaged" in line and "made again" in line for line in said)
    assert read_frame(files[1])["x"].shape == (64, 8)
    assert files[2].stat().st_mtime_ns == untouched
