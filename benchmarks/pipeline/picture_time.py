"""What a picture takes in the rendering stage: CPU seconds of simulated people, two held-out pictures a frame,
everything as it is set by default, so that a refined frame is drawn twice.

    python -m benchmarks.pipeline.picture_time [--seeds 1 2 3] [--cameras 8] [--size 512] [--frames 3] [--repeats 5]
        [--set KEY=VALUE]

The stage is run again and again on one thread, reading and writing included; the first time counts nothing, the median
of the others does. Two versions of the code are compared by running them in turns, on a machine that does nothing else.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.quality.cells import Cell, film_cell
from benchmarks.report import publish
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.runtime.threads import limit
from posegaussian.dags.simulation.simulated_run import run_capture

AGAIN = Selection(only=frozenset({"rendering"}), force=frozenset({"rendering"}))


def row(cell: Cell, repeats: int, settings: tuple[str, ...]) -> dict[str, Any]:
    """One person."""
    with tempfile.TemporaryDirectory() as name:
        motion, held_out = film_cell(cell, Path(name))
        results, _ = run_capture(Path(name), (held_out, *settings))
        again = [run_capture(Path(name), (held_out, *settings), AGAIN)[1]["rendering"] for _ in range(repeats + 1)]
    pictures = sum(int(path.served.sum()) for path in results.context.paths.values())
    return {
        "seed": cell.seed,
        "motion": motion,
        "cameras": cell.cameras,
        "size": cell.size,
        "pictures": pictures,
        "ms a picture": 1000 * float(np.median(again[1:])) / pictures,
        "least ms": 1000 * min(again[1:]) / pictures,
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a table, and keep it."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--cameras", type=int, default=8)
    parser.add_argument("--size", type=int, default=512, help="px")
    parser.add_argument("--frames", type=int, default=3)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--set", nargs="*", default=[], metavar="KEY=VALUE")
    given = parser.parse_args(arguments)
    limit(1)
    publish(
        "picture_time",
        [
            row(Cell(s, given.cameras, size=given.size, frames=given.frames), given.repeats, tuple(given.set))
            for s in given.seeds
        ],
        {k: v for k, v in vars(given).items() if k != "set"} | {"set": " ".join(given.set)},
    )


if __name__ == "__main__":
    main()
