"""What a training run asks of the craft: frames by number, and a trainer that takes one step at a time.

`stages/training/frames.py`, `examples.py` and `trainer.py` keep it; `dags/training/loop.py` relies on nothing else.
Beside these it asks for `frames_of_step(config, step) -> range`: the training frames that must be at hand for a step,
counted from 0; neither end of the range ever falls as steps go on.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np

from posegaussian.stages.training.config import TrainingConfig

Frame = dict[str, np.ndarray]
"""Everything that a step may cut out of one moment of one scene, by name; goes into an .npz file as it is."""


class Frames(Protocol):
    """The data: a module of pure functions, called in processes of their own, which need not import torch."""

    def make_frame(self, config: TrainingConfig, index: int) -> Frame:
        """Training frame `index`, from 0 on: moment `index % config.frames_per_scene` of the scene of
        `config.scene_seed(index)`.

        So frames come round again after `config.scene_frames()`, and two that show the same moment of the same seed are
        equal.
        """

    def validation_frame(self, config: TrainingConfig, index: int) -> Frame:
        """Validation frame `index`, 0 to `config.validation.count` - 1;
        shows the scene of `config.validation_seed(index)`."""

    def data_key(self, config: TrainingConfig) -> str:
        """Hexadecimal digest of all that a frame depends on beside its seed and its moment, the code included."""


class Trainer(Protocol):
    """Weights, optimiser and random choices of one training; made as `Trainer(config, device)`."""

    step: int
    """Steps done."""

    def advance(self, frames: Mapping[int, Frame]) -> dict[str, float]:
        """Do step `self.step` with the frames of it, and return numbers for the log.

        Among them `loss`; where known `epe`, px, and `skipped`, the steps so far that were not finite and changed no
        weight.
        """

    def state(self) -> dict[str, Any]:
        """Tensors and plain numbers in dicts, lists and tuples: all that is needed to go on bit-exactly."""

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from a state, on this trainer's device."""

    def validate(self, frames: Mapping[int, Frame]) -> dict[str, float]:
        """Measures of the averaged weights on validation frames; changes nothing that a later step sees."""

    def weights(self) -> dict[str, Any]:
        """The averaged weights, {name: tensor}."""
