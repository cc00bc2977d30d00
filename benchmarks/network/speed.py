"""What the network costs: milliseconds for two views of 512 x 512 px (one rectified pair, both directions), module by
module, and its gates.

    python -m benchmarks.network.speed [--presets fast base] [--threads 2] [--repeats 9] [--weights FILE.safetensors]

`shipped`: as the stage runs it here by default, bf16 or float32 layers over channels_last weights. `plain`: the same
network in float32 with contiguous weights, eager. Both in turns in the same run; medians. These are what the gates are
about, and show the network the whole of both pictures. `person`: the shipped way on the windows that the stage shows
it, around the person. `outside` is what the stage does for such a pair beside the network: rectification before it,
pulling back behind it.
Weights are those that ship, else random ones, which take as long. EPE: of a simulated person, whose start is the true
depth with a smooth error of 1 %; both ways must say the same.
"""

from __future__ import annotations

import argparse
import copy
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch

from benchmarks.report import publish
from posegaussian.dags.runtime.threads import limit
from posegaussian.stages.geometry.rectification import RectifiedPair, Window, rectify
from posegaussian.stages.geometry.subject import look_at_point
from posegaussian.stages.network.card import SHIPPED, read_card
from posegaussian.stages.network.inference import learned_of, predict
from posegaussian.stages.network.model.network import PoseGaussianNetwork, Prediction
from posegaussian.stages.network.model.pairs import PairViews, SourceView, rectified_pair, start_on
from posegaussian.stages.network.model.pairs import windows as around
from posegaussian.stages.network.model.presets import PRESETS
from posegaussian.stages.network.precision import faster_in_bf16
from posegaussian.stages.network.weights import load_weights
from posegaussian.stages.pose.heatmaps import draw
from posegaussian.stages.simulator.quality_scenes import benchmark_scene
from posegaussian.stages.simulator.setup import stage
from posegaussian.stages.simulator.take import Shot

MILLISECONDS = {"fast": 220.0, "base": 400.0}
"""At most, of the shipped way."""
RATIO = 1.7
"""Of plain to shipped, at least."""
AGREE = 0.01
"""Px by which the EPE of both ways may differ."""
MODULES = ("evidence", "image encoder", "fusion", "refinement", "pose encoder", "depth encoder", "decoder", "heads")


class Clock:
    """Seconds by module, a list of one number a pass."""

    def __init__(self) -> None:
        self.seconds: dict[str, list[float]] = defaultdict(list)

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        """Measure what is done within."""
        start = time.perf_counter()
        yield
        self.seconds[name].append(time.perf_counter() - start)

    def milliseconds(self, name: str) -> float:
        """Median of the passes."""
        return 1000 * float(np.median(self.seconds[name]))


