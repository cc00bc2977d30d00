"""The renderer against the frozen plain torch one, in one run: a person, random blobs, a captured guitar.

    python -m benchmarks.renderer.cpu_speed [--repeats 15] [--only person512]

A run of every scene is kept in benchmarks/results; the next one is compared with it by ratio.

Times are processor time on one thread, the least of the repeats, those of the two renderers taken in turn; with 2
threads, and for "fps" (one frame on each of two cores), they are the clock's, the machine's other work included. A pair
is a pixel in which a Gaussian has at least alpha_min: "tested" all of them, "blended" those before the pixel's stop.
The floor is the time the blended pairs would take if all eight lanes of every vector held one and nothing but their
arithmetic were done, measured in the same run.
"""

from __future__ import annotations

import argparse
import time
import tracemalloc
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import numpy as np
import torch

from benchmarks.renderer import plain_torch
from benchmarks.renderer.workloads import GUITAR, blobs, guitar, person
from benchmarks.report import kept, publish, show
from posegaussian.stages.compiling.compiled import compiled
from posegaussian.stages.splatting.cpu import backend
from posegaussian.stages.splatting.cpu.projection import ACROSS, BOX_X, BOX_Y, DOWN, LIFT, RECORD, SLOPE, U, V
from posegaussian.stages.splatting.cpu.simd import choose, exp2_minus, fma, least, minus_magnitude, splat, store
from posegaussian.stages.splatting.cpu.tiles import TILE_X, TILE_Y
from posegaussian.stages.splatting.definition.scene import Camera, Cutoffs, Drawing, Gaussians
from posegaussian.stages.splatting.rasterizer import rasterize

SCENES: dict[str, tuple[Callable[[int], tuple[Gaussians, Camera]], int]] = {
    "person512": (person, 512),
    "person1024": (person, 1024),
    "blobs512": (blobs, 512),
    "guitar512": (guitar, 512),
}
ATTRIBUTES = tuple(Gaussians.__dataclass_fields__)


@compiled(error_model="numpy")
def pairs(records: Any, bits: Any, order: Any, starts: Any, cuts: Any, across: int) -> tuple[int, int]:
    """Blended and tested pairs, counted pixel by pixel."""
    total = tested = 0
    light = np.empty((TILE_Y, TILE_X), np.float32)
    for tile in range(len(starts) - 1):
        left, top = tile % across * TILE_X, tile // across * TILE_Y
        light[:] = 1.0
        for j in range(starts[tile], starts[tile + 1]):
            r = np.int64(order[j]) * RECORD
            x, y = bits[r + BOX_X], bits[r + BOX_Y]
            for row in range(max((y & 0xFFFF) - top, 0), min((y >> 16) - top, TILE_Y - 1) + 1):
                for column in range(max((x & 0xFFFF) - left, 0), min((x >> 16) - left, TILE_X - 1) + 1):
                    dy = row + top + 0.5 - records[r + V]
                    p, t = (
                        dy * records[r + DOWN],
                        (column + left + 0.5 - records[r + U] - records[r + SLOPE] * dy) * records[r + ACROSS],
                    )
                    e = t * t + p * p + records[r + LIFT]
                    if e > cuts[2]:
                        continue
                    tested += 1
                    if light[row, column] < 0:
                        continue
                    behind = light[row, column] * (1 - min(2.0**-e, cuts[0]))
                    light[row, column] = behind if behind > cuts[1] else -1.0
                    total += behind > cuts[1]
    return total, tested


@compiled(error_model="numpy")
def arithmetic(count: int, out: Any) -> None:
    """The arithmetic of one block of eight pairs, `count` times over, four blocks side by side, all in registers."""
    e0, e1, e2, e3 = splat(0.1), splat(0.2), splat(0.3), splat(0.4)
    one, cap, dark, zero, drop = splat(1.0), splat(0.99), splat(1e-4), splat(0.0), splat(0.001)
    t0 = t1 = t2 = t3 = one
    a0 = a1 = a2 = a3 = zero
    for _ in range(count):
        t0, a0 = _blend(e0, t0, a0, cap, dark, zero, drop)
        t1, a1 = _blend(e1, t1, a1, cap, dark, zero, drop)
        t2, a2 = _blend(e2, t2, a2, cap, dark, zero, drop)
        t3, a3 = _blend(e3, t3, a3, cap, dark, zero, drop)
    store(out, 0, t0 + t1 + t2 + t3 + a0 + a1 + a2 + a3)


