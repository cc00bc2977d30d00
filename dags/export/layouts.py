"""From a finished sequence to a capture in another tool's layout: undistorted pictures, masks, cameras, and where the
layout has one a cloud of the Gaussians of the first instant."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from posegaussian.dags.export import splats
from posegaussian.dags.humanize.text import number
from posegaussian.dags.planning.context import Context
from posegaussian.dags.planning.results import Results
from posegaussian.dags.planning.tasks import Product
from posegaussian.storage.exporters.layouts.declaration import (
    Recording,
    check_folder,
    check_undistorted,
    write_pictures,
)
from posegaussian.storage.exporters.layouts.registry import LAYOUTS
from posegaussian.storage.model.errors import ConfigError
from posegaussian.storage.model.splats import SH0

MOST_POINTS = 100_000
"""Points of a cloud, evenly taken: what an optimiser starts from needs no more."""


class Cloud(NamedTuple):
    """Points of the Gaussians of one instant."""

    points: np.ndarray
    """[N, 3] float64, metres."""
    colors: np.ndarray
    """[N, 3] uint8 sRGB."""
    merged: str
    """What the budget did to it, empty without one."""


NO_CLOUD = Cloud(np.zeros((0, 3)), np.zeros((0, 3), np.uint8), "")


def check_layout(name: str) -> None:
    """Raise ConfigError for a layout that is not known."""
    if name not in LAYOUTS:
        raise ConfigError(f"export --to {name}: unknown layout; known are {', '.join(LAYOUTS)}")


def chosen_frames(context: Context, frame: int | None) -> list[int]:
    """Indices of the frames of an export: of one source frame number, or all. Raises ConfigError for another."""
    numbers = [int(n) for n in context.source_frames]
    if frame is None:
        return list(range(len(numbers)))
    if frame not in numbers:
        raise ConfigError(
            f"export --frame {frame}: sequence {context.sequence.name} has source frames {numbers[0]} to {numbers[-1]}"
            f" ({len(numbers)} of them)"
        )
    return [numbers.index(frame)]


def needed(context: Context, name: str, frame: int | None) -> frozenset[Product]:
    """What an export reads: it must be there when the run is over, whatever `keep` says."""
    frames, length = chosen_frames(context, frame), context.grid.length
    partitions = sorted({f // length for f in frames})
    filmed = {
        Product(a, p, v) for a in ("frames/color", "frames/mask") for p in partitions for v in context.active_views
    }
    lifted = splats.needed(context, context.views.sources) if LAYOUTS[name].cloud else frozenset()
    return frozenset(filmed | {p for p in lifted if p.partition == frames[0] // length})


def check(context: Context, name: str, folder: Path, frame: int | None) -> None:
    """Raise UserError for cameras that the layout cannot hold, and where the folder holds pictures of something
    else."""
    rig = context.rig.subset(context.active_views)
    LAYOUTS[name].check(rig)
    check_folder(
        folder,
        rig,
        [int(context.source_frames[f]) for f in chosen_frames(context, frame)],
    )


def export_layout(
    results: Results, name: str, folder: Path, frame: int | None, budget: float | None = None
) -> list[str]:
    """Write a sequence, or one instant of it, in a layout, its cloud within a budget of Gaussians; returns sentences.
    Raises UserError and NotWritten."""
    context = results.context
    frames = chosen_frames(context, frame)
    check(context, name, folder, frame)
    cloud = _cloud(results, frames[0], budget) if LAYOUTS[name].cloud else NO_CLOUD
    recording = _recording(results, frames, cloud)
    check_undistorted(recording)
    LAYOUTS[name].write(folder, recording)
    count = write_pictures(folder, recording.rig, _pictures(results, frames))
    written = (
        f"{name}: {number(count, 'picture')} with masks of {number(len(recording.rig), 'camera')} in {folder}, at"
        f" {_sizes(recording)} px (frames.size), without distortion"
    )
    if LAYOUTS[name].cloud:
        first, merged = int(context.source_frames[frames[0]]), cloud.merged and f", {cloud.merged}"
        written += f"; {number(len(cloud.points), 'point')} of frame {first}{merged}"
    still = len(frames) > 1 and LAYOUTS[name].still
    return [
        written,
        *(["optimisers of still scenes want one instant: --frame NUMBER writes it alone"] if still else []),
    ]


def _recording(results: Results, frames: list[int], cloud: Cloud) -> Recording:
    """What is written."""
    context = results.context
    views = context.active_views
    has = _filmed(context, frames)
    return Recording(
        context.rig.subset(views),
        float(context.capture.frame_rate),
        tuple(tuple(int(context.source_frames[f]) for f in frames if (f, v) in has) for v in views),
        True,
        tuple(context.rig.names[v] for v in views if v in context.asked_views.held_out),
        cloud.points,
        cloud.colors,
    )


def _filmed(context: Context, frames: list[int]) -> set[tuple[int, int]]:
    """(frame, view) that have a picture."""
    known = {v: set(context.capture.pictures[v].numbers) for v in context.active_views}
    return {(f, v) for f in frames for v in known if int(context.source_frames[f]) in known[v]}


def _pictures(results: Results, frames: list[int]) -> Iterator[tuple[int, int, np.ndarray, np.ndarray | None]]:
    context = results.context
    has = _filmed(context, frames)
    for at, view in enumerate(context.active_views):
        width, height = (int(n) for n in context.rig.size[view])
        for f in frames:
            if (f, view) in has:
                color, mask = (
                    results.read(a, range(f, f + 1), view)[0][:height, :width] for a in ("frames/color", "frames/mask")
                )
                yield at, int(context.source_frames[f]), color, mask


def _cloud(results: Results, frame: int, budget: float | None) -> Cloud:
    """Points of the Gaussians of one frame within a budget, every k-th."""
    found, lifted = splats.frame_splats(results, frame, results.context.views.sources, budget)
    merged = ""
    if budget is not None:
        all_there = splats.NONE_MERGED.format(budget)
        merged = (
            all_there if len(found) == lifted else f"merged from {number(lifted, 'Gaussian')} (--budget {budget:.10g})"
        )
    kept = slice(None, None, max(1, -(-len(found) // MOST_POINTS)))
    color = np.rint(255 * np.clip(0.5 + SH0 * found.harmonics[kept, 0], 0, 1)).astype(np.uint8)
    return Cloud(found.mean[kept].astype(np.float64), color, merged)


def _sizes(recording: Recording) -> str:
    sizes = sorted({(int(w), int(h)) for w, h in recording.rig.size})
    return ", ".join(f"{w}x{h}" for w, h in sizes)