def view(shot: Shot, random: np.random.Generator) -> SourceView:
    """A source view whose depth is the true one with a smooth error."""
    truth, (height, width) = shot.depth, shot.mask.shape
    error = cv2.GaussianBlur(random.normal(size=truth.shape), (0, 0), 12)
    assert shot.joints2d is not None
    heatmaps = draw(
        shot.joints2d[None], np.full((1, len(shot.joints2d)), 6.0), (width, height), (height // 4, width // 4)
    )[0]
    depth = truth * (1 + 0.01 * error / error.std())
    return SourceView(shot.color, shot.mask, depth.astype(np.float32), (truth > 0).astype(np.float32), heatmaps)


def shown(size: int) -> tuple[RectifiedPair, tuple[SourceView, SourceView], tuple[Window, Window], torch.Tensor]:
    """A pair of a simulated person, its views, windows of the whole size in the middle of both, and the true
    disparity [2, 1, H, W]."""
    staged = stage(benchmark_scene(1, 8, size, 1))
    rig = staged.written.subset(range(8))
    pair = rectify(rig, 0, 1, look_at_point(rig))
    shots = [staged.take.shoot(0, v) for v in pair.views]
    random = np.random.default_rng(0)
    views = (view(shots[0], random), view(shots[1], random))
    window = ((pair.size[0] - size) // 2, (pair.size[1] - size) // 2, size, size)
    truth = [start_on(pair, w, window, window, shots[w].depth) for w in (0, 1)]
    return pair, views, (window, window), torch.from_numpy(np.stack(truth)[:, None])


def network_of(preset: str, weights: Path | None) -> tuple[PoseGaussianNetwork, bool]:
    """A network as the stage has it, and whether its weights are trained ones."""
    file = weights or SHIPPED / f"{preset}.safetensors"
    torch.manual_seed(0)
    network = PoseGaussianNetwork(PRESETS[preset]).eval().requires_grad_(False)
    trained = file.is_file() and read_card(file).preset == preset
    if trained:
        load_weights(file, network)
    return network, trained


def end_point_error(prediction: Prediction, views: PairViews, truth: torch.Tensor) -> float:
    """Mean over the pixels with a start and a truth, px."""
    there = views.known & torch.isfinite(truth)
    return float((prediction.disparity - truth).abs()[there].mean())


def in_turns(ways: dict[str, Callable[[], Any]], repeats: int) -> dict[str, float]:
    """Median milliseconds of each way, one after the other as many times; the first round does not count."""
    found: dict[str, list[float]] = {name: [] for name in ways}
    for n in range(repeats + 1):
        for name, work in ways.items():
            start = time.perf_counter()
            work()
            if n:
                found[name].append(time.perf_counter() - start)
    return {name: 1000 * float(np.median(seconds)) for name, seconds in found.items()}


def timed(preset: str, a: argparse.Namespace) -> tuple[dict[str, Any], list[tuple[str, bool]]]:
    """The row of a preset, and its gates."""
    pair, sources, windows, truth = shown(a.size)
    network, trained = network_of(preset, a.weights)
    plain = copy.deepcopy(network)
    fast = network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    views = rectified_pair(pair, sources, windows, joints=network.joints)
    clock = Clock()
    precision = "bf16" if faster_in_bf16() else "float32"
    prediction = predict(fast, views, a.iterations, precision)

    def slow() -> Prediction:
        with torch.inference_mode():
            return plain(views, a.iterations, only_last=True)

    person = around(pair, (sources[0].depth > 0, sources[1].depth > 0), network.preset.stride)
    assert person is not None, "the scene shows somebody"
    seen = rectified_pair(pair, sources, person, joints=network.joints)
    said = predict(fast, seen, a.iterations, precision)

    def outside() -> None:
        found = rectified_pair(pair, sources, person, joints=network.joints)
        for which in (0, 1):
            learned_of(pair, which, person[which], found, said, sources[which].depth)

    ways = {
        "shipped ms": lambda: predict(fast, views, a.iterations, precision, clock),
        "plain ms": slow,
        "person ms": lambda: predict(fast, seen, a.iterations, precision),
        "outside ms": outside,
    }
    took = in_turns(ways, a.repeats)
    ratio = took["plain ms"] / took["shipped ms"]
    modules = {name: clock.milliseconds(name) for name in MODULES if name in clock.seconds}
    epe = {"EPE": end_point_error(prediction, views, truth), "EPE plain": end_point_error(slow(), views, truth)}
    row: dict[str, Any] = {
        "preset": preset,
        "weights": "trained" if trained else "random",
        "precision": precision,
        **took,
        "ratio": ratio,
        **modules,
        "rest": took["shipped ms"] - sum(modules.values()),
        **epe,
    }
    bound = MILLISECONDS[preset]
    gates = [(f"{preset}: {took['shipped ms']:.0f} ms of at most {bound:g}", took["shipped ms"] <= bound)]
    if precision == "bf16":  # float32 beside itself says nothing
        apart = abs(epe["EPE"] - epe["EPE plain"])
        gates += [
            (f"{preset}: plain float32 takes {ratio:.2f} times as long, of at least {RATIO}", ratio >= RATIO),
            (
                f"{preset}: EPE {epe['EPE']:.4f} px, {apart:.4f} px from plain float32's, of at most {AGREE}",
                apart <= AGREE,
            ),
        ]
    return row, gates


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--presets", nargs="+", choices=tuple(MILLISECONDS), default=tuple(MILLISECONDS))
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--repeats", type=int, default=9)
    parser.add_argument("--iterations", type=int, default=4)
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--weights", type=Path, help="a file, for its own preset; default: those that ship")
    parser.add_argument("--publish", action="store_true", help="write benchmarks/results/network_time.json")
    a = parser.parse_args()
    limit(a.threads)
    found = [timed(preset, a) for preset in a.presets]
    rows = transposed([row for row, _ in found])
    publish(
        "network_time" if a.publish else None,
        rows,
        {k: getattr(a, k) for k in ("threads", "repeats", "iterations", "size")},
    )
    for sentence, holds in (gate for _, held in found for gate in held):
        print("holds  " if holds else "FAILS  ", sentence)


def transposed(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """A line a figure, a column a preset: easier to read than twenty columns."""
    return [{"figure": k, **{r["preset"]: r.get(k, "") for r in rows}} for k in rows[0] if k != "preset"]


if __name__ == "__main__":
    main()
