"""Training's will: which step next, with which frames, when to look, what to keep, when to stop.

What a step does is `stages/training`'s; this file knows it by `stages/training/contract.py` alone.
"""

from __future__ import annotations

import os
import platform
import shutil
import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from posegaussian.dags.humanize.text import gigabytes, number
from posegaussian.dags.runtime.signals import interruptible
from posegaussian.dags.runtime.threads import limit
from posegaussian.dags.training.card import card, skipped_told
from posegaussian.dags.training.frame_producers import ProducedFrames, Producers, QueuedFrame
from posegaussian.dags.training.run_folder import RunFolder, log_row
from posegaussian.dags.training.state import packed, unpacked
from posegaussian.stages.contract.declaration import resolve
from posegaussian.stages.training.config import TrainingConfig
from posegaussian.storage.model.errors import ConfigError, UserError

if TYPE_CHECKING:
    from posegaussian.stages.training.contract import Trainer

Say = Callable[[str], None]
QUIET_SECONDS = 20.0
"""Pause between two lines of progress."""
DRAWN_SECONDS = 60.0
"""Pause between two drawings of the curves, which take a second each."""
LOST = 50
"""Steps in a row without a finite loss and gradient after which none is expected any more."""


@dataclass(frozen=True)
class Parts:
    """What is trained, by dotted names that this process and those that make frames resolve."""

    frames: str = "posegaussian.stages.training.frames"
    """Module that keeps `posegaussian.stages.training.contract.Frames`."""
    frames_of_step: str = "posegaussian.stages.training.examples:frames_of_step"
    """Function that tells which frames a step needs."""
    trainer: str = "posegaussian.stages.training.trainer:NetworkTrainer"
    """Class that keeps `posegaussian.stages.training.contract.Trainer`."""


PARTS = Parts()


@dataclass(frozen=True)
class TrainingOrder:
    """One call of `posegaussian train`."""

    config: TrainingConfig
    folder: Path
    """Of the run."""
    frames: Path | None = None
    """Folder for frames that several trainings share; None: `frames` within the run's."""
    minutes: float | None = None
    """After which it stops with a checkpoint; None: when all steps are done."""
    threads: int = 1
    """Of the trainer."""
    workers: int = 1
    """Processes that make frames; 0: the trainer makes them itself."""
    device: str = "auto"
    """auto, cpu or cuda."""


