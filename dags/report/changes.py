"""What effects and choices change, as pictures: before and after, of what the capture and the archive hold anyway.

A row is one picture of panels side by side, of the frame in the middle. Few source pictures are decoded and nothing is
computed anew, so an effect without a "before" on disk is named in words.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from posegaussian.dags.planning.results import Results
from posegaussian.stages.frames.exposures import SURFACE, compared, points_in
from posegaussian.stages.frames.facts import EXPOSURE_MATCHING, LIGHT_STEADYING, NOISE_AVERAGING, TONE_MAPPING
from posegaussian.stages.frames.params import resolve_matte
from posegaussian.stages.imaging.color import to_display
from posegaussian.stages.imaging.exposure import match
from posegaussian.stages.imaging.facts import CROP_SCALE, UNDISTORTION
from posegaussian.stages.imaging.pixel_effects import crop_displacement, lens_displacement
from posegaussian.stages.rendering.sources import COUNTS, REFINED
from posegaussian.stages.smoothing.facts import TEMPORAL_SMOOTHING
from posegaussian.storage.model.errors import UserError
from posegaussian.storage.model.masks import foreground
from posegaussian.storage.readers.sources import open_source

HEIGHT, GAP = 170, 4
"""Of a panel, and between two of them, px."""
CLOSE = 64
"""Side of a piece that is shown enlarged, px of `frames/*`."""
AROUND = 0.3
"""Share of the subject's extent that is shown around it where it is cut out."""
TIMES = 4
"""By which differences of pictures are multiplied."""
FAR = 0.05
"""Metres by which two depths differ where their difference is drawn white."""
DEPTHS = {
    "depth/depth": ("depth.method", "depth as matched"),
    "network/depth": ("network.weights", "after the network"),
    "gaussians/depth": (NOISE_AVERAGING, "averaged over time"),
    "refinement/depth": ("refinement.steps", "refined"),
}
"""Arrays of one depth in the order of flow: the effect or setting that makes each, and what was done to it."""


@dataclass(frozen=True)
class Change:
    """A row of panels."""

    names: tuple[str, ...]
    """Of the effects and settings it shows."""
    caption: str
    """What the panels are, from left to right."""
    picture: np.ndarray
    """[HEIGHT, w, 3] uint8."""


