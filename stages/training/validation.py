"""What averaged weights are measured by while they are trained: errors of depth over every kind of start, and whether
the confidence is the probability that it claims to be."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping

import numpy as np
import torch

from posegaussian.stages.network.model.network import PoseGaussianNetwork, Prediction
from posegaussian.stages.training.config import TrainingConfig
from posegaussian.stages.training.contract import Frame
from posegaussian.stages.training.examples import Example, crop_of_thing, unfitting, whole, whole_alone
from posegaussian.stages.training.loss import Batch, beats, together

ASTRAY = 24.0
"""Px by which the second picture is moved for the confidence of pairs that do not fit."""
MISSED = 16.0
"""Px that a pixel without a depth counts in the error."""
RIGHT = 1.0
"""Px: an error below it is none."""
BINS = 10
"""Of the confidence, for its calibration."""
ROWS = (0, 1)
"""Of each frame's pairs, those that are looked at."""


def measures(
    network: PoseGaussianNetwork, frames: Mapping[int, Frame], config: TrainingConfig, device: torch.device
) -> dict[str, float]:
    """Over two whole pairs of each frame, from true px and confidences.

    epe: mean error in px with the most iterations, by kind of start: matched (`epe`, and `epe T=1`), hull, truth, and
    reliefs of views alone; `start` is that of the start itself. 1px: share of the pixels of matched starts that come
    out less than `RIGHT` px off. confidence: its mean over matched starts, where the
    result is `RIGHT`, over true depth, where the second picture is moved by `ASTRAY` px, and on a thing that is no
    person. calibration error: mean distance, over matched, hull and true starts, of the confidence in a bin from the
    share of its pixels in which the learned value beats the start's.
    """
    found: dict[str, list[float]] = defaultdict(list)
    said, came = [], []

    def look(example: Example, iterations: int) -> tuple[Prediction, Batch]:
        batch = together([example], device)
        enabled = config.precision == "bf16"
        with torch.no_grad(), torch.autocast(device.type, torch.bfloat16, enabled=enabled):
            return network(batch.views, iterations, only_last=True), batch

    def note(name: str, disparity: torch.Tensor, batch: Batch) -> torch.Tensor:
        error = torch.where(torch.isfinite(disparity), (disparity - batch.truth).abs(), MISSED)
        found[name].append(float(error[batch.valid].mean()))
        return error

    most, half = config.iterations, max(1, config.iterations // 2)
    for index in sorted(frames):
        for row in ROWS:
            frame = frames[index]
            examples = {kind: whole(frame, row, config, kind) for kind in ("matched", "hull", "truth")}
            for kind, example in examples.items():
                prediction, batch = look(example, most)
                name = "epe" if kind == "matched" else f"epe {kind}"
                error = note(name, prediction.disparity, batch)
                said.append(prediction.confidence[batch.valid])
                came.append(beats(prediction, batch)[batch.valid])
                found["confidence" + name[3:]].append(float(said[-1].mean()))
                if kind != "truth":
                    note(f"{name} start", batch.views.start, batch)
                    note(f"{name} T=1", look(example, 1)[0].disparity, batch)
                if kind == "hull":
                    note(f"{name} T={half}", look(example, half)[0].disparity, batch)
                if kind == "matched":
                    right = batch.valid & (error < RIGHT)
                    found["1px"].append(float(right.sum() / batch.valid.sum()))
                    found["confidence right"].append(float(prediction.confidence[right].mean()))
            if config.single > 0:
                prediction, batch = look(whole_alone(frame, row, config), most)
                note("epe alone start", batch.views.start, batch)
                note("epe alone", prediction.disparity, batch)
            for name, example in (
                ("astray", unfitting(examples["matched"], ASTRAY)),
                ("thing", crop_of_thing(frame, row, config)),
            ):
                prediction, batch = look(example, most)
                found[f"confidence {name}"].append(float(prediction.confidence[batch.views.known].mean()))
    out = {name: float(np.nanmean(values)) for name, values in found.items()}
    return {**out, "calibration error": calibration_error(torch.cat(said).cpu().numpy(), torch.cat(came).cpu().numpy())}


def calibration_error(said: np.ndarray, came: np.ndarray) -> float:
    """Mean distance of a confidence [N] from the share of what came true [N] bool in its tenth, weighted by numbers
    (Naeini et al. 2015)."""
    bins = np.minimum((said * BINS).astype(int), BINS - 1)
    count = np.bincount(bins, minlength=BINS)
    apart = np.bincount(bins, said - came.astype(np.float64), minlength=BINS)
    return float(np.abs(apart).sum() / max(count.sum(), 1))