@compiled(error_model="numpy")
def _blend(x: Any, before: Any, a: Any, cap: Any, dark: Any, zero: Any, drop: Any) -> Any:
    t, p = fma(x, cap, fma(a, drop, x)), fma(x, cap, a)
    e = fma(t, t, fma(p, p, x))
    weight = choose(e <= cap, least(exp2_minus(e), cap) * before, zero) * drop
    behind = before - weight
    seen = behind > dark
    weight = choose(seen, weight, zero)
    return choose(seen, behind, minus_magnitude(before)), fma(weight, cap, fma(weight, drop, fma(weight, x, a))) * drop


def floor_of_pair() -> float:
    """Seconds a pair."""
    out, n = np.zeros(8, np.float32), 200_000
    arithmetic(1, out)
    return least_of(lambda: arithmetic(n, out), 7) / (n * 4 * 8)


def least_of(work: Callable[[], Any], repeats: int) -> float:
    """Seconds of the quickest of some calls."""
    return min(timed(work) for _ in range(repeats))


def timed(work: Callable[[], Any], clock: Callable[[], float] = time.process_time) -> float:
    start = clock()
    work()
    return clock() - start


class Scene:
    """One workload, ready to be drawn either way."""

    def __init__(self, name: str) -> None:
        make, size = SCENES[name]
        self.gaussians, self.camera = make(size)
        self.leaves = Gaussians(*(getattr(self.gaussians, a).clone().requires_grad_() for a in ATTRIBUTES))
        rng = np.random.default_rng(0)
        self.up = [torch.from_numpy(rng.normal(size=s).astype(np.float32)) for s in ((size, size, 3), (size, size))]

    def ours(self, threads: int = 1) -> None:
        with torch.no_grad():
            rasterize(self.gaussians, [self.camera], (), Drawing(threads=threads))

    def theirs(self) -> None:
        with torch.no_grad():
            plain_torch.rasterize(self.gaussians, self.camera)

    def ours_both(self, threads: int = 1) -> list[torch.Tensor]:
        out = rasterize(self.leaves, [self.camera], (), Drawing(threads=threads))
        return self._gradients(out.color[0], out.alpha[0])

    def theirs_both(self) -> list[torch.Tensor]:
        return self._gradients(*plain_torch.rasterize(self.leaves, self.camera))

    def _gradients(self, color: torch.Tensor, alpha: torch.Tensor) -> list[torch.Tensor]:
        return list(torch.autograd.grad([color, alpha], [getattr(self.leaves, a) for a in ATTRIBUTES], self.up))

    def phases(self, repeats: int) -> tuple[dict[str, float], tuple[int, int]]:
        """Least milliseconds of each phase on one thread, and the (blended, tested) pairs."""
        arrays, task = (
            [backend.flat(getattr(self.gaussians, a)) for a in backend.ATTRIBUTES],
            backend.job(self.camera, Cutoffs(), 3, 1),
        )
        up = [u.numpy() for u in self.up]
        best: dict[str, float] = {}
        kept: dict[str, Any] = {}

        def lap(name: str, work: Callable[[], Any]) -> None:
            start = time.process_time()
            kept[name] = work()
            best[name] = min(best.get(name, np.inf), 1e3 * (time.process_time() - start))

        for _ in range(repeats):
            lap("project", lambda: backend.project(arrays, task, backend.scratch))
            records, reaches = kept["project"][:2]
            lap("bin", partial(backend.list_tiles, records, reaches, task, True))
            bases, starts, entries, owners = kept["bin"]
            lap("sort", partial(backend.sort_tiles, starts, entries, owners, task, backend.scratch))
            order, slots = kept["sort"]
            lists = backend.CpuTileLists(records, bases, starts, order, slots, 0)
            lap("composite", partial(backend.draw, lists, task, False))
            lap("composite, training", partial(backend.draw, lists, task, True))
            lap("composite back", partial(backend.draw_backward, lists, task, kept["composite, training"][2:], *up))
            lap("project back", partial(backend.prepare_backward, arrays, lists, task, kept["composite back"]))
        return best, pairs(
            lists.records, lists.records.view(np.int32), lists.order, lists.starts, task.cuts, task.across
        )


