"""A training, one step at a time: what a step does follows from the settings,
the state before it and its frames alone."""

from __future__ import annotations

import copy
import time
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from torch import nn

from posegaussian.stages.network.asset import weights_file
from posegaussian.stages.network.losses import PoseFusion, masked_mean
from posegaussian.stages.network.model.network import PoseGaussianNetwork
from posegaussian.stages.network.params import NetworkParams
from posegaussian.stages.network.weights import load_weights
from posegaussian.stages.training.config import TrainingConfig
from posegaussian.stages.training.contract import Frame
from posegaussian.stages.training.examples import Example, drawn
from posegaussian.stages.training.loss import LossTerms, depth_terms, pose_terms, render_terms, together
from posegaussian.stages.training.validation import measures

QUICK = 8.0
"""Times the learning rate that the layers have which begin at zero: they have far to go."""
MAY_LACK = ("refinement.absent",)
"""Parameters that weights to continue from need not have: they begin as they are made."""


class NetworkTrainer:
    """Network, averaged weights and optimiser."""

    def __init__(self, config: TrainingConfig, device: str = "cpu") -> None:
        """The network's first weights follow from `config.seed`, or are those that `config.start` names. Raises
        WeightsError where these do not fit."""
        self.config, self.device = config, torch.device(device)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(config.seed)
            preset = config.network()
            network = PoseGaussianNetwork(preset)
            # torch's stubs do not know that a module's `to` takes a memory format
            self.network = network.to(self.device, memory_format=torch.channels_last)  # type: ignore[call-overload]
            width = preset.widths[-1]
            self.fusion = (
                PoseFusion(width, width, weight=config.pose_fusion).to(self.device)
                if self.network.pose is not None
                else None
            )
        if config.start is not None:
            load_weights(weights_file(NetworkParams(weights=config.start)), self.network, may_lack=MAY_LACK)
        self.averaged = copy.deepcopy(self.network).requires_grad_(False).eval()
        learnt = [*self.network.parameters(), *(self.fusion.parameters() if self.fusion is not None else ())]
        self.optimiser = torch.optim.AdamW(
            _groups(learnt, self.network.last_layers()),
            lr=config.learning_rate,
            weight_decay=config.weight_decay,
            foreach=False,
        )
        self.learnt = learnt
        self.step, self.skipped = 0, 0

    def advance(self, frames: Mapping[int, Frame]) -> dict[str, float]:
        """Do the next step; a loss or gradient that is not finite changes no weight and is counted."""
        began = time.perf_counter()
        examples, iterations = drawn(self.config, self.step, frames)
        cut = time.perf_counter()
        terms, numbers = self._terms(examples, iterations)
        self.optimiser.zero_grad(set_to_none=True)
        terms.total.backward()
        norm = float(nn.utils.clip_grad_norm_(self.learnt, self.config.clip))
        rate = self._rate()
        if np.isfinite(norm) and bool(torch.isfinite(terms.total.detach())):
            for group in self.optimiser.param_groups:
                group["lr"] = rate * group["factor"]
            self.optimiser.step()
            self._average()
        else:
            self.skipped += 1
        self.step += 1
        seconds = {"seconds examples": cut - began, "seconds step": time.perf_counter() - cut}
        return {
            "loss": float(terms.total.detach()),
            **{k: float(v.detach()) for k, v in terms._asdict().items()},
            **numbers,
            "gradient": norm,
            "rate": rate,
            "skipped": float(self.skipped),
            **seconds,
        }

    def _terms(self, examples: list[Example], iterations: int) -> tuple[LossTerms, dict[str, float]]:
        batch = together(examples, self.device)
        views, truth, valid, strange = batch
        with torch.autocast(self.device.type, torch.bfloat16, enabled=self.config.precision == "bf16"):
            prediction = self.network(views, iterations)
        depth = depth_terms(prediction, batch, self.config)
        pose = pose_terms(self.fusion, prediction, views, self.config)
        joint = self.config.phase(self.step) == "joint"
        render = (
            render_terms(self.network, prediction, examples, self.config, torch.get_num_threads())
            if joint
            else depth.new_zeros(())
        )
        with torch.no_grad():
            before, after = (
                float(masked_mean((torch.where(valid, d, 0) - truth).abs(), valid))
                for d in (views.start, prediction.disparity)
            )
            sure, doubtful = (
                float(masked_mean(prediction.confidence, where)) for where in (valid & ~strange, valid & strange)
            )
            numbers = {
                "epe": after,
                "epe start": before,
                "confidence": sure,
                "confidence strange": doubtful,
                "iterations": float(iterations),
            }
        return LossTerms(depth, pose, render), numbers

    def _rate(self) -> float:
        """Rising over the warm-up, then level, then with the inverse root of the steps."""
        rising = min(1.0, (self.step + 1) / max(self.config.warm_up, 1))
        return self.config.learning_rate * rising * min(1.0, (self.config.settled / max(self.step, 1)) ** 0.5)

    def _average(self) -> None:
        """Move the averaged weights; the first steps count more, or the random start would stay for long."""
        keep = min(self.config.ema, (1 + self.step) / (10 + self.step))
        with torch.no_grad():
            for a, p in zip(self.averaged.state_dict().values(), self.network.state_dict().values(), strict=True):
                if a.is_floating_point():
                    a.lerp_(p, 1 - keep)
                else:
                    a.copy_(p)

    def validate(self, frames: Mapping[int, Frame]) -> dict[str, float]:
        """Of the averaged weights, over two whole pairs of each frame; see `measures`."""
        return measures(self.averaged, frames, self.config, self.device)

    def weights(self) -> dict[str, torch.Tensor]:
        """The averaged weights by name."""
        return self.averaged.state_dict()

    def state(self) -> dict[str, Any]:
        """Everything that later steps depend on."""
        fusion = self.fusion.state_dict() if self.fusion is not None else {}
        return {
            "network": self.network.state_dict(),
            "averaged": self.averaged.state_dict(),
            "fusion": fusion,
            "optimiser": self.optimiser.state_dict(),
            "step": self.step,
            "skipped": self.skipped,
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from a state that `state` gave."""
        self.network.load_state_dict(state["network"])
        self.averaged.load_state_dict(state["averaged"])
        if self.fusion is not None:
            self.fusion.load_state_dict(state["fusion"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.step, self.skipped = int(state["step"]), int(state["skipped"])


def _groups(learnt: list[nn.Parameter], last: list[nn.Parameter]) -> list[dict[str, Any]]:
    """Groups of the optimiser: `last` learn `QUICK` times as fast as the others."""
    quick = {id(p) for p in last}
    return [{"params": [p for p in learnt if id(p) not in quick], "factor": 1.0}, {"params": last, "factor": QUICK}]
