"""The network's forward pass for one pair of a simulated person, both directions, as benchmarks/network/speed.py shows
it, and how near it comes to plain float32 on the CPU."""

from __future__ import annotations

from collections.abc import Iterator

import torch

from benchmarks.gpu.rows import Row, Setup
from benchmarks.network.speed import network_of, shown
from posegaussian.stages.network.inference import predict
from posegaussian.stages.network.model.network import PoseGaussianNetwork
from posegaussian.stages.network.model.pairs import PairViews, rectified_pair

PRESETS = ("fast", "base")
SIDE, ITERATIONS = 512, 4


def rows(setup: Setup) -> Iterator[Row]:
    """Both presets; `base` has random weights, which take as long."""
    pair, sources, windows, _ = shown(setup.px(SIDE, small=64))
    for preset in PRESETS:
        network, _ = network_of(preset, None)
        views = rectified_pair(pair, sources, windows, joints=network.joints)
        yield from timings(f"network {preset}", network, views, setup)


def timings(name: str, network: PoseGaussianNetwork, views: PairViews, setup: Setup) -> Iterator[Row]:
    """Of one preset, whose views are on the host."""
    side = f"{SIDE} px"
    plain = predict(network, views, ITERATIONS, "float32")
    network = network.to(setup.device).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    there = views.to(setup.device)
    for precision in ("bf16", "float32"):

        def forward(layers: str = precision) -> None:
            predict(network, there, ITERATIONS, layers)

        taken, memory = setup.timed(forward)
        found = predict(network, views, ITERATIONS, precision)
        apart = float((found.disparity - plain.disparity)[views.known].abs().mean())
        yield Row(f"{name}, {precision}: a pair", side, taken, "ms", setup.name)
        yield Row(f"{name}, {precision}: memory", side, memory, "MiB", setup.name)
        yield Row(f"{name}, {precision}: disparity from float32 on the CPU, mean", side, apart, "px")
    moved, _ = setup.timed(lambda: predict(network, views, ITERATIONS, "bf16"))
    yield Row(f"{name}, bf16: a pair from the host and back", side, moved, "ms", setup.name)
