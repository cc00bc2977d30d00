"""Where the seconds of a frame go: CPU seconds of every stage, one thread a task, of a simulated person filmed by eight
cameras on a ring, with two held-out pictures a frame.

    python -m benchmarks.pipeline.frame_time [--sizes 512 1024] [--frames 6] [--cameras 8] [--seed 1] [--repeats 1]
        [--set depth.method=sweep ...]

Each size is run once before, on two frames that are thrown away, so that nothing is compiled while seconds are counted.
`seconds` are those of a frame: survey and judge look at a few frames of a sequence, whatever its length, and weigh less
the longer it is. `a view` divides by the source views. `MB` is what the stage leaves in the archive, a frame.
Repeats are runs from the start; the median counts.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.quality.cells import Cell, film_cell
from benchmarks.report import publish
from posegaussian.dags.runtime.threads import limit
from posegaussian.dags.simulation.simulated_run import ARCHIVE, run_capture
from posegaussian.stages.registry import STAGES


def rows(cell: Cell, repeats: int, settings: tuple[str, ...]) -> Iterator[dict[str, Any]]:
    """A row a stage that ran, in the order of the stages, and one of all."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _, held_out = film_cell(cell, folder)
        run_capture(folder, (held_out, "frames.range=0:2", *settings))
        found = []
        for _ in range(repeats):
            shutil.rmtree(folder / ARCHIVE)
            found.append(run_capture(folder, (held_out, *settings))[1])
        frames, views = cell.scene.frames, cell.scene.rig.cameras
        assert isinstance(views, int), "a rig that is no list of cameras"
        whole = float(np.median([sum(seconds.values()) for seconds in found]))
        for stage in (s.name for s in STAGES if s.name in found[0]):
            taken = float(np.median([seconds[stage] for seconds in found]))
            yield _row(cell, stage, taken / frames, views, taken / whole, _bytes(folder / ARCHIVE, stage) / frames)
        yield _row(cell, "all", whole / frames, views, 1.0, _bytes(folder / ARCHIVE, "") / frames)


def _row(cell: Cell, stage: str, seconds: float, views: int, share: float, written: float) -> dict[str, Any]:
    return {
        "size": cell.size,
        "stage": stage,
        "seconds": seconds,
        "a view": seconds / views,
        "share": share,
        "MB": written / 1e6,
    }


def _bytes(archive: Path, stage: str) -> int:
    """What lies in the archive of a stage, or of all."""
    return sum(f.stat().st_size for f in archive.glob(f"*/{stage or '*'}/**/*") if f.is_file())


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a table, and keep it."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--sizes", type=int, nargs="+", default=[512, 1024], help="px")
    parser.add_argument("--frames", type=int, default=6)
    parser.add_argument("--cameras", type=int, default=8)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--repeats", type=int, default=1)
    parser.add_argument("--set", nargs="*", default=[], metavar="KEY=VALUE")
    given = parser.parse_args(arguments)
    limit(1)
    cells = [Cell(given.seed, given.cameras, size=size, frames=given.frames) for size in given.sizes]
    publish(
        "frame_time",
        [row for cell in cells for row in rows(cell, given.repeats, tuple(given.set))],
        {k: v for k, v in vars(given).items() if k != "set"} | {"set": " ".join(given.set)},
    )


if __name__ == "__main__":
    main()
