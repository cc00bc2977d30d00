"""Quality of finished pictures against held-out truth, all measured at one size: that of a reference.

A small picture compared with small truth hides what a large one would show. So every level's pictures are enlarged to
the reference's size (bicubic; depth to the nearest pixel) and compared there; at the reference's own size this is the
metrics stage's measure, bit by bit.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator

import numpy as np

from posegaussian.dags.planning.context import Context
from posegaussian.dags.planning.results import Results
from posegaussian.stages.metrics.measures.registry import METRICS
from posegaussian.stages.network.params import depth_array
from posegaussian.storage.model.cameras import CameraPath


def held_out_path(context: Context) -> CameraPath:
    """The context's path of held-out cameras."""
    return next(p for p in context.paths.values() if p.kind == "held_out")


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


def box_psnr(context: Context, reference: Context) -> float | None:
    """The mean of `psnr box` alone, dB; None where no picture holds anybody. Contexts as of `quality`."""
    found = [v for frames in _partitions(context) for _, v in _pictures(context, reference, frames, ["psnr"], "box")]
    return float(np.mean(found)) if found else None


def compared(
    context: Context, reference: Context, frames: range
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """(picture, filmed, mask) of every held-out picture of some frames, [h, w, 3], [h, w, 3] and [h, w] uint8, at the
    reference's size. Contexts as of `quality`."""
    results, truths = Results(context), Results(reference)
    path, large = held_out_path(context), held_out_path(reference)
    rendered = results.read(f"rendering/{path.name}/color", frames)
    for c, name in enumerate(path.names):
        view = reference.rig.index(name)
        truth, mask = truths.read("frames/color", frames, view), truths.read("frames/mask", frames, view)
        (w, h), (wide, high) = path.size[c], large.size[c]
        for j, frame in enumerate(frames):
            if path.served[frame, c] and reference.valid[frame, view]:
                picture = _enlarged(rendered[j, c, :h, :w], int(wide), int(high), smooth=True)
                yield picture, truth[j, :high, :wide], mask[j, :high, :wide]


def _partitions(context: Context) -> Iterator[range]:
    return map(context.grid.bounds, context.grid.partitions)


def _pictures(
    context: Context, reference: Context, frames: range, measures: list[str], only: str | None = None
) -> Iterator[tuple[str, float]]:
    """(measure and region, value) of every held-out picture, of one region alone where it is named."""
    from posegaussian.stages.metrics.run import measure

    wanted = context.settings.metrics.model_copy(update={"measures": measures})
    for picture, truth, mask in compared(context, reference, frames):
        for (region, name), value in measure(picture, truth, mask, wanted).items():
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
