"""What the offset sweep costs: milliseconds a source view at 512 px by phase, and nanoseconds a hypothesis beside a
plain torch version.

    python -m benchmarks.depth.sweep_time [--views 8] [--size 512] [--repeats 3]

The first rows are one frame of the analytic person, all passes (`sweep_hull`), on one thread; the last of them the same
with two frames at a time in two threads of one process, per source view. A hypothesis is one pixel within its bounds,
one offset, one neighbour; fused and plain version compute the same volume (`benchmarks/depth/plain_cost_volume.py`), in
the same run. The least of the repeats counts: other programs only add.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import cv2
import numpy as np
import torch

import posegaussian.stages.depth.algorithms.sweeping as sweeping
import posegaussian.stages.matching.sweep as sweep
from benchmarks.depth.plain_cost_volume import cost_volume as plain
from benchmarks.report import publish
from posegaussian.stages.depth.algorithms.scene import Frame, Geometry
from posegaussian.stages.depth.params import DepthParams
from posegaussian.stages.matching.cost import FORBIDDEN
from posegaussian.stages.simulator.subjects.capsule_person import capture_person

PHASES = (
    (sweeping, "hulls"),
    (sweep, "cost_volume"),
    (sweep, "aggregate"),
    (sweep, "minimum"),
    (sweeping, "in_rows"),
    (sweeping, "disagreement"),
    (sweeping, "fuse"),
    (sweeping, "complete"),
    (sweeping, "turn_away"),
)


def least(work: Callable[[], Any], repeats: int) -> float:
    """Seconds of the quickest of some runs, after one that compiles."""
    work()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return min(times)


def noted(calls: list[tuple[str, float, tuple[Any, ...], Any]]) -> Callable[[], None]:
    """Let every phase note (name, seconds, arguments, result) of each call; the function returned undoes it."""
    before = [(module, name, getattr(module, name)) for module, name in PHASES]

    def noting(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def timed(*arguments: Any) -> Any:
            start = time.perf_counter()
            result = function(*arguments)
            calls.append((name, time.perf_counter() - start, arguments, result))
            return result

        return timed

    for module, name, function in before:
        setattr(module, name, noting(name, function))

    def undo() -> None:
        for module, name, function in before:
            setattr(module, name, function)

    return undo


def hypotheses(arguments: tuple[Any, ...], volume: np.ndarray) -> int:
    """Pixels times offsets times neighbours of one call of `cost_volume`."""
    return int((volume != FORBIDDEN).sum()) * len(arguments[6])


def tensors(arguments: tuple[Any, ...]) -> tuple[Any, ...]:
    """The arguments of the fused version as the plain one takes them."""
    return tuple(
        torch.from_numpy(np.asarray(a, np.float32 if a.dtype != bool else bool)) if isinstance(a, np.ndarray) else a
        for a in arguments
    )


def main() -> None:
    """Time all passes of one frame, then one volume both ways, on one thread and on two."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--views", type=int, default=8)
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--repeats", type=int, default=3)
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    person = capture_person(views=arguments.views, size=arguments.size, frames=1, held_out=0)
    params = DepthParams(method="sweep")
    geometry = Geometry.of(person.rig, tuple(range(arguments.views)), params)
    frame = Frame(dict(enumerate(person.color[0])), dict(enumerate(person.mask[0])))

    def once(_: int = 0) -> None:
        sweeping.sweep_hull(geometry, frame, params)

    seconds = least(once, arguments.repeats)
    calls: list[tuple[str, float, tuple[Any, ...], Any]] = []
    undo = noted(calls)
    once()
    undo()
    with ThreadPoolExecutor(2) as pool:
        both = least(lambda: list(pool.map(once, range(2))), arguments.repeats)
    per_view = 1e3 / arguments.views
    rows: list[dict[str, Any]] = [
        {
            "what": f"  {name}",
            "threads": 1,
            "ms a source view": sum(c[1] for c in calls if c[0] == name) * per_view,
            "ns a hypothesis": "",
        }
        for _, name in PHASES
    ]
    rows.append({"what": "whole sweep", "threads": 1, "ms a source view": seconds * per_view, "ns a hypothesis": ""})
    rows.append(
        {
            "what": "whole sweep, two frames at a time",
            "threads": 2,
            "ms a source view": both * per_view / 2,
            "ns a hypothesis": "",
        }
    )
    rows += volumes(max((c for c in calls if c[0] == "cost_volume"), key=lambda c: c[1]), arguments.repeats)
    publish("sweep_time", rows, vars(arguments))


def _at_once(pool: ThreadPoolExecutor, count: int, given: tuple[Any, ...]) -> None:
    """So many cost volumes at a time."""
    list(pool.map(lambda _: sweep.cost_volume(*given), range(count)))


def volumes(call: tuple[str, float, tuple[Any, ...], Any], repeats: int) -> list[dict[str, Any]]:
    """Rows of the dearest volume of the frame: fused and plain, on one thread and two (two volumes at a time; torch
    inside an operation)."""
    given, volume = call[2], call[3]
    count, as_tensors, rows = hypotheses(given, volume), tensors(given), []
    before = torch.get_num_threads()
    with ThreadPoolExecutor(2) as pool, torch.no_grad():
        for threads in (1, 2):
            fused = least(partial(_at_once, pool, threads, given), repeats) / threads
            torch.set_num_threads(threads)
            slow = least(lambda: plain(*as_tensors), 1)
            rows.append(
                {
                    "what": "cost volume, fused",
                    "threads": threads,
                    "ms a source view": "",
                    "ns a hypothesis": 1e9 * fused / count,
                }
            )
            rows.append(
                {
                    "what": "cost volume, plain torch",
                    "threads": threads,
                    "ms a source view": "",
                    "ns a hypothesis": 1e9 * slow / count,
                }
            )
    torch.set_num_threads(before)
    return rows


if __name__ == "__main__":
    main()