def cores() -> int:
    """Cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def train(order: TrainingOrder, say: Say, parts: Parts | None = None) -> None:
    """Begin a training or go on with it, until it is done, the minutes are over or Ctrl-C is pressed; then a checkpoint
    holds all.

    Raises:
        ConfigError: for a folder that holds a training of another configuration.
        FrameError: for a frame that cannot be made, after a checkpoint.
        UserError: after `LOST` steps in a row that were not finite, after a checkpoint.
        KeyboardInterrupt: after Ctrl-C and its checkpoint.
    """
    begin = time.monotonic()
    stop = threading.Event()
    folder = RunFolder(order.folder)
    alive: list[Training] = []

    def kill() -> None:
        for training in alive:
            training.producers.kill()

    with folder.locked(), interruptible(say, kill, stop.set):
        limit(order.threads)
        training = Training(order, folder, parts or PARTS, say, stop, begin)
        alive.append(training)
        try:
            training.run()
        finally:
            training.close()
    if stop.is_set():
        raise KeyboardInterrupt


class Training:
    """One stretch of a training in one process."""

    def __init__(
        self, order: TrainingOrder, folder: RunFolder, parts: Parts, say: Say, stop: threading.Event, begin: float
    ) -> None:
        """Restore what the folder holds. `begin`: when the minutes began, of `time.monotonic`."""
        self.order, self.config, self.folder, self.say, self.stop = order, order.config, folder, say, stop
        self.begin = begin
        self.deadline = begin + 60.0 * order.minutes if order.minutes is not None else float("inf")
        for sentence in folder.take(self.config):
            say(sentence)
        checkpoint, sentences = folder.resume()
        for sentence in sentences:
            say(sentence)
        frames_of_step = resolve(parts.frames_of_step)
        self.producers = producers(self.config, order.frames or folder.root / "frames", parts, order.workers)
        self.frames = ProducedFrames(self.config, self.producers, lambda step: frames_of_step(self.config, step), say)
        self.device = chosen_device(order.device)
        # what goes on has its weights in the checkpoint; the file that it began with may be gone
        begun = self.config if checkpoint is None else self.config.model_copy(update={"start": None})
        self.trainer: Trainer = resolve(parts.trainer)(begun, self.device)
        self.facts: dict[str, Any] = {"machines": {}, "circumstances": self._circumstances()}
        if checkpoint is not None:
            self._restore(checkpoint.data, checkpoint.facts)
        self.saved = checkpoint.step if checkpoint else 0
        self.first = self.trainer.step
        self.lost = 0
        """Steps in a row, the last included, that were skipped."""
        self.said_at, self.said_step = time.monotonic(), self.first
        self.drawn_at = time.monotonic()

    def run(self) -> None:
        """All that there is to do, in order; whatever ends it early leaves a checkpoint."""
        config, trainer = self.config, self.trainer
        self.say(
            f"step {trainer.step} of {config.steps} in {self.folder.root}, on {self.device} with"
            f" {number(self.order.threads, 'thread')}, frames made by {number(self.order.workers, 'worker')}"
        )
        try:
            self._go()
        except UserError:
            self._keep()  # a frame that cannot be made, and steps that are lost, take no other step with them
            raise
        self._keep()
        self._draw()
        self._say_end()

    def close(self) -> None:
        """End what would outlive this stretch."""
        self.producers.close()

    def _go(self) -> None:
        config, trainer = self.config, self.trainer
        while self._goes_on():
            if self._validation_is_due():
                if not self._validate():
                    return
                continue
            if trainer.step >= config.steps:
                return
            frames = self.frames.of_step(trainer.step, self._goes_on)
            if frames is None:
                return
            numbers = trainer.advance(frames)
            before = self.folder.skipped
            self.folder.note(log_row("step", trainer.step, {"phase": config.phase(trainer.step - 1), **numbers}))
            self.lost = self.lost + 1 if self.folder.skipped > before else 0
            if self.lost >= LOST:
                raise UserError(self._lost())
            if trainer.step == self.first + 1:
                self._say_bytes()
            self._say_progress(numbers)
            if trainer.step % config.checkpoint_every == 0:
                self._keep()

    def _lost(self) -> str:
        """What to do about steps none of which is finite."""
        config = self.config
        exact = "" if config.precision == "float32" else " and --set precision=float32"
        begun = f", or from other weights than {config.start}" if config.start else ""
        return (
            f"{self.lost} steps in a row up to step {self.trainer.step} were skipped, their loss or gradient was not"
            " finite; the weights are those of before, and kept in a checkpoint. Begin anew in another --output with a"
            f" learning_rate below {config.learning_rate:g}{exact}{begun}"
        )

    def _goes_on(self) -> bool:
        return not self.stop.is_set() and time.monotonic() < self.deadline

    def _validation_is_due(self) -> bool:
        step = self.trainer.step
        return (
            step > 0
            and (step % self.config.validate_every == 0 or step >= self.config.steps)
            and not self.folder.validated_at(step)
        )

    def _validate(self) -> bool:
        """Measure, write weights with their card, draw; False where it was stopped before."""
        from posegaussian.dags.training.weights import save_weights

        frames = self.frames.of_validation(self._goes_on)
        if frames is None:
            return False
        numbers = self.trainer.validate(frames)
        step = self.trainer.step
        row = log_row("validation", step, numbers)
        rows = [*self.folder.rows, row]
        save_weights(self.folder.weights_file, self.trainer.weights(), card(self.config, step, self._machines(), rows))
        self.folder.note(row)  # after a kill before this line, all of it is done again
        if time.monotonic() - self.drawn_at >= DRAWN_SECONDS:
            self._draw()
        self.say(f"validation at step {step}: " + ", ".join(f"{k} {v:.4g}" for k, v in numbers.items()))
        return True

    def _draw(self) -> None:
        """The curves so far, once there is a validation."""
        from posegaussian.dags.training.figure import draw

        if any(row["kind"] == "validation" for row in self.folder.rows):
            draw(self.folder.picture_file, self.folder.rows, self.config)
        self.drawn_at = time.monotonic()

    def _keep(self) -> None:
        step = self.trainer.step
        if step > self.saved:
            facts = {**self.facts, "machines": self._machines()}
            self.folder.keep(step, packed(self.trainer.state()), facts)
            self.saved = step

    def _restore(self, data: bytes, facts: dict[str, Any]) -> None:
        self.trainer.restore(unpacked(data))
        changed = [
            f"{k} {v} -> {self.facts['circumstances'].get(k)}"
            for k, v in facts["circumstances"].items()
            if v != self.facts["circumstances"].get(k)
        ]
        if changed:
            self.say(
                f"going on with {', '.join(changed)}: fine,"
                " but the last bits may differ from those of a training that never stopped"
            )
        self.facts["machines"] = facts["machines"]

    def _machines(self) -> dict[str, float]:
        """{machine: minutes} of the whole training so far."""
        total = Counter(self.facts["machines"])
        total[self.facts["circumstances"]["machine"]] += (time.monotonic() - self.begin) / 60.0  # type: ignore[assignment]
        return dict(total)

    def _circumstances(self) -> dict[str, Any]:
        """What may change a result's last bits without being a setting."""
        import torch

        machine = torch.cuda.get_device_name() if self.device == "cuda" else f"{_processor()}, {cores()} cores"
        return {"machine": machine, "device": self.device, "threads": self.order.threads, "torch": torch.__version__}

    def _say_bytes(self) -> None:
        """What frames take on the disk, once a first window of them is there."""
        held = sum(a.nbytes for f in self.frames.held.values() for a in f.values())
        every = {
            QueuedFrame.training(self.config, i)
            for i in range(min(self.frames.range_of(self.config.steps - 1).stop, self.config.scene_frames()))
        }
        there = sum(self.producers.has(i) for i in every)
        still = (len(every) - there) * held / max(1, len(self.frames.held))
        free = shutil.disk_usage(self.producers.folder).free
        rest = f"; the rest will take about {gigabytes(still)} of {gigabytes(free)} that are free" if still else ""
        self.say(f"frames: {there} of {len(every)} are there{rest}; those at hand take {gigabytes(held)} of memory")
        if still > free:
            self.say(
                f"the disk of {self.producers.folder} will be full before the last step: free it, train on fewer"
                " scenes, or name another place with --frames"
            )

    def _say_progress(self, numbers: dict[str, float]) -> None:
        now = time.monotonic()
        if now - self.said_at < QUIET_SECONDS:
            return
        step = self.trainer.step
        rate = (step - self.said_step) / (now - self.said_at)
        left = min((self.config.steps - step) / rate, self.deadline - now) / 60.0
        measured = "".join(
            f", {name} {numbers[key]:.3g}{unit}"
            for key, name, unit in (("loss", "loss", ""), ("epe", "EPE", " px"))
            if key in numbers
        )
        skipped = f", {self.folder.skipped} steps skipped" if self.folder.skipped else ""
        phase = self.config.phase(step - 1)
        self.say(
            f"step {step} of {self.config.steps} ({phase}){measured}, {rate:.2f} steps/s, {self.frames.ahead} frames"
            f" ahead{skipped}, {max(0.0, left):.0f} min left"
        )
        self.said_at, self.said_step = now, step

    def _say_end(self) -> None:
        step, minutes = self.trainer.step, (time.monotonic() - self.begin) / 60.0
        if step >= self.config.steps and self.folder.validated_at(step):
            lost = f", {skipped_told(self.folder.skipped, step)}" if self.folder.skipped else ""
            minutes = sum(self._machines().values())
            self.say(f"done: {step} steps{lost}, {minutes:.1f} minutes in all; {self.folder.weights_file}")
        elif not self.stop.is_set():
            last = max((r["step"] for r in self.folder.rows if r["kind"] == "validation"), default=None)
            weights = (
                f"{self.folder.weights_file.name} is of step {last}"
                if last
                else f"weights are written from step {min(self.config.validate_every, self.config.steps)} on"
            )
            self.say(
                f"stopped after {minutes:.1f} minutes at step {step} of {self.config.steps} ({weights}); the same"
                " command goes on from there"
            )


def producers(config: TrainingConfig, frames: Path, parts: Parts, count: int) -> Producers:
    """What makes the frames of a configuration into their place below `frames`, with so many processes."""
    return Producers(config, frames / resolve(f"{parts.frames}:data_key")(config)[:16], parts.frames, count)


def chosen_device(wanted: str) -> str:
    """Device that is meant, cpu or cuda. Raises ConfigError where torch finds no CUDA device."""
    import torch

    if wanted == "cuda" and not torch.cuda.is_available():
        raise ConfigError("--device cuda: torch finds no CUDA device here; use cpu or auto")
    return ("cuda" if torch.cuda.is_available() else "cpu") if wanted == "auto" else wanted


def _processor() -> str:
    """The processor's name, where the system tells it."""
    info = Path("/proc/cpuinfo")
    names = (
        [line.partition(":")[2].strip() for line in info.read_text().splitlines() if line.startswith("model name")]
        if info.is_file()
        else []
    )
    return names[0] if names else platform.processor() or platform.machine()
