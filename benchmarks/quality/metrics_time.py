"""What each measure of the metrics stage costs: milliseconds and working memory of one picture, both regions, one
thread.

    python -m benchmarks.quality.metrics_time [--sizes 512 1024] [--repeats 5]

A picture is 8-bit noise on gradients inside a mask whose box covers 32 % of it, as a standing person's does. LPIPS runs
with made weights of the official shapes: the time does not depend on their values. The working memory is the highest
resident memory during a call above that before it; the declaration is what the stage asks for.
"""

from __future__ import annotations

import argparse
import hashlib
import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch

from benchmarks.report import publish
from posegaussian.stages.metrics.measures.lpips import FILES
from posegaussian.stages.metrics.measures.lpips_network import STACKS, Stack
from posegaussian.stages.metrics.measures.registry import METRICS
from posegaussian.stages.metrics.params import MetricsParams
from posegaussian.stages.metrics.run import measure


def picture(size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(rendered, truth, mask) of a square picture."""
    rng = np.random.default_rng(0)
    y, x = np.mgrid[0:size, 0:size] / size
    truth = np.stack([255 * x, 255 * y, 127 + 127 * np.sin(30 * x * y)], axis=2) + rng.normal(0, 10, (size, size, 3))
    mask = np.where(((x - 0.5) / 0.2) ** 2 + ((y - 0.5) / 0.4) ** 2 < 1, 255, 0).astype(np.uint8)
    truth = np.clip(truth, 0, 255).astype(np.uint8)
    rendered = np.clip(truth * (mask[..., None] / 255) + rng.normal(0, 6, truth.shape), 0, 255).astype(np.uint8)
    return rendered, truth, mask


def weights(folder: Path, stack: Stack) -> dict[str, tuple[str, str]]:
    """{trunk | heads: (path, sha256)} of made weights."""
    rng = torch.Generator().manual_seed(0)
    trunk = {}
    for c in stack.layers:
        spread = (2 / (c.channels[0] * c.size**2)) ** 0.5
        trunk[f"{c.key}.weight"] = spread * torch.randn(c.channels[1], c.channels[0], c.size, c.size, generator=rng)
        trunk[f"{c.key}.bias"] = torch.zeros(c.channels[1])
    heads = {f"lin{i}.model.1.weight": torch.rand(1, n, 1, 1, generator=rng) for i, n in enumerate(stack.widths)}
    found = {}
    for name, state in (("trunk", trunk), ("heads", heads)):
        torch.save(state, folder / f"{name}.pth")
        found[name] = (str(folder / f"{name}.pth"), hashlib.sha256((folder / f"{name}.pth").read_bytes()).hexdigest())
    return found


def settings(name: str, folder: Path) -> MetricsParams:
    """Settings that ask for one measure."""
    if name not in FILES:
        return MetricsParams.model_validate({"measures": [name]})
    (folder / name).mkdir()
    files = dict(zip(FILES[name], weights(folder / name, STACKS[name]).values(), strict=True))
    return MetricsParams.model_validate(
        {
            "measures": [name],
            "lpips_weights": {k: v[0] for k, v in files.items()},
            "lpips_sha256": {k: v[1] for k, v in files.items()},
        }
    )


def memory(field: str) -> int:
    """Bytes of a line of /proc/self/status: VmRSS now, or VmHWM, the highest since it was reset."""
    line = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith(field + ":"))
    return int(line.split()[1]) * 1024


def row(name: str, size: int, params: MetricsParams, repeats: int) -> dict[str, Any]:
    """One line of the table."""
    pictures = picture(size)
    measure(*pictures, params)  # loads libraries and weights
    Path("/proc/self/clear_refs").write_text("5")
    before = memory("VmRSS")
    seconds = []
    for _ in range(repeats):
        start = time.perf_counter()
        measure(*pictures, params)
        seconds.append(time.perf_counter() - start)
    peak = max(0, memory("VmHWM") - before)
    declared = METRICS[name].bytes_a_pixel * size * size
    return {
        "measure": name,
        "px": size,
        "min ms": min(seconds) * 1e3,
        "median ms": statistics.median(seconds) * 1e3,
        "memory MiB": peak / 2**20,
        "declared MiB": declared / 2**20,
        "bytes a pixel": peak / size**2,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", type=int, nargs="+", default=[512, 1024], help="sides of the pictures, px")
    parser.add_argument("--repeats", type=int, default=5)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    with tempfile.TemporaryDirectory() as folder:
        asked = {name: settings(name, Path(folder)) for name, m in METRICS.items() if m.change_of is None}
        rows = [
            row(name, size, params, arguments.repeats) for size in arguments.sizes for name, params in asked.items()
        ]
    publish("metrics_time", rows, vars(arguments))


if __name__ == "__main__":
    main()
