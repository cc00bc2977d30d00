"""The network on a real capture: the same novel views with and without it, how sure it is, and how far it moves the
depth.

    python -m benchmarks.network.real [--weights fast] [--frame 10] [--archive FOLDER]

`balance` of POSEGAUSSIAN_CAPTURES from plain video, as in docs/measurements/quality.md, one frame at 960 px;
BlazePose must have been fetched. The novel views stand a quarter and half of the way along the arc from cam01 to
cam02, 48 degrees. There is no truth. Measured is how much the network says, and that the analytic depth stands where
it is not sure: confidence and change of depth are means over each source view's surface. And, for the analytic depth
and for the network's, how far the views of every usable pair contradict each other (`benchmarks.network.agreement`);
the second picture shows where the network makes that better or worse.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rich.console import Console

from benchmarks.network.agreement import Shown, table
from benchmarks.network.picture import difference, glowing, nearer
from benchmarks.pose.real import CROPS, without_keypoints
from benchmarks.quality.cells import UNREFINED
from benchmarks.quality.picture import around, tile
from benchmarks.report import publish, show
from posegaussian.dags.config.settings import load_configuration
from posegaussian.dags.importing.register import find_capture, register
from posegaussian.dags.planning.results import Results
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.runtime.events import Event, TaskFailed
from posegaussian.dags.runtime.executors.serial import SerialBackend
from posegaussian.dags.runtime.scheduler import Run
from posegaussian.dags.runtime.threads import limit
from posegaussian.dags.session.session import Session
from posegaussian.stages.camera_paths.paths import make_path
from posegaussian.stages.contract.io import Views
from posegaussian.stages.geometry.pairs import pair_report
from posegaussian.stages.network.asset import card_of
from posegaussian.stages.network.card import shipped
from posegaussian.stages.network.params import NetworkParams, depth_array
from posegaussian.stages.rendering.sources import OF_GAUSSIANS
from posegaussian.storage.archive.store import Archive
from posegaussian.storage.model.cameras import Rig
from posegaussian.storage.model.masks import foreground

NAME = "balance"
STEPS = {"quarter": 1, "half": 2}
"""Of four along the arc."""
UNSURE = 0.1
"""Confidence below which the analytic depth should stand."""
HEIGHT = 480
"""Of a picture, px."""


def run(balance: Path, archive: Path, settings: list[str], views: Path) -> Results:
    """The capture's results under some settings; what they do not touch stays fresh."""
    session = Session(
        load_configuration(None, ["frames.size=960", *UNREFINED, *CROPS, *settings], folder=archive.parent),
        str(archive),
        Console(quiet=True),
    )
    own = session.configuration.for_sequence(NAME)
    capture = find_capture("pose2sim", without_keypoints(balance, archive.parent / "plain"), [], own)
    register(Archive.open(str(archive), create=True), NAME, capture, own)
    if not views.exists():
        views.write_text(json.dumps(between(session.context(NAME, ()).rig)))

    def note(event: Event) -> None:
        if isinstance(event, TaskFailed):
            raise RuntimeError(f"{event.error}\n{event.details}")

    plan = session.plan(NAME, Selection(), (str(views),))
    Run([plan], Selection(), SerialBackend(), [note]).go()
    return Results(plan.context)


def between(rig: Rig) -> dict[str, Any]:
    """Cameras on the arc from cam01 to cam02, as a path file holds them."""
    arc = make_path("arc cam01 cam02", rig, Views(rig.names, tuple(range(len(rig))), ()), np.arange(5))
    cameras = [
        {
            "name": name,
            "width": int(arc.size[0][0]),
            "height": int(arc.size[0][1]),
            "K": arc.intrinsics[s, 0].tolist(),
            "R": arc.world_to_camera[s, 0, :3, :3].tolist(),
            "t": arc.world_to_camera[s, 0, :3, 3].tolist(),
        }
        for name, s in STEPS.items()
    ]
    return {"pixel_center": "half", "cameras": cameras}


def rendered(results: Results) -> dict[str, np.ndarray]:
    """Pictures [h, w, 3] of the first frame by camera."""
    (path,) = results.context.paths.values()
    color = results.read(f"rendering/{path.name}/color", range(1))[0]
    return {name: color[c] for c, name in enumerate(path.names)}


def said(results: Results) -> list[dict[str, Any]]:
    """One row a source view, and one for all."""
    rows, parts = [], []
    for view in results.context.views.sources:
        depth, moved, share = (
            results.read(a, range(1), view)[0].astype(np.float64)
            for a in ("depth/depth", "network/depth", "network/confidence")
        )
        on = depth > 0
        parts.append(np.stack([share[on], 1000 * np.abs(moved - depth)[on]]))
        rows.append(_row(results.context.rig.names[view], parts[-1]))
    return [*rows, _row("all", np.concatenate(parts, axis=1))]