def memory(work: Callable[[], Any]) -> float:
    """Peak of numpy's and Python's allocations during a call, MiB."""
    tracemalloc.start()
    work()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak / 2**20


def frames_per_second(scene: Scene, frames: int = 10) -> float:
    """With one frame on each of two cores: kernels let go of the interpreter."""
    with ThreadPoolExecutor(2) as pool:
        return 2 * frames / timed(lambda: list(pool.map(scene.ours, [1] * (2 * frames))), time.perf_counter)


def measure(name: str, repeats: int, floor: float) -> dict[str, Any]:
    """One row."""
    scene = Scene(name)
    scene.ours()
    scene.ours_both()
    times: dict[str, list[float]] = {k: [] for k in ("ours", "theirs", "ours_both", "theirs_both", "two", "two_both")}
    for i in range(repeats):
        for k in ("ours", "ours_both"):
            times[k].append(timed(getattr(scene, k)))
        times["two"].append(timed(lambda: scene.ours(2), time.perf_counter))
        times["two_both"].append(timed(lambda: scene.ours_both(2), time.perf_counter))
        if i % 3 == 0:
            for k in ("theirs", "theirs_both"):
                times[k].append(timed(getattr(scene, k)))
    best = {k: 1e3 * min(v) for k, v in times.items()}
    phases, (blended, tested) = scene.phases(repeats)
    error = max(float((a - b).norm() / b.norm()) for a, b in zip(scene.ours_both(), scene.theirs_both(), strict=True))
    return {
        "scene": name,
        "Gaussians": len(scene.gaussians),
        "f ms": best["ours"],
        "f x torch": best["theirs"] / best["ours"],
        "f+b ms": best["ours_both"],
        "f+b x torch": best["theirs_both"] / best["ours_both"],
        "f 2 threads": best["two"],
        "f+b 2 threads": best["two_both"],
        "torch f ms": best["theirs"],
        "torch f+b ms": best["theirs_both"],
        "M blended": blended / 1e6,
        "M blended/s": blended / phases["composite"] / 1e3,
        "M tested/s": tested / phases["composite"] / 1e3,
        "x floor": phases["composite"] / (1e3 * blended * floor),
        "fps 2 cores": frames_per_second(scene),
        "f MiB": memory(scene.ours),
        "f+b MiB": memory(scene.ours_both),
        "gradient error 1e-6": 1e6 * error,
        **{f"{k} ms": v for k, v in phases.items()},
    }


def against_last(rows: list[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """The ratios to plain torch beside those kept from the last release: above 1, today's is faster."""
    last = {r["scene"]: r for r in kept("renderer")}
    for row in rows:
        for ratio in ("f x torch", "f+b x torch"):
            before = last.get(row["scene"], {}).get(ratio, float("nan"))
            yield {
                "scene": row["scene"],
                "ratio": ratio,
                "now": row[ratio],
                "last release": before,
                "now / last": row[ratio] / before,
            }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=15)
    parser.add_argument("--only", choices=SCENES, nargs="*", default=list(SCENES))
    options = parser.parse_args()
    torch.set_num_threads(1)
    floor = floor_of_pair()
    names = [n for n in options.only if n != "guitar512" or GUITAR.is_file()]
    rows = [measure(n, options.repeats, floor) for n in names]
    show([{k: v for k, v in r.items() if not k.endswith((" ms", "MiB"))} for r in rows])
    show([{k: v for k, v in r.items() if k == "scene" or k.endswith((" ms", "MiB"))} for r in rows])
    show(list(against_last(rows)))
    if names == list(SCENES):
        publish("renderer", rows, {"repeats": options.repeats, "floor ns a pair": 1e9 * floor}, shown=False)


if __name__ == "__main__":
    main()
