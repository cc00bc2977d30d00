"""Settings of a training: the packaged default, a file laid over it, `--set` on top."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from posegaussian.dags.config.settings import from_assignments, validated
from posegaussian.dags.config.yaml_source import load
from posegaussian.stages.network.card import shipped
from posegaussian.stages.training.config import HARMLESS, TrainingConfig
from posegaussian.storage.archive.checkpoints import steps_kept
from posegaussian.storage.model.errors import ConfigError

PACKAGED = Path(__file__).with_name("training.yaml")
"""The full configuration with every default."""
CHECKPOINTS = "checkpoints"
"""Folder of the checkpoints in that of a training."""


def load_training(
    config: Path | None = None, assignments: Sequence[str] = (), folder: Path | None = None
) -> TrainingConfig:
    """Read `config` over the packaged default, with assignments on top.

    `folder`: of the training; where it holds a checkpoint, the weights to `start` from are asked for no more. Raises
    ConfigError listing every fault with its place.
    """
    layers = [load(PACKAGED)]
    if config is not None:
        layers.append(load(config))
    if assignments:
        layers.append(from_assignments(assignments))
    settings: TrainingConfig = validated(TrainingConfig, layers)
    begins = folder is None or not steps_kept(folder / CHECKPOINTS)
    start = settings.start if begins else None
    if start is not None and start not in shipped() and not Path(start).is_file():
        where = next(d for d in reversed(layers) if "start" in d.values).where(("start",))
        raise ConfigError(
            f"{where} start: there is no file {start};"
            f" name the weights.safetensors of another training, weights that ship ({', '.join(shipped())}), or null"
        )
    return settings


def differences(old: Mapping[str, Any], new: Mapping[str, Any], prefix: str = "") -> dict[str, str]:
    """{key: "old -> new"} of everything in which two plain configurations differ."""
    found: dict[str, str] = {}
    for key in dict.fromkeys([*new, *old]):
        a, b = old.get(key, "not set"), new.get(key, "not set")
        if isinstance(a, Mapping) and isinstance(b, Mapping):
            found |= differences(a, b, f"{prefix}{key}.")
        elif a != b:
            found[prefix + key] = f"{a} -> {b}"
    return found


def forbidden(changes: Mapping[str, str]) -> dict[str, str]:
    """Those changes with which a training cannot go on."""
    return {key: change for key, change in changes.items() if key not in HARMLESS}