def _row(name: str, values: np.ndarray) -> dict[str, Any]:
    share, apart = values
    unsure = share < UNSURE
    where = float(apart[unsure].max()) if unsure.any() else 0.0
    return {
        "view": name,
        "confidence": float(share.mean()),
        f"below {UNSURE:g}": float(unsure.mean()),
        "change mm": float(apart.mean()),
        "change mm, 95 %": float(np.quantile(apart, 0.95)),
        "most where unsure, mm": where,
    }


def maps(results: Results) -> dict[int, tuple[np.ndarray, ...]]:
    """Of the first frame by source view: depth [h, w] m, and what else its Gaussians are lifted from."""
    return {
        v: tuple(results.read(a, range(1), v)[0] for a in (depth_array(results.context.facts), *OF_GAUSSIANS))
        for v in results.context.views.sources
    }


def draw_pairs(shown: Shown, differences: dict[tuple[int, int], dict[str, np.ndarray]], file: Path) -> None:
    """Write a PNG: the first view of each directed pair, dark, and over it where the network shows the other view's
    colour there better (green) or worse (red)."""
    tiles = []
    for (a, b), apart in differences.items():
        picture = np.where(foreground(shown.mask[a][..., None]), shown.color[a], 0)
        rows, columns = (np.nonzero(foreground(shown.mask[a].max(axis=n)))[0] for n in (1, 0))
        cut = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
        compared = np.isfinite(apart["floor"])
        marked = nearer(*(np.where(compared, apart[kind], 0) for kind in ("floor", "network")))
        names = f"{shown.rig.names[a]} in {shown.rig.names[b]}"
        tiles += [
            tile(picture[cut], names, HEIGHT),
            tile(np.maximum(marked, picture // 4)[cut], "better / worse", HEIGHT),
        ]
    cv2.imwrite(str(file), np.hstack(tiles)[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])


def draw(floor: dict[str, np.ndarray], network: dict[str, np.ndarray], file: Path) -> None:
    """Write a PNG: a camera after the other: without, with the network, and what differs."""
    tiles = []
    for name, picture in floor.items():
        span = around(picture)
        tiles += [
            tile(picture[:, span], f"{name} of the way, analytic", HEIGHT),
            tile(network[name][:, span], "with the network", HEIGHT),
        ]
        tiles.append(tile(glowing(difference(network[name], picture))[:, span], "difference", HEIGHT))
    cv2.imwrite(str(file), np.hstack(tiles)[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--weights", default="fast", help="a name that ships, or a file")
    parser.add_argument("--frame", type=int, default=10)
    parser.add_argument("--archive", type=Path, help="kept and used again; default: made anew")
    parser.add_argument("--picture", type=Path, default=Path("docs/measurements/network_balance.png"))
    parser.add_argument(
        "--pairs", type=Path, default=Path("docs/measurements/network_pairs.png"), help="the second picture"
    )
    parser.add_argument(
        "--floor-only", action="store_true", help="make what does not need weights, into the archive, and end"
    )
    parser.add_argument(
        "--set", action="append", default=[], help="a setting of the pipeline, as for `posegaussian run`"
    )
    a = parser.parse_args()
    limit(1)
    weights = a.weights if a.weights in shipped() else str(Path(a.weights).resolve())
    balance = Path(os.environ.get("POSEGAUSSIAN_CAPTURES", "../shared")).resolve() / "captures" / "balance"
    with tempfile.TemporaryDirectory() as scratch:
        archive = (a.archive or Path(scratch) / "archive").resolve()
        archive.parent.mkdir(parents=True, exist_ok=True)
        views, settings = archive.parent / "arc.json", [f"frames.range={a.frame}:{a.frame + 1}", *a.set]
        before = run(balance, archive, [*settings, "network.weights=none"], views)
        floor, analytic = rendered(before), maps(before)
        if a.floor_only:
            return
        results = run(balance, archive, [*settings, f"network.weights={weights}"], views)
        card = card_of(NetworkParams(weights=weights))
        sources, learned = results.context.views.sources, maps(results)
        color, mask = ({v: results.read(f"frames/{n}", range(1), v)[0] for v in sources} for n in ("color", "mask"))
        shown = Shown(results.context.rig, color, mask)
        pairs = [p for r in pair_report(shown.rig, sources) if r.usable for p in (r.views, r.views[::-1])]
        kinds = {"floor": analytic, "network": learned}
        rows, differences = table(
            shown, pairs, {k: {v: m[0] for v, m in found.items()} for k, found in kinds.items()}, kinds
        )
        publish(
            None if a.set else "network_real",
            said(results),
            {"weights": card.name, "data": card.data, "frame": a.frame, "size": 960, "pairs": rows},
        )
        show(rows)
        draw(floor, rendered(results), a.picture)
        draw_pairs(shown, differences, a.pairs)


if __name__ == "__main__":
    main()
