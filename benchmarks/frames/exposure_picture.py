"""The capture `desk` before and after its cameras were matched: docs/measurements/exposure.png.

    python -m benchmarks.frames.exposure_picture [--frame 20]

Reads the capture of POSEGAUSSIAN_CAPTURES; BlazePose need not be there. Upper row: as filmed. Lower row: frames/color
with effects.exposure_matching as it decides. Pictures: caliscope's session post_optimization (BSD-2), reduced.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from pathlib import Path

import cv2
import numpy as np
from rich.console import Console

from posegaussian.dags.config.settings import load_configuration
from posegaussian.dags.importing.register import find_capture, register
from posegaussian.dags.planning.results import Results
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.session.session import Session
from posegaussian.storage.archive.store import Archive
from posegaussian.storage.readers import images
from posegaussian.storage.readers.sources import open_source

WIDTH = 320
"""Px of each picture."""


def matched(desk: Path, archive: Path, frame: int) -> Results:
    """The capture's frames around one."""
    wanted = [
        "frames.size=640",
        f'frames.range="{frame}:{frame + 1}"',
        "frames.matte=none",
        "detection.estimator=none",
        "run.scheduler=serial",
    ]
    session = Session(load_configuration(None, wanted, folder=archive.parent), str(archive), Console())
    settings = session.configuration.for_sequence("desk")
    register(Archive.open(str(archive), create=True), "desk", find_capture("caliscope", desk, [], settings), settings)
    selection = Selection(only=frozenset({"survey", "frames"}))
    plans, failed = session.usable(["desk"], (), selection)
    if failed or session.run_and_report(plans, selection, []):
        raise SystemExit("a task failed; see above")
    return Results(session.context("desk", ()))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frame", type=int, default=20)
    parser.add_argument("--output", type=Path, default=Path("docs/measurements/exposure.png"))
    a = parser.parse_args()
    desk = Path(os.environ.get("POSEGAUSSIAN_CAPTURES", "../shared")) / "captures" / "desk"
    with tempfile.TemporaryDirectory() as name:
        results = matched(desk, Path(name) / "archive", a.frame)
        reader = open_source(results.context.capture, "pictures")
        rows: tuple[list[np.ndarray], list[np.ndarray]] = ([], [])
        for v in range(len(results.context.rig)):
            (filmed,) = reader.read(v, [a.frame])
            for row, picture in zip(rows, (filmed, results.read("frames/color", range(1), v)[0]), strict=True):
                row.append(
                    cv2.resize(
                        picture, (WIDTH, WIDTH * picture.shape[0] // picture.shape[1]), interpolation=cv2.INTER_AREA
                    )
                )
    images.write_png(a.output, np.vstack([np.hstack(row) for row in rows]))
    print(a.output)


if __name__ == "__main__":
    main()
