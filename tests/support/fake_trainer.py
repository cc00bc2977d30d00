"""A trainer that takes no time, kept to `stages/training/contract.py`: fits a line to frames of noise."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch

from posegaussian.stages.network.card import WeightsError
from posegaussian.stages.training.config import TrainingConfig
from posegaussian.stages.training.contract import Frame
from tests.support.fake_frames import behaviour, frames_of_step


class Trainer:
    """AdamW on a line, with an average of its weights."""

    def __init__(self, config: TrainingConfig, device: str = "cpu") -> None:
        if config.start is not None and not Path(config.start).is_file():
            raise WeightsError(f"no weights {config.start}")
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
        error = (
            (self.line(torch.from_numpy(frame["x"][rows]))[:, 0] - torch.from_numpy(frame["y"][rows])).square().mean()
        )
        if self.step in range(*behaviour().get("infinite", (0, 0))):
            error = error * torch.inf
            self.skipped += 1
        else:
            self.optimizer.zero_grad()
            error.backward()
            self.optimizer.step()
            with torch.no_grad():
                for k, v in self.line.state_dict().items():
                    self.ema[k].lerp_(v, 0.1)
        self.step += 1
        return {"loss": error.item(), "epe": error.item() ** 0.5, "skipped": float(self.skipped)}

    def state(self) -> dict[str, Any]:
        return {
            "step": self.step,
            "skipped": self.skipped,
            "line": dict(self.line.state_dict()),
            "ema": self.ema,
            "optimizer": self.optimizer.state_dict(),
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        self.step, self.skipped, self.ema = state["step"], state["skipped"], state["ema"]
        self.line.load_state_dict(state["line"])
        self.optimizer.load_state_dict(state["optimizer"])

    def validate(self, frames: Mapping[int, Frame]) -> dict[str, float]:
        weight, bias = self.ema["weight"].numpy(), self.ema["bias"].numpy()
        errors = [float(np.abs(f["x"] @ weight[0] + bias[0] - f["y"]).mean()) for f in frames.values()]
        return {"epe": float(np.mean(errors)), "epe start": 2.0, "psnr": 20.0 - float(np.mean(errors))}

    def weights(self) -> dict[str, torch.Tensor]:
        return self.ema
