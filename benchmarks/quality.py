"""Quality of the analytic person at 512 px: 8 cameras, held-out views in the middle between them, by kind of depth.

    python -m benchmarks.quality [--size 512] [--frames 2] [--held-out 8]

Prints box and full PSNR/SSIM of the held-out views, EPE and the share of pixels within 1 px of the depth (definitions in
stages/metrics), and seconds a frame of every stage that differs. EPE of true depth is its resampling error: 0.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from benchmarks.report import publish
from dags.demo import film
from dags.events import Event, TaskDone
from dags.importing import find_capture, register
from dags.plan import Selection
from dags.results import Results
from dags.run import Run
from dags.serial import SerialBackend
from dags.session import Session
from stages.metrics.depth_error import depth_error
from storage.archive import Archive

NAME = "person"


def measure(archive: Path, capture: Path, method: str, held_out: int) -> dict[str, Any]:
    """Run one depth method (what does not depend on it stays fresh) and average its metrics."""
    names = ", ".join(f"mid{i:02d}" for i in range(held_out))
    from dags.config import load_configuration

    session = Session(load_configuration(None, [f"views.held_out=[{names}]", f"depth.method={method}"], folder=archive), str(archive), Console(quiet=True))
    settings = session.configuration.for_sequence(NAME)
    register(Archive.open(str(archive), create=True), NAME, find_capture("images", capture, [], settings), settings)
    plan, seconds = session.plan(NAME, Selection()), {}

    def note(event: Event) -> None:
        if isinstance(event, TaskDone):
            seconds[event.task.stage] = seconds.get(event.task.stage, 0.0) + event.receipt.facts["cpu_seconds"]

    ended = Run([plan], Selection(), SerialBackend(), [note]).go()
    if ended.failed or ended.blocked:
        raise SystemExit(f"{method}: {ended.failed} tasks failed, {ended.blocked} blocked")
    results = Results(plan.context)
    frames = len(plan.context.source_frames)
    return {"depth": method, **_pictures(results), **_depth(results, frames), **{f"{s} s/frame": round(seconds.get(s, 0.0) / frames, 3) for s in ("depth", "gaussians", "rendering")}}


def _pictures(results: Results) -> dict[str, float]:
    """Mean PSNR and SSIM over all held-out pictures."""
    (path,) = results.context.paths
    rows = results.table("metrics/{path}", path)
    return {f"{region} {m}": float(np.mean([r["value"] for r in rows if (r["region"], r["measure"]) == (region, m)])) for region in ("box", "full") for m in ("psnr", "ssim")}


def _depth(results: Results, frames: int) -> dict[str, float]:
    """Mean EPE and 1 px share over source views and frames."""
    context = results.context
    found = []
    for view in context.views.sources:
        every = range(frames)
        depth, truth, mask = (results.read(a, every, view) for a in ("depth/depth", "truth/depth", "frames/mask"))
        errors = [depth_error(d, t, m, context.rig, view, context.views.sources) for d, t, m in zip(depth, truth, mask, strict=True)]
        found += [e for e in errors if e is not None]
    return {"EPE": float(np.mean([e.epe for e in found])), "1 px": float(np.mean([e.one_pixel for e in found]))}


def main() -> None:
    """Film the person, run every kind of depth, publish the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--frames", type=int, default=2)
    parser.add_argument("--held-out", type=int, default=8)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        film(root / "capture", arguments.size, arguments.frames, arguments.held_out)
        rows = [measure(root / "archive", root / "capture", method, arguments.held_out) for method in ("sgbm", "hull", "truth")]
    publish("quality", rows, vars(arguments))


if __name__ == "__main__":
    main()
