"""What it is worth to weigh source views by the confidence of the joints near a point, beside the angle.

`python -m benchmarks.pose.view_blending --seeds 103,101 [--cameras 6] [--weights none]`: sequences as of an ablation, 5
frames of 192 px at 30 a second, with joints 1.5 px off, a tenth missing, 2 % elsewhere, with the effect `pose_blending`
off, on, and as the judge decides. The simulator's score tells hidden joints from others without error, so what is
gained here is the most there is to gain. Prints PSNR, SSIM and the change of SSIM between frames in the box of two
held-out views: without, and the differences.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.quality.cells import UNREFINED
from posegaussian.dags.diagnostics.held_out_quality import held_out_path
from posegaussian.dags.planning.results import Results
from posegaussian.dags.simulation.simulated_run import film_capture, held_out_setting, run_capture
from posegaussian.stages.rendering.facts import POSE_BLENDING
from posegaussian.stages.simulator.quality_scenes import ablation_scene
from posegaussian.stages.simulator.subjects.splits import FIRST_VALIDATION_SEED

NOISE = {"joint_noise": {"pixels": 1.5, "dropouts": 0.1, "outliers": 0.02}}
OFF, ON, AUTO = "off", "on", "auto"


def measured(results: Results) -> dict[str, float]:
    """Means over frames and cameras, in the box."""
    values = defaultdict(list)
    for row in results.table("metrics/{path}", held_out_path(results.context).name):
        if row["region"] == "box" and row["value"] is not None:
            values[row["measure"]].append(row["value"])
    return {name: float(np.mean(v)) for name, v in values.items()}


def worth(seed: int, cameras: int, weights: str, folder: Path) -> tuple[dict[str, dict[str, float]], str]:
    """What is measured with the effect off, on and on auto, and why it is what it is."""
    scene = ablation_scene(FIRST_VALIDATION_SEED + seed, cameras, 192, 5, 30.0, NOISE)
    settings = (held_out_setting(film_capture(scene, folder)[0]), f"network.weights={weights}", *UNREFINED)
    found = {}
    for state in (OFF, ON, AUTO):
        results = run_capture(folder, (*settings, f"effects.{POSE_BLENDING}={state}"))[0]
        found[state] = measured(results)
    return found, results.context.effects[POSE_BLENDING].sentence


def main(arguments: Sequence[str] | None = None) -> None:
    """Print three lines for every seed."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--seeds", default="103,101", help="of the ablation's sequences, with commas between")
    parser.add_argument("--cameras", type=int, default=6, help="on the ring, an even number")
    parser.add_argument("--weights", default="none", help="of the network")
    given = parser.parse_args(arguments)
    for seed in (int(s) for s in given.seeds.split(",")):
        with tempfile.TemporaryDirectory() as folder:
            found, why = worth(seed, given.cameras, given.weights, Path(folder))
        print(f"seed {seed}, off: " + ", ".join(f"{k} {v:.4f}" for k, v in found[OFF].items()), flush=True)
        for state in (ON, AUTO):
            told = ", ".join(f"{k} {v - found[OFF][k]:+.4f}" for k, v in found[state].items())
            print(f"  {state}: {told}", flush=True)
        print(f"  {why}", flush=True)


if __name__ == "__main__":
    main()