def changes_of(results: Results) -> list[Change]:
    """What can be shown of a sequence; what was not made, was dropped or whose source is gone is left out."""
    valid, sources = results.context.valid, list(results.context.views.sources)
    frames = np.flatnonzero(valid[:, sources].any(axis=1))
    if not len(frames):
        return []
    frame = int(frames[len(frames) // 2])
    views = [v for v in sources if valid[frame, v]]
    found: list[Change] = []
    for rows in (_filmed_and_worked, _matched, _averaged, _cut_out, _smoothed, _depths):
        try:
            found += rows(results, frame, views)
        except UserError:
            continue  # the table of stages says what is there
    return found


def not_shown(results: Results, shown: Sequence[Change]) -> list[str]:
    """Effects that are on and in no row: the archive holds nothing that was made without them."""
    told = {name for change in shown for name in change.names}
    return [name for name in _on(results, *results.context.effects) if name not in told]


def _filmed_and_worked(results: Results, frame: int, views: Sequence[int]) -> Iterator[Change]:
    """The view whose pixels are moved most."""
    context = results.context
    if not _on(results, UNDISTORTION, CROP_SCALE, TONE_MAPPING):
        return
    captured = np.array([s.size for s in context.capture.pictures])
    moved = lens_displacement(context.rig, context.capture.rig)
    moved += crop_displacement(context.rig, context.capture.rig, captured, context.captured_to_calibrated)
    view = max(views, key=lambda v: moved[v])
    filmed, worked = _filmed(results, frame, view), _worked(results, frame, view)
    yield _row(
        _on(results, UNDISTORTION, CROP_SCALE, LIGHT_STEADYING, NOISE_AVERAGING, EXPOSURE_MATCHING, TONE_MAPPING),
        f"{context.rig.names[view]} as filmed, as it is worked on, difference x {TIMES}",
        [filmed, worked, _difference(filmed, worked[_filmed_part(results, view)])],
    )


def _matched(results: Results, frame: int, views: Sequence[int]) -> Iterator[Change]:
    """The two views whose gains differ most, before and after."""
    context, sources = results.context, results.context.views.sources
    if not (on := _on(results, EXPOSURE_MATCHING)) or (found := match(_compared_points(results))) is None:
        return
    stops = dict(zip(sources, np.log2(found.gains).mean(axis=1), strict=True))
    pair = [choose(views, key=lambda v: stops[v]) for choose in (min, max)]
    if stops[pair[0]] == stops[pair[1]]:
        return
    yield _row(
        on,
        f"{' and '.join(context.rig.names[v] for v in pair)} as filmed, then with their gains",
        [read(results, frame, v) for read in (_filmed, _worked) for v in pair],
    )


def _compared_points(results: Results) -> np.ndarray:
    """[S, S, point, 3] light of the points by which gains were found that the sources' pictures have."""
    context = results.context
    array = compared(context.facts)
    if array == SURFACE:
        light = np.stack([results.read(array, range(1), v) for v in context.views.sources])
    else:
        light = results.read(array, range(1))
    return points_in(replace(context.evidence("frames"), facts=context.facts, noted={array: light}))


def _averaged(results: Results, frame: int, views: Sequence[int]) -> Iterator[Change]:
    """A piece of a picture, enlarged: noise is a matter of single pixels."""
    if not (on := _on(results, NOISE_AVERAGING)):
        return
    view = views[0]
    part = _filmed_part(results, view)
    top, left = (max(0, (s.start + s.stop - CLOSE) // 2) for s in _box(_mask(results, frame, view)[part]))
    piece = (slice(top, top + CLOSE), slice(left, left + CLOSE))
    before, after = _filmed(results, frame, view)[piece], _worked(results, frame, view)[part][piece]
    name = results.context.rig.names[view]
    told = f"{name}, enlarged: one picture, averaged with those around it, difference x {TIMES}"
    yield _row(on, told, [before, after, _difference(before, after)])


def _cut_out(results: Results, frame: int, views: Sequence[int]) -> Iterator[Change]:
    """What is taken for the subject."""
    context = results.context
    matte = resolve_matte(context.settings.frames, context.facts)
    if matte == "none":
        return
    mask = _mask(results, frame, views[0])
    box = _box(mask, AROUND)
    color, mask = _worked(results, frame, views[0])[box], mask[box]
    cut = (color * (mask[..., None] / 255.0)).astype(np.uint8)
    told = f"{context.rig.names[views[0]]}: the picture, and what is taken for the subject ({matte})"
    yield _row(("frames.matte",), told, [color, cut])


def _smoothed(results: Results, frame: int, views: Sequence[int]) -> Iterator[Change]:
    """All joints' heatmaps, of the view in which smoothing changes them most."""
    if not (on := _on(results, TEMPORAL_SMOOTHING)):
        return

    def maps(view: int) -> list[np.ndarray]:
        read = [_array(results, f"{stage}/heatmaps", frame, view) for stage in ("pose", "smoothing")]
        return [m.astype(np.float32) for m in read]

    drawn = {view: maps(view) for view in views if view in results.views_of("smoothing/heatmaps")}
    if not drawn:
        return
    apart = {view: np.abs(after - before).max(axis=0) for view, (before, after) in drawn.items()}
    view = max(apart, key=lambda v: float(apart[v].max()))
    most = max(float(drawn[view][0].max()), 1e-6)
    told = f"{results.context.rig.names[view]}: heatmaps of this frame, blended with those before, difference"
    yield _row(on, told, [_grey(m / most) for m in (*(m.max(axis=0) for m in drawn[view]), apart[view])])


def _depths(results: Results, frame: int, views: Sequence[int]) -> Iterator[Change]:
    """One view's depth after every stage that changed it, and what they did together."""
    from posegaussian.storage.exporters.contact_sheet import color_depth

    there = {array: words for array, words in DEPTHS.items() if results.has(array)}
    if len(there) < 2:
        return
    box = _box(_mask(results, frame, views[0]))
    whole = [_array(results, array, frame, views[0]) for array in there if array not in REFINED]
    if len(whole) < len(there):
        whole.append(_refined(results, frame, views[0], whole[-1]))
    maps = [m[box] for m in whole]
    apart = np.where((maps[0] > 0) & (maps[-1] > 0), np.abs(maps[-1] - maps[0]) / FAR, 0)
    names, said = zip(*there.values(), strict=True)
    told = f"{results.context.rig.names[views[0]]}: {', '.join(said)}; difference, {FAR * 100:g} cm and more are white"
    yield _row(names, told, [*(color_depth(m) for m in maps), _grey(apart)])


def _refined(results: Results, frame: int, view: int, before: np.ndarray) -> np.ndarray:
    """[h, w] metres: the depth `before` refinement, and that of the Gaussians which it left where it left some."""
    count, after = int(_array(results, COUNTS, frame, view)), before.copy()
    depth, pixel = (
        results.read(f"refinement/{name}", range(frame, frame + 1), view, count)[0] for name in ("depth", "pixel")
    )
    after.reshape(-1)[pixel] = depth
    return after


def _on(results: Results, *names: str) -> tuple[str, ...]:
    """Those of some effects that are on."""
    effects = results.context.effects
    return tuple(name for name in names if effects[name].state == "on")


def _array(results: Results, array: str, frame: int, view: int) -> np.ndarray:
    return results.read(array, range(frame, frame + 1), view)[0]


def _filmed(results: Results, frame: int, view: int) -> np.ndarray:
    """[h, w, 3] uint8 sRGB as the file has it, in the size of its part of the picture that is worked on."""
    import cv2

    context = results.context
    (picture,) = open_source(context.capture, "pictures").read(view, [int(context.source_frames[frame])])
    height, width = (s.stop - s.start for s in _filmed_part(results, view))
    return cv2.resize(to_display(picture), (width, height), interpolation=cv2.INTER_AREA)


def _filmed_part(results: Results, view: int) -> tuple[slice, slice]:
    """Rows and columns of the picture that is worked on which the calibrated one has: without its lens a picture may
    reach farther."""
    rig, source_rig = results.context.rig, results.context.capture.rig
    reduced = rig.intrinsics[view, [0, 1], [0, 1]] / source_rig.intrinsics[view, [0, 1], [0, 1]]
    low = np.rint(rig.intrinsics[view, :2, 2] - source_rig.intrinsics[view, :2, 2] * reduced).astype(int)
    left, top = (max(0, int(n)) for n in low)
    width, height = (int(n) for n in np.minimum(np.rint(source_rig.size[view] * reduced), rig.size[view] - [left, top]))
    return slice(top, top + height), slice(left, left + width)


def _worked(results: Results, frame: int, view: int) -> np.ndarray:
    """[h, w, 3] uint8 sRGB without the padding of mixed sizes."""
    width, height = results.context.rig.size[view]
    return _array(results, "frames/color", frame, view)[:height, :width]


def _mask(results: Results, frame: int, view: int) -> np.ndarray:
    """[h, w] uint8."""
    width, height = results.context.rig.size[view]
    return _array(results, "frames/mask", frame, view)[:height, :width]


def _box(mask: np.ndarray, margin: float = 0.0) -> tuple[slice, slice]:
    """Around what a mask [h, w] uint8 holds, with a margin of its longer side; all of an empty one."""
    held = foreground(mask)
    if not held.any():
        return slice(0, mask.shape[0]), slice(0, mask.shape[1])
    rows, columns = (np.flatnonzero(held.any(axis=axis)) for axis in (1, 0))
    wide = round(margin * max(np.ptp(rows), np.ptp(columns)))
    down, across = (slice(max(0, int(at[0]) - wide), int(at[-1]) + 1 + wide) for at in (rows, columns))
    return down, across


def _difference(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return (np.abs(a.astype(np.int16) - b) * TIMES).clip(0, 255).astype(np.uint8)


def _grey(values: np.ndarray) -> np.ndarray:
    """[h, w] 0..1, more is cut off -> [h, w, 3] uint8."""
    return np.repeat((np.clip(values, 0, 1) * 255).astype(np.uint8)[..., None], 3, axis=-1)


def _row(names: Sequence[str], caption: str, panels: Sequence[np.ndarray]) -> Change:
    """Pictures [h, w, 3] uint8 of any size, side by side at one height; small ones are enlarged."""
    import cv2

    gap, cells = np.full((HEIGHT, GAP, 3), 255, np.uint8), []
    for panel in panels:
        size = max(1, round(panel.shape[1] * HEIGHT / panel.shape[0])), HEIGHT
        how = cv2.INTER_AREA if panel.shape[0] > HEIGHT else cv2.INTER_NEAREST
        cells += [cv2.resize(np.ascontiguousarray(panel), size, interpolation=how), gap]
    return Change(tuple(names), caption, np.concatenate(cells[:-1], axis=1))
