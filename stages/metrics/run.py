"""Kernel of the metrics stage: rendered held-out views against their pictures."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from posegaussian.stages.contract.io import Block, Inputs
from posegaussian.stages.metrics.measures.declaration import Metric, Pictures, Unavailable, Value
from posegaussian.stages.metrics.measures.registry import METRICS
from posegaussian.stages.metrics.params import MetricsParams
from posegaussian.storage.model.masks import FOREGROUND, foreground

COLUMNS = ("camera", "frame", "region", "measure", "value", "background", "definition")
BOX = f"; box = bounding box of the view's own mask > {FOREGROUND}"
DATA_RANGE = 255.0
UNAVAILABLE = "not available: "
"""How the definition of a row without a value begins."""
Regions = Mapping[str, tuple[slice, slice]]
"""{name: rows and columns}."""
Values = dict[tuple[str, str], Value]
"""{(region, measure): value}."""


def run(inputs: Inputs, params: MetricsParams) -> Iterator[Block]:
    """Yield one table: the measures asked for of every held-out camera and frame, regions full and box.

    Both pictures are premultiplied on black: the truth is its picture times its own soft mask, so that the background
    is the same in both and carries no error. A box value of a map is the mean of the full picture's map over the box;
    a change is that from the previous frame of the sequence. Frames that a camera does not serve
    or that have no picture give no rows; an empty mask gives no box rows. A measure that something is missing for has
    rows without a value, whose definition says what.
    """
    path = inputs.path
    assert path is not None, "metrics run over a camera path"
    span = inputs.span("rendering/{path}/color")
    halo = inputs.partition.start - span.start
    rendered = inputs.read("rendering/{path}/color")
    table: dict[str, list[Any]] = {name: [] for name in COLUMNS}
    for c, view in enumerate(inputs.views.held_out):
        truth, mask = inputs.read("frames/color", view), inputs.read("frames/mask", view)
        width, height = (int(n) for n in path.size[c])
        before: Values = {}
        for j, frame in enumerate(span):
            crop = (j, slice(0, height), slice(0, width))
            usable = bool(path.served[j, c]) and (j < halo or bool(inputs.valid[j - halo, view]))
            now: Values = {}
            if usable:
                wanted = params if j >= halo else params.before  # a frame of the halo is compared with alone
                now = measure(rendered[:, c][crop], truth[crop], mask[crop], wanted)
            if j >= halo:
                _append(table, path.names[c], frame, now, before, params)
            # whether a frame of the halo had a picture is not known here; an empty mask says that it had none
            before = now if mask[crop].any() else {}
    yield Block("metrics/{path}", table)


def measure(rendered: np.ndarray, truth: np.ndarray, mask: np.ndarray, params: MetricsParams) -> Values:
    """{(region, measure): value} of one picture; a change, which takes two, is there as what changes.

    rendered [h, w, 3] uint8 premultiplied on black; truth [h, w, 3] uint8 as filmed; mask [h, w] uint8 0..255.
    """
    picture = rendered.astype(np.float64)
    reference = truth.astype(np.float64) * (mask[..., None].astype(np.float64) / 255)
    regions: Regions = {"full": (slice(None), slice(None))}
    rows, columns = (np.nonzero(foreground(mask).any(axis=a))[0] for a in (1, 0))
    if rows.size:
        regions = {
            **regions,
            "box": (slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)),
        }
    pictures = Pictures(picture, reference, DATA_RANGE)
    values: Values = {}
    for metric in dict.fromkeys(METRICS[METRICS[m].change_of or m] for m in params.measures):
        values |= {(region, metric.name): v for region, v in _by_region(metric, pictures, regions, params).items()}
    return values


def _by_region(metric: Metric, pictures: Pictures, regions: Regions, params: MetricsParams) -> dict[str, Value]:
    """{region: value} of one metric."""
    if metric.of_pixels is not None:
        seen = metric.of_pixels(pictures, params)
        return {name: float(seen[at].astype(np.float64, copy=False).mean()) for name, at in regions.items()}
    assert metric.of_region is not None, f"metric {metric.name} measures nothing"
    picture, truth, data_range = pictures
    return {
        name: metric.of_region(Pictures(picture[at], truth[at], data_range), params) for name, at in regions.items()
    }


def _append(
    table: dict[str, list[Any]], camera: str, frame: int, now: Values, before: Values, params: MetricsParams
) -> None:
    """Add the rows of one picture."""
    rows: Values = {}
    for metric in (METRICS[m] for m in params.measures):
        for region, name in [key for key in now if key[1] == (metric.change_of or metric.name)]:
            value, earlier = now[region, name], before.get((region, name))
            if metric.change_of is None:
                rows[region, metric.name] = value
            elif isinstance(value, float) and isinstance(earlier, float):
                rows[region, metric.name] = abs(value - earlier)
    for (region, name), value in sorted(rows.items(), key=lambda row: row[0]):
        if isinstance(value, Unavailable):
            number, definition = None, UNAVAILABLE + value.reason
        else:
            number, definition = float(value), METRICS[name].definition(params) + (BOX if region == "box" else "")
        for column, entry in zip(COLUMNS, (camera, int(frame), region, name, number, "black", definition), strict=True):
            table[column].append(entry)


def check(block: Block, params: MetricsParams) -> list[str]:
    """Warn of measures without a value, once for each reason; raise ValueError for a value that is not finite."""
    warnings: dict[str, None] = {}
    for camera, frame, name, value, definition in zip(
        *(block.data[k] for k in ("camera", "frame", "measure", "value", "definition")), strict=True
    ):
        if value is None:
            warnings[f"{name} is {definition}"] = None
        elif not np.isfinite(value):
            raise ValueError(
                f"{name} of camera {camera}, frame {frame} of the sequence (counted from 0) is {value}; every measure"
                " must be finite"
            )
    return list(warnings)
