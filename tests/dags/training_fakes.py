"""A training that takes no time, kept to `stages/training/contract.py`: frames of noise, a line fitted to them.

The variable POSEGAUSSIAN_FAKE, JSON, slows steps (`step_s`), breaks a frame (`raises`), kills its process once (`dies`) or always (`dies_always`).
"""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch

from stages.training.config import TrainingConfig
from stages.training.contract import Frame


def behaviour() -> dict[str, Any]:
    return json.loads(os.environ.get("POSEGAUSSIAN_FAKE", "{}"))


def make_frame(config: TrainingConfig, index: int) -> Frame:
    wrong = behaviour()
    if wrong.get("raises") == index:
        raise ValueError("the person left the picture")
    if wrong.get("dies_always") == index:
        os.kill(os.getpid(), signal.SIGKILL)
    if "dies" in wrong and wrong["dies"][0] == index and not Path(wrong["dies"][1]).exists():
        Path(wrong["dies"][1]).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return noise(config, index)


def validation_frame(config: TrainingConfig, index: int) -> Frame:
    return noise(config, 10_000 + index)


def noise(config: TrainingConfig, index: int) -> Frame:
    random = np.random.default_rng([config.seed, index])
    x = random.normal(size=(64, 8)).astype(np.float32)
    return {"x": x, "y": (x.sum(axis=1) + 0.1 * random.normal(size=64)).astype(np.float32)}


def data_key(config: TrainingConfig) -> str:
    return f"{config.seed:064x}"


def frames_of_step(config: TrainingConfig, step: int) -> range:
    first = step // config.steps_per_frame
    return range(first, first + config.window)


class Trainer:
    """AdamW on a line, with an average of its weights."""

    def __init__(self, config: TrainingConfig, device: str = "cpu") -> None:
        generator = torch.Generator().manual_seed(config.seed)
        self.config, self.step, self.skipped = config, 0, 0
        self.line = torch.nn.Linear(8, 1)
        with torch.no_grad():
            self.line.weight.copy_(torch.randn(1, 8, generator=generator))
            self.line.bias.zero_()
        self.ema = {k: v.clone() for k, v in self.line.state_dict().items()}
        self.optimizer = torch.optim.AdamW(self.line.parameters(), lr=0.05)

    def advance(self, frames: Mapping[int, Frame]) -> dict[str, float]:
        assert set(frames) == set(frames_of_step(self.config, self.step))
        time.sleep(behaviour().get("step_s", 0.0))
        random = np.random.default_rng([self.config.seed, self.step])
        frame = frames[int(random.choice(sorted(frames)))]
        rows = random.integers(64, size=16)
        error = (self.line(torch.from_numpy(frame["x"][rows]))[:, 0] - torch.from_numpy(frame["y"][rows])).square().mean()
        self.optimizer.zero_grad()
        error.backward()
        self.optimizer.step()
        with torch.no_grad():
            for k, v in self.line.state_dict().items():
                self.ema[k].lerp_(v, 0.1)
        self.step += 1
        return {"loss": error.item(), "epe": error.item() ** 0.5, "skipped": 0.0}

    def state(self) -> dict[str, Any]:
        return {"step": self.step, "line": dict(self.line.state_dict()), "ema": self.ema, "optimizer": self.optimizer.state_dict()}

    def restore(self, state: Mapping[str, Any]) -> None:
        self.step, self.ema = state["step"], state["ema"]
        self.line.load_state_dict(state["line"])
        self.optimizer.load_state_dict(state["optimizer"])

    def validate(self, frames: Mapping[int, Frame]) -> dict[str, float]:
        weight, bias = self.ema["weight"].numpy(), self.ema["bias"].numpy()
        errors = [float(np.abs(f["x"] @ weight[0] + bias[0] - f["y"]).mean()) for f in frames.values()]
        return {"epe": float(np.mean(errors)), "epe_floor": 2.0, "psnr": 20.0 - float(np.mean(errors))}

    def weights(self) -> dict[str, torch.Tensor]:
        return self.ema
