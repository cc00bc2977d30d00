"""Random scenes of extreme scale, anisotropy, opacity, depth and camera: nothing that is drawn of them may be other
than finite.

    python -m tests.hard_cases.extreme [--scenes 10000] [--start 0]

draws them with gradients through the compiled back end and names the first seed that fails.
"""

from __future__ import annotations

import argparse

import numpy as np
import torch

from posegaussian.stages.splatting.definition.scene import Camera, Cutoffs, Gaussians
from tests.hard_cases.laws import drawn


def scene(seed: int, count: int | None = None) -> tuple[Gaussians, Camera, Cutoffs]:
    """A float32 scene; its ranges are drawn first, so that most are extreme in one way or another."""
    rng = np.random.default_rng(seed)
    n = int(rng.choice([0, 1, 2, 7, 8, 30, 100])) if count is None else count

    def powers(low: float, high: float, size: tuple[int, ...]) -> np.ndarray:
        """Log-uniform over a random part of the range."""
        a, b = np.sort(rng.uniform(low, high, 2))
        return 10.0 ** rng.uniform(a, b, size)

    width, height = (int(s) for s in rng.choice([1, 3, 16, 33, 70], 2))
    focal = float(10 ** rng.uniform(-1, 5))
    k = np.array(
        [
            [focal, rng.choice([0.0, 3.0]), rng.uniform(-0.2, 1.2) * width],
            [0, focal * rng.uniform(0.5, 2), rng.uniform(-0.2, 1.2) * height],
            [0, 0, 1],
        ]
    )
    pose = np.eye(4)
    pose[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0] if rng.random() < 0.3 else np.eye(3)
    pose[:3, 3] = rng.normal(size=3) * rng.choice([0.0, 1.0, 1e3])

    z = powers(-4, 6, (n,)) * rng.choice([1, 1, 1, -1], n)
    pixel = np.abs(z)[:, None] / focal  # what a pixel measures there
    aside = (rng.uniform(-0.2, 1.2, (n, 2)) * [width, height] - k[:2, 2]) * powers(-1, 1, (1,)) * pixel
    mean = (np.concatenate([aside, z[:, None]], axis=1) - pose[:3, 3]) @ pose[:3, :3]
    kind = rng.random()
    scale = (
        powers(-20, 8, (n, 3))
        if kind < 0.2
        else powers(-2, 4, (n, 1)) * powers(-6, 0, (n, 3)) * pixel
        if kind < 0.6
        else powers(-1, 3, (n, 3)) * pixel
    )
    opacity = (
        rng.choice([0.0, 1e-30, 1e-9, 1 / 255, 0.0039, 0.0040, 0.5, 0.98999, 0.99, 0.99001, 1.0, 1.5], n)
        if rng.random() < 0.5
        else rng.uniform(0, 1, n)
    )
    color = rng.normal(size=(n, 3)) * powers(-3, 3, (1,))
    parts = [
        mean,
        np.linalg.qr(rng.normal(size=(n, 3, 3)))[0] * (1 if rng.random() < 0.8 else powers(-8, 4, (1,))),
        scale,
        opacity,
        color,
    ]
    if n and rng.random() < 0.3:
        part = parts[rng.integers(5)]
        part.reshape(n, -1)[rng.integers(n), 0] = rng.choice([np.nan, np.inf, -np.inf, 3e38, 1e-45])
    cut = Cutoffs(low_pass=float(rng.choice([0.0, 0.0, 0.3])), compensation=bool(rng.random() < 0.3))
    with np.errstate(over="ignore"):
        return Gaussians(*(torch.as_tensor(p.astype(np.float32)) for p in parts)), Camera(k, pose, width, height), cut


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=10_000)
    parser.add_argument("--start", type=int, default=0)
    options = parser.parse_args()
    torch.set_num_threads(1)
    blank = masked = 0
    for seed in range(options.start, options.start + options.scenes):
        try:
            out, _ = drawn(*scene(seed))
        except AssertionError as e:
            raise SystemExit(f"scene {seed}: a number that is not finite {e}") from e
        blank += not bool(out.alpha.any())
        masked += out.masked[0]
    print(
        f"{options.scenes} scenes from seed {options.start}: every number is finite; {blank} pictures are blank,"
        f" {masked} Gaussians were masked"
    )


if __name__ == "__main__":
    main()
