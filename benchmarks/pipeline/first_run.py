"""What a first run compiles: processor seconds of workers that draw their first picture, and its gradients, at the same
time, from an empty folder of compiled kernels; each on its own, as numba does it, and waiting for one another.

    python -m benchmarks.pipeline.first_run [--workers 2] [--ways alone together]

`compiled` counts kernels with their signatures, those they call included; `all` adds up the workers' processor seconds
of importing, compiling and drawing; `clock` is the time until the last is done. A worker of a warm folder is printed
beside them.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import tempfile
import time
from collections.abc import Sequence
from typing import Any

from benchmarks.report import publish


def draw(way: str) -> tuple[int, float]:
    """How many kernels this process compiles for a picture and its gradients, and its processor seconds."""
    from numba.core import event

    from benchmarks.renderer.workloads import blobs
    from posegaussian.dags.compiling.kernels import compile_once
    from posegaussian.stages.splatting.definition.scene import Gaussians
    from posegaussian.stages.splatting.rasterizer import rasterize

    if way == "together":
        compile_once()
    with event.install_recorder("numba:compile") as compiled:
        gaussians, camera = blobs(64)
        rasterize(gaussians, [camera])
        parts = [getattr(gaussians, n).clone().requires_grad_() for n in Gaussians.__dataclass_fields__]
        rasterize(Gaussians(*parts), [camera]).color.sum().backward()
    return sum(e.is_start for _, e in compiled.buffer), time.process_time()


def row(way: str, workers: int, folder: str) -> dict[str, Any]:
    """One way, with kernels kept in a folder."""
    os.environ["NUMBA_CACHE_DIR"] = folder
    start = time.perf_counter()
    with multiprocessing.get_context("spawn").Pool(workers) as pool:
        found = pool.map(draw, [way] * workers, chunksize=1)
    compiled, seconds = zip(*found, strict=True)
    return {
        "way": way,
        "workers": workers,
        "compiled": sum(compiled),
        "all s": sum(seconds),
        "clock s": time.perf_counter() - start,
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a table, and keep it."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--ways", nargs="+", default=["alone", "together"], choices=["alone", "together"])
    given = parser.parse_args(arguments)
    rows = []
    for way in given.ways:
        with tempfile.TemporaryDirectory() as folder:
            rows.append(row(way, given.workers, folder))
            warm = {**row(way, 1, folder), "way": "warm"}
    publish("first_run", [*rows, warm], vars(given))


if __name__ == "__main__":
    main()
