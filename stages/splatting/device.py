"""The device of this worker: the GPU that it sees, or the CPU."""

from __future__ import annotations

import torch


def device() -> torch.device:
    """The only place where the device is chosen. A CPU worker of a local run sees no GPU, a GPU worker one."""
    return torch.device("cuda" if torch.cuda.is_available() else "cpu")
