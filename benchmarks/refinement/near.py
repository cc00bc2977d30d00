"""What refinement gains by where the camera stands between two sources.

    python -m benchmarks.refinement.near [--seeds 1,2] [--cameras 8] [--size 384] [--set network.weights=none]

Simulated people before a level ring, one frame, with cameras kept aside at a source camera's place, and a tenth, two
tenths, ... half of the way to the next. Box PSNR in dB without refinement and with it.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.quality.cells import UNREFINED
from benchmarks.quality.held import HEIGHT, RADIUS, scene
from benchmarks.quality.views import seeds
from benchmarks.report import publish
from posegaussian.dags.planning.results import Results
from posegaussian.dags.simulation.simulated_run import film_capture, held_out_setting, run_capture
from posegaussian.stages.metrics.run import measure
from posegaussian.stages.simulator.scene import Scene

PLACES = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5)
"""Of the way from one source camera to the next."""


def ring(seed: int, cameras: int, size: int) -> Scene:
    """The scene; cameras that are kept aside stand in two gaps by turns, so that no two are in one place."""
    level = scene(seed, "ring", {}, size).model_dump()
    gap = 2 * np.pi / cameras
    at = [gap * (place + 2 * (i % 2)) for i, place in enumerate(PLACES)]
    held = [
        {**level["held_out"][0], "name": f"at{i}", "position": [RADIUS * np.cos(a), RADIUS * np.sin(a), HEIGHT]}
        for i, a in enumerate(at)
    ]
    return Scene.model_validate({**level, "rig": {**level["rig"], "cameras": cameras}, "held_out": held})


def measured(seed: int, cameras: int, size: int, settings: tuple[str, ...]) -> Iterator[dict[str, Any]]:
    """One row a place."""
    with tempfile.TemporaryDirectory() as folder:
        staged, _ = film_capture(ring(seed, cameras, size), Path(folder))
        held = held_out_setting(staged)
        without, refined = (
            _box_psnr(run_capture(Path(folder), (held, *settings, *more))[0]) for more in (UNREFINED, ())
        )
        for place, *found in zip(PLACES, without, refined, strict=True):
            yield {"seed": seed, "cameras": cameras, "place": place, "without": found[0], "refined": found[1]}


def _box_psnr(results: Results) -> list[float]:
    """Of every camera kept aside, dB."""
    (path,) = results.context.paths.values()
    rendered = results.read(f"rendering/{path.name}/color", range(1))[0]
    found = []
    for c, name in enumerate(path.names):
        view = results.context.rig.index(name)
        color, mask = (results.read(f"frames/{a}", range(1), view)[0] for a in ("color", "mask"))
        value = measure(rendered[c], color, mask, results.context.settings.metrics)["box", "psnr"]
        assert isinstance(value, float)
        found.append(value)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=seeds, default=(1, 2))
    parser.add_argument("--cameras", type=int, default=8)
    parser.add_argument("--size", type=int, default=384)
    parser.add_argument("--set", action="append", default=[], help="a setting, as for `posegaussian run`")
    a = parser.parse_args()
    publish(None, [r for s in a.seeds for r in measured(s, a.cameras, a.size, tuple(a.set))], {})


if __name__ == "__main__":
    main()
