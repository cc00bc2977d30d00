"""Quality of finished pictures against held-out truth, all measured at one size: that of a reference.

A small picture compared with small truth hides what a large one would show. So every level's pictures are enlarged to
the reference's size (bicubic; depth to the nearest pixel) and compared there; at the reference's own size this is the
metrics stage's measure, bit by bit.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from posegaussian.dags.planning.context import Context
from posegaussian.dags.planning.plan import Plan
from posegaussian.dags.planning.results import Results
from posegaussian.stages.metrics.measures.registry import METRICS
from posegaussian.stages.network.params import depth_array
from posegaussian.storage.model.cameras import CameraPath
from posegaussian.storage.model.errors import UserError
from posegaussian.storage.model.masks import foreground


class Compared(NamedTuple):
    """One held-out picture and what it is compared with, at the reference's size."""

    picture: np.ndarray
    """[h, w, 3] uint8 as drawn, on black."""
    filmed: np.ndarray
    """[h, w, 3] uint8."""
    mask: np.ndarray
    """[h, w] uint8."""
    visible: np.ndarray | None
    """[h, w] bool: pixels that count, where the subject stands behind something in others; None where all do."""


def held_out_path(context: Context) -> CameraPath:
    """The context's path of held-out cameras."""
    return next(p for p in context.paths.values() if p.kind == "held_out")


def require_subject(context: Context) -> None:
    """Raise UserError where no held-out picture shows anybody, so that nothing could be compared; the frames' masks are
    there."""
    results, path = Results(context), held_out_path(context)
    for frames in _partitions(context):
        for c, name in enumerate(path.names):
            if _shown(context, path, c, frames, results.read("frames/mask", frames, context.rig.index(name))).any():
                return
    first, last = context.source_frames[[0, -1]].tolist()
    raise UserError(
        f"no held-out camera has a picture of the subject in frames {first}..{last} of {context.sequence.name}; choose"
        " others with frames.range, or hold out other cameras by views.held_out"
    )


def quality(context: Context, reference: Context) -> dict[str, float]:
    """{name: value} of `posegaussian.dags.tradeoff.pareto.QUALITIES`, as means over pictures.

    Both contexts have the same sequence, frames, views and partitions and finished outputs. `epe` is there where the
    reference has true depth of its source views; definitions as in stages/metrics.
    """
    found: dict[str, list[float]] = defaultdict(list)
    traded = [m.name for m in METRICS.values() if m.traded]
    for frames in _partitions(context):
        for name, value in (*_pictures(context, reference, frames, traded), *_depths(context, reference, frames)):
            found[name].append(value)
    return {name: float(np.mean(values)) for name, values in found.items()}


def box_psnr(context: Context, reference: Context) -> float:
    """The mean of `psnr box` alone, dB. Contexts as of `quality`, of which some picture shows somebody."""
    found = [v for frames in _partitions(context) for _, v in _pictures(context, reference, frames, ["psnr"], "box")]
    return float(np.mean(found))


def as_measured(plans: Iterable[Plan]) -> list[float]:
    """Box PSNR, dB, of every held-out picture of plans that the metrics stage has measured, at the size it is drawn
    in."""
    return [
        row["value"]
        for plan in plans
        for row in Results(plan.context, plan.book).rows(
            o
            for t in plan.verdicts
            if t.stage == "metrics" and t in plan.book.receipts
            for o in plan.book.receipts[t].outputs
        )
        if (row["measure"], row["region"]) == ("psnr", "box") and row["value"] is not None
    ]


def compared(context: Context, reference: Context, frames: range) -> Iterator[Compared]:
    """Every held-out picture of some frames that shows somebody: in others there is nothing of a person to measure.
    Contexts as of `quality`."""
    from posegaussian.stages.metrics.run import visible_pixels, witnesses_of

    results, truths = Results(context), Results(reference)
    path, large = held_out_path(context), held_out_path(reference)
    rendered = results.read(f"rendering/{path.name}/color", frames)
    sources = {v: truths.read("frames/mask", frames, v) for v in reference.views.sources}
    witnesses = witnesses_of(reference.rig, sources, len(frames))
    for c, name in enumerate(path.names):
        view = reference.rig.index(name)
        truth, mask = truths.read("frames/color", frames, view), truths.read("frames/mask", frames, view)
        (w, h), (wide, high) = path.size[c], large.size[c]
        crop = slice(0, int(high)), slice(0, int(wide))
        for j in np.nonzero(_shown(reference, path, c, frames, mask))[0]:
            picture = _enlarged(rendered[j, c, :h, :w], int(wide), int(high), smooth=True)
            visible, _ = visible_pixels(witnesses[j], view, mask[j], crop)
            yield Compared(picture, truth[j][crop], mask[j][crop], visible)


def _shown(context: Context, path: CameraPath, camera: int, frames: range, mask: np.ndarray) -> np.ndarray:
    """[F] bool: whether a camera of the held-out path has a picture of somebody; mask [F, h, w] uint8 of its view."""
    own = slice(frames.start, frames.stop)
    there = path.served[own, camera] & context.valid[own, context.rig.index(path.names[camera])]
    return there & foreground(mask).any(axis=(1, 2))


def _partitions(context: Context) -> Iterator[range]:
    return map(context.grid.bounds, context.grid.partitions)


def _pictures(
    context: Context, reference: Context, frames: range, measures: list[str], only: str | None = None
) -> Iterator[tuple[str, float]]:
    """(measure and region, value) of every held-out picture, of one region alone where it is named."""
    from posegaussian.stages.metrics.run import measure

    wanted = context.settings.metrics.model_copy(update={"measures": measures})
    for p in compared(context, reference, frames):
        for (region, name), value in measure(p.picture, p.filmed, p.mask, wanted, p.visible).items():
            if isinstance(value, float) and only in (None, region):
                yield f"{name} {region}", value


def _depths(context: Context, reference: Context, frames: range) -> Iterator[tuple[str, float]]:
    from posegaussian.stages.metrics.depth_error import depth_error

    results, truths = Results(context), Results(reference)
    if not truths.has("truth/depth"):
        return
    sources = reference.views.sources
    for view in sources:
        truth, mask = truths.read("truth/depth", frames, view), truths.read("frames/mask", frames, view)
        depth = results.read(depth_array(context.facts), frames, view)
        (w, h), (wide, high) = context.rig.size[view], reference.rig.size[view]
        for j, frame in enumerate(frames):
            if reference.valid[frame, view]:
                large = _enlarged(depth[j, :h, :w], int(wide), int(high), smooth=False)
                error = depth_error(large, truth[j, :high, :wide], mask[j, :high, :wide], reference.rig, view, sources)
                if error is not None:
                    yield "epe", error.epe


def _enlarged(picture: np.ndarray, width: int, height: int, smooth: bool) -> np.ndarray:
    """[h, w, ...] -> [height, width, ...]; the same array where the size is the same."""
    if picture.shape[:2] == (height, width):
        return picture
    import cv2

    return np.asarray(
        cv2.resize(
            np.ascontiguousarray(picture),
            (width, height),
            interpolation=cv2.INTER_CUBIC if smooth else cv2.INTER_NEAREST_EXACT,
        )
    )
