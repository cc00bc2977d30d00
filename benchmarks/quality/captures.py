"""Pictures of real captures, scored on photographs that were kept aside.

    python -m benchmarks.quality.captures [bust bust10 balance desk] [--set depth.method=sweep] [--sheet sheet.png]

The captures of POSEGAUSSIAN_CAPTURES; BlazePose must have been fetched for `balance` and `desk`, which are run from
plain video, once for every camera that is left out, one frame of `balance` and the last of five of `desk`.

    bust      seven photographs of a marble head with masks, six held out
    bust10    the same with the three more whose calibration is wrong
    balance   four cameras, 48 and 68 degrees apart; one left out at a time, the other three are sources
    desk      four webcams on automatic exposure; likewise

Each picture's light is fitted to the photograph's by one gain a channel inside its mask, because cameras on automatic
exposure differ; then PSNR and SSIM in the bounding box of the mask, both on black. The masks of `desk` are outlines by
hand, of the man and of the board that he holds; those of `balance` are the run's own, so that changes of mattes cannot
be compared by it.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rich.console import Console

from benchmarks.frames.outlined import outlines
from benchmarks.pose.real import without_keypoints
from benchmarks.quality.light import fitted
from benchmarks.quality.picture import tile
from benchmarks.report import publish
from posegaussian.dags.config.settings import load_configuration
from posegaussian.dags.importing.register import find_capture, register
from posegaussian.dags.planning.results import Results
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.runtime.executors.inline_run import run_here
from posegaussian.dags.session.session import Session
from posegaussian.stages.metrics.measures.ssim import ssim_map
from posegaussian.storage.archive.store import Archive
from posegaussian.storage.model.masks import foreground

NAME = "captured"
HELD_OUT = ["p087", "p085", "p083", "p090", "p092", "p094"]
GOOD = ["p088", "p086", "p084", "p089", "p091", "p093", "p095"]
WRONG = ["p098", "p099", "p100"]
HEIGHT = 384
"""Of a picture on the sheet, px."""


@dataclass(frozen=True)
class Case:
    """One import and one run of a capture."""

    name: str
    folder: str
    layout: str
    held_out: tuple[str, ...]
    settings: tuple[str, ...]


def _left_out(name: str, layout: str, cameras: tuple[str, ...], *settings: str) -> list[Case]:
    return [Case(name, name, layout, (camera,), settings) for camera in cameras]


def _bust(name: str, sources: list[str]) -> list[Case]:
    return [Case(name, "bust", "images", tuple(HELD_OUT), (f"views.sources={json.dumps(sources)}",))]


CASES: dict[str, list[Case]] = {
    "bust": _bust("bust", GOOD),
    "bust10": _bust("bust10", [*GOOD, *WRONG]),
    "balance": _left_out(
        "balance", "pose2sim", ("cam01", "cam02", "cam03", "cam04"), "frames.range=10:11", "frames.size=640"
    ),
    "desk": _left_out(
        "desk", "caliscope", ("cam_0", "cam_1", "cam_2", "cam_3"), "frames.range=12:22:2", "frames.size=640"
    ),
}


def run_case(case: Case, captures: Path, archive: Path, settings: list[str]) -> Results:
    """The results of one case; what is fresh in the archive stays."""
    wanted = [f"views.held_out={json.dumps(list(case.held_out))}", *case.settings, *settings]
    session = Session(load_configuration(None, wanted, folder=archive.parent), str(archive), Console(quiet=True))
    own = session.configuration.for_sequence(NAME)
    source = captures / case.folder
    if case.layout == "pose2sim":
        source = without_keypoints(source, archive.parent / "plain")
    register(Archive.open(str(archive), create=True), NAME, find_capture(case.layout, source, [], own), own)
    plan = session.plan(NAME, Selection(), ("held_out",))
    run_here(plan, Selection())
    return Results(plan.context)


def scored(case: Case, results: Results) -> list[dict[str, Any]]:
    """One row a held-out photograph of the last frame."""
    context = results.context
    last = range(len(context.source_frames) - 1, len(context.source_frames))
    (path,) = context.paths.values()
    rendered = results.read(f"rendering/{path.name}/color", last)[0]
    outlined = outlines(context, case.name)
    rows = []
    for c, name in enumerate(path.names):
        view = context.rig.index(name)
        width, height = (int(n) for n in context.rig.size[view])
        color, mask = (results.read(f"frames/{a}", last, view)[0][:height, :width] for a in ("color", "mask"))
        mask = outlined.get((last.start, view), mask)
        rows.append({"capture": case.name, "camera": name, **score(rendered[c][:height, :width], color, mask)})
    return rows


def score(rendered: np.ndarray, filmed: np.ndarray, mask: np.ndarray) -> dict[str, Any]:
    """Box PSNR in dB and SSIM of a picture [h, w, 3] uint8 on black, the gains that were fitted, and both pictures."""
    truth, inside = filmed * (mask[..., None] / 255.0), foreground(mask)
    picture, gains = fitted(rendered, filmed, mask)
    rows, columns = np.nonzero(inside)
    box = slice(rows.min(), rows.max() + 1), slice(columns.min(), columns.max() + 1)
    error = float(np.mean((truth[box] - picture[box]) ** 2))
    return {
        "psnr": 10 * np.log10(255**2 / error),
        "ssim": float(ssim_map(picture[box], truth[box], 255.0).mean()),
        "gains": " ".join(f"{g:.2f}" for g in gains),
        "shown": np.hstack([truth[box], picture[box]]).astype(np.uint8),
    }


def means(rows: list[dict[str, Any]]) -> list[Mapping[str, Any]]:
    """One row a capture: the mean over its photographs."""
    out: list[Mapping[str, Any]] = []
    for name in dict.fromkeys(r["capture"] for r in rows):
        own = [r for r in rows if r["capture"] == name]
        out.append(
            {"capture": name, "camera": "mean"} | {k: float(np.mean([r[k] for r in own])) for k in ("psnr", "ssim")}
        )
    return out


def draw(rows: list[dict[str, Any]], file: Path) -> None:
    """Write a PNG: photograph and picture of every row, four rows a line."""
    tiles = [tile(r["shown"], f"{r['capture']} {r['camera']} {r['psnr']:.2f} {r['ssim']:.3f}", HEIGHT) for r in rows]
    lines = [np.hstack(tiles[i : i + 4]) for i in range(0, len(tiles), 4)]
    width = max(line.shape[1] for line in lines)
    sheet = np.vstack([np.pad(line, ((0, 0), (0, width - line.shape[1]), (0, 0))) for line in lines])
    cv2.imwrite(str(file), sheet[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("captures", nargs="*", default=list(CASES), choices=list(CASES))
    parser.add_argument("--set", action="append", default=[], help="a setting, as for `posegaussian run`")
    parser.add_argument("--archives", type=Path, help="a folder where archives are kept and used again")
    parser.add_argument("--sheet", type=Path, help="a PNG of every photograph beside its picture")
    parser.add_argument("--publish", metavar="NAME", help="keep the table in benchmarks/results/NAME.json")
    a = parser.parse_args()
    captures = Path(os.environ.get("POSEGAUSSIAN_CAPTURES", "../shared")).resolve() / "captures"
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as scratch:
        for name in a.captures:
            for case in CASES[name]:
                archive = (a.archives or Path(scratch)).resolve() / f"{name}_{len(case.held_out)}_{case.held_out[0]}"
                archive.parent.mkdir(parents=True, exist_ok=True)
                rows += scored(case, run_case(case, captures, archive, a.set))
                print(
                    *(f"{r['camera']} {r['psnr']:.2f} {r['ssim']:.3f}" for r in rows[-len(case.held_out) :]), flush=True
                )
    if a.sheet:
        draw(rows, a.sheet)
    table = [{k: v for k, v in r.items() if k not in ("shown", "gains")} for r in rows]
    publish(a.publish, [*table, *means(rows)], {"settings": a.set})


if __name__ == "__main__":
    main()
