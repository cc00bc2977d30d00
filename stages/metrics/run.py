"""Kernel of the metrics stage: rendered held-out views against their pictures."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from posegaussian.stages.contract.facts import Facts
from posegaussian.stages.contract.io import Block
from posegaussian.stages.contract.judged import PERSON_MATTE, PLATE_MATTE
from posegaussian.stages.contract.path_inputs import PathInputs
from posegaussian.stages.metrics.measures.declaration import Metric, Pictures, Unavailable, Value
from posegaussian.stages.metrics.measures.registry import METRICS
from posegaussian.stages.metrics.params import MetricsParams
from posegaussian.stages.silhouettes.hidden import Witnesses
from posegaussian.storage.model.cameras import Rig
from posegaussian.storage.model.masks import FOREGROUND, foreground

COLUMNS = ("camera", "frame", "region", "measure", "value", "background", "definition")
BOX = f"; box = bounding box of the view's own mask > {FOREGROUND}"
MASK = (
    f"; mask = pixels of the view's own mask > {FOREGROUND}: maps are averaged over them, what has no map is measured"
    " of their bounding box, black beyond them"
)
LEFT_OUT = "; pixels in which the subject stands behind something left out"
DATA_RANGE = 255.0
UNAVAILABLE = "not available: "
"""How the definition of a row without a value begins."""
Values = dict[tuple[str, str], Value]
"""{(region, measure): value}."""


def run(inputs: PathInputs, params: MetricsParams) -> Iterator[Block]:
    """Yield one table: the measures asked for of every held-out camera and frame, regions full, box and mask.

    Both pictures are premultiplied on black: the truth is its picture times its own soft mask, so that the background
    is the same in both and carries no error. A box or mask value of a map is the mean of the full picture's map
    over it; a change is that from the previous frame of the sequence. Frames that a camera does not serve, that have no
    picture or whose mask holds nobody give no rows, nor does a change from or to one: black equals black, whatever is
    drawn of a person. A note tells how many hold nobody. A measure that something is missing for has rows without a
    value, whose definition says what. Pixels in which the subject stands behind something, as the source views say, do
    not count (`posegaussian.stages.silhouettes.hidden`); the rows' definition and a note tell.
    """
    path, span = inputs.path_over("rendering/{path}/color"), inputs.span("rendering/{path}/color")
    halo = inputs.partition.start - span.start
    rendered = inputs.read("rendering/{path}/color")
    table: dict[str, list[Any]] = {name: [] for name in COLUMNS}
    sources = {v: inputs.read("frames/mask", v) for v in inputs.views.sources}
    notes, witnesses = [], witnesses_of(inputs.rig, sources, len(span))
    for c, view in enumerate(inputs.views.held_out):
        truth, mask = inputs.read("frames/color", view), inputs.read("frames/mask", view)
        width, height = (int(n) for n in path.size[c])
        before: Values = {}
        shares: list[float] = []
        empty = 0
        for j, frame in enumerate(span):
            crop = (j, slice(0, height), slice(0, width))
            usable = bool(path.served[j, c]) and (j < halo or bool(inputs.valid[j - halo, view]))
            # whether a frame of the halo had a picture is not known here; a mask of nobody says that it had none
            shown = foreground(mask[crop]).any()
            now, visible = Values(), None
            if usable and shown:
                wanted = params if j >= halo else params.before  # a frame of the halo is compared with alone
                visible, share = visible_pixels(witnesses[j], view, mask[j], crop[1:])
                shares += [share] if j >= halo else []
                now = measure(rendered[:, c][crop], truth[crop], mask[crop], wanted, visible)
            if j >= halo:
                empty += usable and not shown
                _append(table, path.names[c], frame, now, before, params, visible is not None)
            before = now
        if empty:
            notes.append(
                f"{path.names[c]}: nobody is in {empty} of {len(span) - halo} frames by its mask; they are not measured"
            )
        if any(shares):
            notes.append(f"{path.names[c]}: {_told(shares, len(span) - halo, inputs.facts)}")
    yield Block("metrics/{path}", table, notes=tuple(notes))


def _told(shares: list[float], frames: int, facts: Facts) -> str:
    """What is left out of a camera's measures: the shares of the subject, by frame. Of a mask that came with the
    capture it is what something hides; a matte made here may as well lack it by mistake."""
    where = f"in {np.count_nonzero(shares)} of {frames} frames, up to {max(shares):.0%} of it"
    if facts & {PERSON_MATTE, PLATE_MATTE}:
        return (
            f"its matte lacks something of the subject {where}, as the source views see it: it stands behind something"
            " there, or the matte is wrong; what is lacking is left out of the measures"
        )
    return f"the subject stands behind something {where}; what is hidden there is left out of the measures"


class Region(NamedTuple):
    """A part of a picture that is measured."""

    rows: slice
    columns: slice
    inside: np.ndarray | None = None
    """[h, w] bool of the full picture: its pixels, where they are not all of the rows and columns."""

    def counted(self, visible: np.ndarray | None) -> np.ndarray | slice:
        """Pixels of the rows and columns that count: all, or [rows, columns] bool; `visible` [h, w] bool."""
        masks = [m[self.rows, self.columns] for m in (self.inside, visible) if m is not None]
        return np.logical_and.reduce(masks) if masks else slice(None)

    def of(self, pictures: Pictures) -> Pictures:
        """The part alone, black beyond its pixels."""
        cut = pictures.region((self.rows, self.columns))
        if self.inside is None:
            return cut
        counted = np.asarray(self.counted(pictures.visible))
        return Pictures(cut.picture * counted[..., None], cut.truth * counted[..., None], cut.data_range, counted)


def witnesses_of(rig: Rig, masks: Mapping[int, np.ndarray], frames: int) -> list[Witnesses]:
    """What the source views know of the subject, frame by frame, of their masks [F, h, w] uint8 by view."""
    return [Witnesses(rig, {v: m[j] for v, m in masks.items()}) for j in range(frames)]


def visible_pixels(
    witnesses: Witnesses, view: int, mask: np.ndarray, crop: tuple[slice, slice]
) -> tuple[np.ndarray | None, float]:
    """[h, w] bool, pixels of the crop of a picture that count, and the share of the subject that is hidden; None and 0
    where nothing is. `mask`: [H, W] uint8 of the whole array."""
    hidden = witnesses.hidden(view, mask)[crop]
    return (~hidden, float(hidden.sum() / (hidden | foreground(mask[crop])).sum())) if hidden.any() else (None, 0.0)


def measure(
    rendered: np.ndarray, truth: np.ndarray, mask: np.ndarray, params: MetricsParams, visible: np.ndarray | None = None
) -> Values:
    """{(region, measure): value} of one picture; a change, which takes two, is there as what changes.

    rendered [h, w, 3] uint8 premultiplied on black; truth [h, w, 3] uint8 as filmed; mask [h, w] uint8 0..255;
    visible: [h, w] bool, pixels that count, all by default: PSNR is of them alone, maps are black beyond them in both
    and their mean is taken over them, a region that is measured as a whole is black there in both.
    """
    picture = rendered.astype(np.float64)
    reference = truth.astype(np.float64) * (mask[..., None].astype(np.float64) / 255)
    if visible is not None:
        picture, reference = picture * visible[..., None], reference * visible[..., None]
    regions = {"full": Region(slice(None), slice(None))}
    inside = foreground(mask)
    rows, columns = (np.nonzero(inside.any(axis=a))[0] for a in (1, 0))
    if rows.size:
        box = slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)
        regions |= {"box": Region(*box), "mask": Region(*box, inside)}
    pictures = Pictures(picture, reference, DATA_RANGE, visible)
    values: Values = {}
    for metric in dict.fromkeys(METRICS[METRICS[m].change_of or m] for m in params.measures):
        values |= {(region, metric.name): v for region, v in _by_region(metric, pictures, regions, params).items()}
    return values


def _by_region(
    metric: Metric, pictures: Pictures, regions: Mapping[str, Region], params: MetricsParams
) -> dict[str, Value]:
    """{region: value} of one metric."""
    if metric.of_pixels is not None:
        seen = metric.of_pixels(pictures, params)
        return {
            name: float(seen[r.rows, r.columns][r.counted(pictures.visible)].astype(np.float64, copy=False).mean())
            for name, r in regions.items()
        }
    assert metric.of_region is not None, f"metric {metric.name} measures nothing"
    return {name: metric.of_region(r.of(pictures), params) for name, r in regions.items()}


def _append(
    table: dict[str, list[Any]],
    camera: str,
    frame: int,
    now: Values,
    before: Values,
    params: MetricsParams,
    partly: bool,
) -> None:
    """Add the rows of one picture; `partly`: something was left out."""
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
            region_of = {"box": BOX, "mask": MASK}.get(region, "") + (LEFT_OUT if partly else "")
            number, definition = float(value), METRICS[name].definition(params) + region_of
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
