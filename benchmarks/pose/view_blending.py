"""What it is worth to weigh source views by the confidence of the joints near a point, beside the angle.

`python -m benchmarks.pose.view_blending --seeds 101,103 [--cameras 6] [--weights none]`: sequences as of an ablation, 5
frames of 192 px at 30 a second, with joints 1.5 px off, a tenth missing, 2 % elsewhere. Gaussians of a view lose
opacity as far as the joints near them are less sure in it than in another view of the picture, to some power, or, in
the last row, at all. Confidence is the joint's score, stabilised over frames by the recurrence of the paper. The
simulator's score tells hidden joints from others without error, so what is gained here is the most there is to gain.
Prints PSNR, SSIM and the change of SSIM between frames in the box of two held-out views: without, and the difference.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

from posegaussian.dags.planning.results import Results
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.simulation.simulated_run import film_capture, held_out_setting, run_capture
from posegaussian.dags.tradeoff.quality import held_out_path
from posegaussian.stages.rendering import run as rendering
from posegaussian.stages.rendering.frame import FrameRenderer
from posegaussian.stages.simulator.quality_scenes import ablation_scene
from posegaussian.stages.simulator.subjects.splits import FIRST_VALIDATION_SEED
from posegaussian.stages.splatting.definition.scene import Camera, Gaussians
from posegaussian.storage.model.cameras import Rig

NOISE = {"joint_noise": {"pixels": 1.5, "dropouts": 0.1, "outliers": 0.02}}
OMEGA = 0.5
"""Share of a frame's own score in the stabilised one."""
NEAR = 12.0
"""Px at which a joint counts e^-1/2."""
FAR = 0.05, 0.75
"""Weight and score of what no joint is near to."""
WAYS = ((0.5, True), (1.0, True), (2.0, True), (1.0, False))
"""(power of the confidence, whether it is divided by that of the surest view of the picture)."""
AGAIN = Selection(force=frozenset({"rendering", "metrics"}))


@dataclass(frozen=True)
class Sureness:
    """The joints of every source view."""

    places: dict[int, np.ndarray]
    """[F, J, 2] px."""
    scores: dict[int, np.ndarray]
    """[F, J] stabilised."""

    @classmethod
    def of(cls, results: Results) -> Sureness:
        """Of a run's joints."""
        frames, sources = range(results.context.grid.frames), results.context.views.sources
        joints = {v: results.read("pose/joints2d", frames, v) for v in sources}
        return cls({v: j[..., :2] for v, j in joints.items()}, {v: _steady(j[..., 2]) for v, j in joints.items()})

    def at(self, points: np.ndarray, rig: Rig, frame: int, view: int) -> np.ndarray:
        """[N] confidence 0..1 that a view's joints have near world points [N, 3]."""
        k, pose = rig.intrinsics[view], rig.world_to_camera[view]
        seen = (points @ pose[:3, :3].T + pose[:3, 3]) @ k.T
        place, score = self.places[view][frame], self.scores[view][frame]
        known = np.isfinite(place).all(axis=1)
        apart = ((seen[:, None, :2] / seen[:, None, 2:] - np.where(known[:, None], place, 0)) ** 2).sum(axis=-1)
        near = np.exp(-apart / (2 * NEAR**2)) * known
        weight, prior = FAR
        return np.asarray((near @ score + weight * prior) / (near.sum(axis=1) + weight))


def blending(sure: Sureness, power: float, relative: bool) -> type[FrameRenderer]:
    """A renderer that weighs views so."""

    class Blending(FrameRenderer):
        def _seen(self, camera: Camera, view: int, weight: float, views: list[int], limit: float) -> Gaussians:
            seen = super()._seen(camera, view, weight, views, limit)
            points, frame = seen.mean.double().numpy(), self.reader.inputs.partition.start + self.i
            own = sure.at(points, self.rig, frame, view)
            if relative:
                own = own / np.max([sure.at(points, self.rig, frame, v) for v in views], axis=0)
            return replace(seen, opacity=seen.opacity * torch.from_numpy(own**power).to(seen.opacity.dtype))

    return Blending


def measured(results: Results) -> dict[str, float]:
    """Means over frames and cameras, in the box."""
    values = defaultdict(list)
    for row in results.table("metrics/{path}", held_out_path(results.context).name):
        if row["region"] == "box" and row["value"] is not None:
            values[row["measure"]].append(row["value"])
    return {name: float(np.mean(v)) for name, v in values.items()}


def worth(seed: int, cameras: int, weights: str, folder: Path) -> list[dict[str, float]]:
    """What is measured without, and then in each of `WAYS`."""
    scene = ablation_scene(FIRST_VALIDATION_SEED + seed, cameras, 192, 5, 30.0, NOISE)
    settings = (held_out_setting(film_capture(scene, folder)[0]), f"network.weights={weights}")
    results = run_capture(folder, settings)[0]
    found, sure, plain = [measured(results)], Sureness.of(results), rendering.FrameRenderer
    try:
        for way in WAYS:
            rendering.FrameRenderer = blending(sure, *way)  # type: ignore[misc]
            found.append(measured(run_capture(folder, settings, AGAIN)[0]))
    finally:
        rendering.FrameRenderer = plain  # type: ignore[misc]
    return found


def _steady(scores: np.ndarray) -> np.ndarray:
    out = scores.copy()
    for f in range(1, len(out)):
        out[f] = OMEGA * scores[f] + (1 - OMEGA) * out[f - 1]
    return out


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a line a way for every seed."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--seeds", default="1,3", help="of the ablation's sequences, with commas between")
    parser.add_argument("--cameras", type=int, default=6, help="on the ring, an even number")
    parser.add_argument("--weights", default="none", help="of the network")
    given = parser.parse_args(arguments)
    for seed in (int(s) for s in given.seeds.split(",")):
        with tempfile.TemporaryDirectory() as folder:
            plain, *others = worth(seed, given.cameras, given.weights, Path(folder))
        print(f"seed {seed}, without: " + ", ".join(f"{k} {v:.4f}" for k, v in plain.items()), flush=True)
        for (power, relative), found in zip(WAYS, others, strict=True):
            way = f"power {power:g}, {'against the surest view' if relative else 'as it is'}"
            print(f"  {way}: " + ", ".join(f"{k} {found[k] - plain[k]:+.4f}" for k in plain), flush=True)


if __name__ == "__main__":
    main()
