"""How still pictures of a person are who stands still: what noise of the cameras alone changes from frame to frame.

    python -m benchmarks.quality.steadiness                    the published figures: seed 9002, 24 frames
    python -m benchmarks.quality.steadiness --seeds 2 --frames 6 --methods sweep           tuning

Benchmark scenes with eight cameras, filmed so fast that nobody moves, with noise of 2 of 255 steps at mid-grey
(`noise_gain` of the benchmark's variants, its gains left out). Colour is the mean of abs(difference) of the pictures of
one held-out camera in consecutive frames, over the pixels that are part of the person in both, in steps of 255; edges
the area by which alpha differs, over the length of the outline, in px. The worst is over pairs of frames and held-out
cameras. What was filmed changes by 2.3 of 255.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.quality.cells import DEFAULT, FLOOR
from benchmarks.quality.views import seeds
from benchmarks.report import publish
from posegaussian.dags.planning.results import Results
from posegaussian.dags.simulation.simulated_run import film_capture, held_out_setting, run_capture
from posegaussian.stages.simulator.quality_scenes import VARIANTS, benchmark_scene
from posegaussian.stages.simulator.scene import Scene
from posegaussian.storage.model.masks import foreground

METHODS = ("hull", "sgbm", "sweep", DEFAULT)
FRAME_RATE = 1e4
"""Frames a second: in two milliseconds nobody moves by more than a few of them."""
MAY_CHANGE = {"color": 1.0, "edge px": 0.3}
"""What the mean change from one frame to the next may be: steps of 255, px."""


def still_scene(seed: int, size: int, frames: int) -> Scene:
    """A benchmark scene whose person stands still, filmed with noise."""
    clean = benchmark_scene(seed, 8, size, frames)
    effects = {**clean.model_dump()["effects"], "sensor_noise": VARIANTS["noise_gain"]["effects"]["sensor_noise"]}
    return Scene.model_validate({**clean.model_dump(), "frame_rate": FRAME_RATE, "effects": effects})


def changes(color: np.ndarray, alpha: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """[F - 1] mean change of colour inside, in steps of 255, and of the outline, in px, between consecutive frames of
    pictures [F, h, w, 3] with alpha [F, h, w], uint8."""
    picture, cover = color.astype(np.float64), alpha / 255.0
    inside = foreground(alpha)
    both = inside[1:] & inside[:-1]
    apart = np.abs(np.diff(picture, axis=0)).mean(axis=-1)
    outline = np.array([_outline(m) for m in inside[:-1]])
    moved = np.abs(np.diff(cover, axis=0)).sum(axis=(1, 2))
    return (apart * both).sum(axis=(1, 2)) / both.sum(axis=(1, 2)), moved / outline


def _outline(mask: np.ndarray) -> float:
    """Length of a silhouette's outline in px: crossings of rows and columns, brought from city blocks to the plane for
    outlines of every direction alike (factor pi / 4)."""
    return float((mask[1:] != mask[:-1]).sum() + (mask[:, 1:] != mask[:, :-1]).sum()) * np.pi / 4


def rows_of(seed: int, size: int, frames: int, methods: tuple[str, ...], settings: tuple[str, ...]) -> list[dict]:
    """One row a method."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        held_out = held_out_setting(film_capture(still_scene(seed, size, frames), folder)[0])
        rows = []
        for method in methods:
            chosen = () if method == DEFAULT else (*FLOOR, f"depth.method={method}")
            results, _ = run_capture(folder, (held_out, *chosen, *settings))
            rows.append({"seed": seed, "depth": method, **measured(results)})
    return rows


def measured(results: Results) -> dict[str, Any]:
    """Means over frames and held-out cameras, and the worst."""
    context, frames = results.context, range(results.context.grid.frames)
    (path,) = context.paths.values()
    color, alpha = (results.read(f"rendering/{path.name}/{a}", frames) for a in ("color", "alpha"))
    drawn = np.stack([changes(color[:, c], alpha[:, c]) for c in range(len(path.names))])
    return {
        "color": float(drawn[:, 0].mean()),
        "worst color": float(drawn[:, 0].max()),
        "edge px": float(drawn[:, 1].mean()),
        "worst edge px": float(drawn[:, 1].max()),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=seeds, default=(9002,))
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--frames", type=int, default=24)
    parser.add_argument("--methods", type=lambda text: tuple(text.split(",")), default=METHODS)
    parser.add_argument("--set", action="append", default=[], help="a setting, as for `posegaussian run`")
    a = parser.parse_args()
    rows = [row for seed in a.seeds for row in rows_of(seed, a.size, a.frames, a.methods, tuple(a.set))]
    publish(None, rows, {"size": a.size, "frames": a.frames, "set": a.set})
    for row in rows:
        for name, bound in MAY_CHANGE.items():
            holds = "holds  " if row[name] < bound else "FAILS  "
            print(f"{holds} seed {row['seed']}, {row['depth']}: {name} {row[name]:.2f} of less than {bound}")


if __name__ == "__main__":
    main()
