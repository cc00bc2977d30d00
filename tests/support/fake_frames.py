"""Frames of noise, made in no time and without torch, kept to `stages/training/contract.py`.

The variable POSEGAUSSIAN_FAKE, JSON, slows steps (`step_s`), breaks a frame (`raises`), kills its process once (`dies`)
or always (`dies_always`).
"""

from __future__ import annotations

import json
import os
import signal
from pathlib import Path
from typing import Any

import numpy as np

from posegaussian.stages.training.config import TrainingConfig
from posegaussian.stages.training.contract import Frame


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
    return noise(config, config.scene_seed(index), index % config.frames_per_scene)


def validation_frame(config: TrainingConfig, index: int) -> Frame:
    return noise(config, config.validation_seed(index), 0)


def noise(config: TrainingConfig, seed: int, moment: int) -> Frame:
    random = np.random.default_rng([config.seed, seed, moment])
    x = random.normal(size=(64, 8)).astype(np.float32)
    return {"x": x, "y": (x.sum(axis=1) + 0.1 * random.normal(size=64)).astype(np.float32)}


def data_key(config: TrainingConfig) -> str:
    return f"{config.seed:064x}"


def frames_of_step(config: TrainingConfig, step: int) -> range:
    first = step // config.steps_per_frame
    return range(first, first + config.window)
