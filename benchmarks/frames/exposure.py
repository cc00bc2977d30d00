"""What cameras that disagree cost, and what matching them brings back: simulated people filmed with the mismatch
measured on `desk`.

    python -m benchmarks.frames.exposure [--seeds 9000-9003]

Eight cameras on a ring; the light of each is multiplied by one of the four gains that surface points of the capture
`desk` showed (its brightest camera is 1.2 stops above the middle one, white balances differ by up to 0.8). Two cameras
in between are held out, and as bright as the middle one. Box PSNR and SSIM of their pictures.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.quality.cells import FLOOR, Cell, film_cell, pictures
from benchmarks.quality.views import means, seeds
from benchmarks.report import publish, show
from posegaussian.dags.simulation.simulated_run import run_capture
from posegaussian.stages.imaging.color import to_linear, to_srgb
from posegaussian.storage.readers import images

STOPS = np.array([[0.12, -0.07, -0.39], [-0.12, 0.06, 0.40], [-0.43, -0.60, -0.75], [1.40, 1.12, 1.00]])
"""By how much each camera of `desk` is brighter than the middle one, red, green, blue."""
MEASURES = ("full psnr", "box psnr", "full ssim", "box ssim")
REPORTED = (9000, 9001, 9002, 9003)


def spoil(capture: Path) -> None:
    """Give each source camera's pictures (cam00, cam01, ...) its gains, as a sensor would: on light, then clipped."""
    for folder in sorted(p for p in (capture / "images").iterdir() if p.name.startswith("cam")):
        gain = np.exp2(STOPS[int(folder.name[3:]) % len(STOPS)])
        for file in sorted(folder.iterdir()):
            light = to_linear(images.read_picture(file).astype(np.float64)) * gain
            images.write_png(file, np.rint(to_srgb(np.clip(light, 0.0, 1.0))).astype(np.uint8))


def rows_of(seed: int) -> list[dict[str, Any]]:
    """Clean cameras, and spoilt ones with the effect off, as it decides, and forced."""
    cell, rows = Cell(seed, 8, frames=2), []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _, held_out = film_cell(cell, folder)
        for cameras in ("alike", "as on desk"):
            if cameras != "alike":
                spoil(folder / "capture")
                shutil.rmtree(folder / "archive")  # the survey keeps what it saw of a sequence
            for state in ("auto",) if cameras == "alike" else ("off", "auto"):
                results, _ = run_capture(folder, (held_out, *FLOOR, f"effects.exposure_matching={state}"))
                found = results.context.effects["exposure_matching"].decision
                on = "on" if found is not None and found.on else "off"
                print(f"seed {seed}, {cameras}, {state}: {found.reason if found is not None else ''}", flush=True)
                measured = {k: v for k, v in pictures(results, cell).items() if k in MEASURES}
                rows.append(
                    {
                        "seed": seed,
                        "cameras": cameras,
                        "exposure_matching": f"{state}: {on}" if state == "auto" else state,
                        **measured,
                    }
                )
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=seeds, default=REPORTED)
    a = parser.parse_args()
    rows = [r for seed in a.seeds for r in rows_of(seed)]
    show(rows)
    publish(
        "exposure" if a.seeds == REPORTED else None,
        means(rows, "cameras", "exposure_matching"),
        {"seeds": list(a.seeds), "scenes": rows},
    )


if __name__ == "__main__":
    main()
