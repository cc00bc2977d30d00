"""Per-scene 3D Gaussian splatting on photographs, scored on those that were kept aside.

    python -m benchmarks.baselines.captured [--minutes 1 3 10] [--archives FOLDER] [--sheet sheet.png]

The seven good cameras of `bust` (benchmarks/quality/captures.py), the same held-out photographs and the same score;
minutes are CPU minutes of the optimisation. `clipped` pictures are clipped to the source masks' hull and filled as
rendering does, the others are what a user of 3DGS sees.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.baselines.splatting import FreeGaussians, Scene, optimised
from benchmarks.quality.captures import CASES, draw, run_case, score
from benchmarks.report import show
from posegaussian.stages.rendering.run import quantise


def captured(scene: Scene, minutes: list[float]) -> list[dict[str, Any]]:
    """One row a time, held-out photograph and kind of picture."""
    rows: list[dict[str, Any]] = []
    names = scene.results.context.rig.names

    def watch(spent: float, gaussians: FreeGaussians) -> None:
        for v, clipped, plain in scene.pictures(gaussians):
            camera = scene.cameras[v]
            filmed = scene.results.read("frames/color", range(1), v)[0][: camera.height, : camera.width]
            mask = scene.masks[v][: camera.height, : camera.width]
            for kind, picture in (("3dgs, clipped", clipped), ("3dgs", plain)):
                found = score(quantise(torch.from_numpy(picture)), filmed, mask)
                own = {"method": kind, "minutes": spent / 60, "gaussians": len(gaussians)}
                rows.append(own | {"capture": f"{spent / 60:g} min", "camera": names[v], **found})

    for steps in optimised(scene.start(), scene.filmed(), [60 * m for m in minutes], watch):
        print(f"{rows[-1]['minutes']:g} min: {steps} steps, {rows[-1]['gaussians']} Gaussians", flush=True)
    return rows


def means(rows: list[dict[str, Any]]) -> list[Mapping[str, Any]]:
    """One row a method and time: the mean over the photographs."""
    out: list[Mapping[str, Any]] = []
    for method, minutes in dict.fromkeys((r["method"], r["minutes"]) for r in rows):
        own = [r for r in rows if (r["method"], r["minutes"]) == (method, minutes)]
        found = {k: float(np.mean([r[k] for r in own])) for k in ("psnr", "ssim")}
        out.append({"method": method, "minutes": minutes, "gaussians": own[0]["gaussians"], **found})
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, nargs="+", default=[1, 3, 10])
    parser.add_argument("--archives", type=Path, help="a folder where the archive is kept and used again")
    parser.add_argument("--sheet", type=Path, help="a PNG of every photograph beside its last clipped picture")
    a = parser.parse_args()
    captures = Path(os.environ.get("POSEGAUSSIAN_CAPTURES", "../shared")).resolve() / "captures"
    torch.set_num_threads(1)
    (case,) = CASES["bust"]
    with tempfile.TemporaryDirectory() as scratch:
        archive = (a.archives or Path(scratch)).resolve() / "bust_hull"
        archive.parent.mkdir(parents=True, exist_ok=True)
        rows = captured(Scene.of(run_case(case, captures, archive, ["depth.method=hull"])), a.minutes)
    show(means(rows))
    if a.sheet:
        draw([r for r in rows if r["minutes"] == max(a.minutes) and r["method"] == "3dgs, clipped"], a.sheet)


if __name__ == "__main__":
    main()
