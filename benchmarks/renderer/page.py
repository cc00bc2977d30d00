"""The page that plays a sequence: its size, its pictures a second without a GPU, and how far they are our renderer's.

    python -m benchmarks.renderer.page demo-output/archive demo --config dags/simulation/demo.yaml [--picture page.png]

The archive must be computed up to the Gaussians. Pictures are compared over the person (pixels in which either of the
two shows anything) along the path `--path`, at the size its cameras have and from half and twice as far, with what our
renderer draws of the same Gaussians unquantised; "rendered" compares with the pipeline's finished pictures, retouched
by the masks, where it has them. Pictures a second are those that a page of 1280 x 860 px draws in ten seconds of
playing, by Chromium's software renderer: a GPU is not needed, and not measured. Rows of other sequences are kept.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from benchmarks.report import kept, publish
from posegaussian.dags.export.background import parse
from posegaussian.dags.export.page import export_page
from posegaussian.dags.planning.results import Results
from posegaussian.dags.session.session import Session
from posegaussian.stages.rendering.sources import REFINEMENT
from tests.support.browser import Browser, sized
from tests.support.drawn import camera_of, decoded_picture, drawn, person_psnr

WINDOW = (1280, 860)
DISTANCES = (1.0, 0.5, 2.0)
"""Shares of the path's distance from the person."""
SECONDS = 10.0
"""Of playing."""
PATIENCE = 900.0
"""Seconds in which a page has played through, on a machine that has other work, too."""


def agreement(browser: Browser, results: Results, every: int) -> Iterator[tuple[float, float]]:
    """(dB against our renderer, dB against the finished picture or NaN) of steps of the path and distances."""
    path, refined = next(iter(results.context.paths.values())), REFINEMENT in results.context.facts
    sized(browser, *(int(n) for n in path.size[0]))
    for step in range(0, browser.run("posegaussian.head.steps"), every):
        for distance in DISTANCES:
            browser.run(f"posegaussian.choose(0), posegaussian.seek({step})")
            if distance != 1:
                browser.run(f"posegaussian.move(dollied(posegaussian.camera, posegaussian.target, {distance}))")
            picture = decoded_picture(browser)
            frame, finished = browser.run("posegaussian.frame"), float("nan")
            if distance == 1 and results.has(f"rendering/{path.name}/color"):
                width, height = path.size[0]
                stored = results.read(f"rendering/{path.name}/color", range(frame, frame + 1))[0]
                finished = person_psnr(picture, stored[0, :height, :width])
            yield person_psnr(picture, drawn(results, frame, camera_of(browser), refined)), finished


def row(results: Results, name: str, folder: Path, path: str, every: int, picture: Path | None) -> dict[str, Any]:
    """One line of the table."""
    export_page(results, (), folder / "page.html", path, parse("#000000"))
    size = (folder / "page.html").stat().st_size
    with Browser(*WINDOW) as browser:
        start = time.perf_counter()
        browser.open(folder / "page.html")
        browser.wait("document.getElementById('message').hidden")
        loaded = time.perf_counter() - start
        browser.run("posegaussian.play(true)")
        browser.wait("posegaussian.step === posegaussian.head.steps - 1", PATIENCE)  # every frame is decoded
        before, start = browser.run("posegaussian.drawn"), time.perf_counter()
        time.sleep(SECONDS)
        rate = (browser.run("posegaussian.drawn") - before) / (time.perf_counter() - start)
        if picture is not None:
            show(browser, picture)
        browser.run("posegaussian.play(false), posegaussian.paint('#000000')")
        pairs = np.array(list(agreement(browser, results, every)))
        counts = browser.run(
            "(async () => { const out = []; for (let f = 0; f < posegaussian.head.frames.length; f++)"
            " { posegaussian.seek(f); await posegaussian.settled(); out.push(posegaussian.count); } return out; })()"
        )
        assert not browser.complaints, browser.complaints
    return {
        "sequence": name,
        "frames": len(counts),
        "Gaussians": round(float(np.mean(counts))),
        "MB": size / 1e6,
        "bytes a Gaussian": size / sum(counts),
        "s to load": loaded,
        "pictures a second": rate,
        "least dB": pairs[:, 0].min(),
        "mean dB": pairs[:, 0].mean(),
        "rendered dB": float(np.nanmean(pairs[:, 1])) if np.isfinite(pairs[:, 1]).any() else float("nan"),
    }


def show(browser: Browser, picture: Path) -> None:
    """Write the page as it is seen, with information and the picture of a source camera."""
    browser.run("posegaussian.play(false), posegaussian.paint('#101418'), posegaussian.seek(3)")
    browser.run("document.getElementById('info-button').click()")
    browser.run("document.getElementById('pip').selectedIndex = 1, posegaussian.look()")
    browser.run("posegaussian.settled()")
    browser.wait("document.getElementById('source-picture').naturalWidth > 0")
    picture.write_bytes(browser.screenshot())
    browser.run("document.getElementById('info-button').click()")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("archive")
    parser.add_argument("sequence")
    parser.add_argument("--config", type=Path)
    parser.add_argument("--set", action="append", default=[], help="settings, as the run had them")
    parser.add_argument("--path", default="orbit")
    parser.add_argument("--every", type=int, default=6, help="steps of the path from one compared picture to the next")
    parser.add_argument("--picture", type=Path, help="write the page as it is seen to this PNG")
    given = parser.parse_args()
    session = Session.open(given.config, given.set, given.archive, Console(quiet=True))
    results = Results(session.context(given.sequence, (given.path,)))
    size = "x".join(str(n) for n in results.context.rig.size[results.context.views.sources[0]])
    name = f"{given.sequence} {size}"
    with tempfile.TemporaryDirectory() as folder:
        rows = [
            *(r for r in kept("page") if r["sequence"] != name),
            row(results, name, Path(folder), given.path, given.every, given.picture),
        ]
    publish("page", rows, {"window": WINDOW, "every": given.every, "distances": DISTANCES, "seconds": SECONDS})


if __name__ == "__main__":
    main()
