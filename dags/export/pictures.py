"""From finished pictures of camera paths to files people open: video, frames, contact sheet.

Of several paths each has files of its own: `out_KIND.mp4`, `frames/KIND/`, `sheet_KIND.png`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import repeat
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from posegaussian.dags.export.background import BLACK, Backdrop, over
from posegaussian.dags.planning.context import Context
from posegaussian.dags.planning.plan import Plan
from posegaussian.dags.planning.results import Results
from posegaussian.dags.planning.tasks import Product
from posegaussian.stages.camera_paths.gaps import STANDING
from posegaussian.stages.network.params import depth_array
from posegaussian.storage.model.cameras import CameraPath
from posegaussian.storage.model.errors import UserError

if TYPE_CHECKING:
    from posegaussian.storage.exporters.contact_sheet import Sheet


def pictures(
    results: Results, path: CameraPath, backdrop: Backdrop = BLACK, cameras: range | None = None
) -> Iterator[tuple[int, int, np.ndarray, np.ndarray]]:
    """(frame index, camera, [h, w, 3] uint8 over the backdrop, [h, w] uint8 alpha) of all served pictures, frame by
    frame; of some cameras no others are read.

    The padding of mixed sizes is cut off.
    """
    chosen = range(len(path.names)) if cameras is None else cameras
    colors, alphas = (results.iterate(f"rendering/{path.name}/{kind}", chosen) for kind in ("color", "alpha"))
    for (frame, of_color), (_, of_alpha) in zip(colors, alphas, strict=True):
        for camera, color, alpha in zip(chosen, of_color, of_alpha, strict=True):
            if path.served[frame, camera]:
                width, height = path.size[camera]
                shown, coverage = color[:height, :width], alpha[:height, :width]
                behind = backdrop.behind(results, path, frame, camera)
                yield frame, camera, shown if behind is None else over(shown, coverage, behind), coverage


STEP_RATE = 24.0
"""Frames a second of a single instant's video and page: cameras that are the steps of one that moves."""


def frame_rate(context: Context) -> float:
    """Frames a second of the sequence; those of `STEP_RATE` where it has a single one."""
    numbers = context.source_frames
    return float(context.capture.frame_rate / np.median(np.diff(numbers))) if len(numbers) > 1 else STEP_RATE


LONGEST_GAP = 10.0
"""Seconds: frames that lie farther apart are played as if they did not."""


def play_times(context: Context) -> np.ndarray:
    """[F] seconds from the first frame on at which a video and a page show each: where frames are lacking, the one
    before stays for as long, up to `LONGEST_GAP`."""
    numbers = context.source_frames
    gaps = np.diff(numbers) / context.capture.frame_rate
    longest = max(LONGEST_GAP, 1 / frame_rate(context))
    return np.concatenate([[0.0], np.cumsum(np.minimum(gaps, longest))])


def _moves(path: CameraPath) -> bool:
    """Whether the cameras of a single instant are steps of one video: neither cameras of the capture nor of several
    sizes."""
    return len(path.served) == 1 and path.kind not in STANDING and bool((path.size == path.size[:1]).all())


def export_video(results: Results, path: CameraPath, file: Path, backdrop: Backdrop = BLACK) -> list[Path]:
    """Write H.264 video: of the path's one camera over time, of its steps for a single frame, else one file a camera.

    A camera that does not serve a frame keeps showing its last picture, black before the first, and so do all where the
    capture lacks frames. Returns the files written. Raises UserError when the path serves no frame.
    """
    from posegaussian.storage.exporters.video import write_video

    if not path.served.any():
        raise UserError(
            f"camera path {path.text!r} serves no frame of sequence {results.context.sequence.name};"
            f" nothing to write to {file}"
        )
    rate = frame_rate(results.context)
    if _moves(path):
        write_video(file, (picture for _, _, picture, _ in pictures(results, path, backdrop)), rate)
        return [file]
    written = []
    for camera, name in enumerate(path.names):
        if path.served[:, camera].any():
            own = file if len(path.names) == 1 else file.with_name(f"{file.stem}_{name}{file.suffix}")
            write_video(own, _held(results, path, camera, backdrop), rate)
            written.append(own)
    return written


def _held(results: Results, path: CameraPath, camera: int, backdrop: Backdrop) -> Iterator[np.ndarray]:
    """[h, w, 3] uint8 of one camera at every tick of its video, so that it keeps time with the sequence."""
    width, height = path.size[camera]
    shown, begins, done = np.zeros((height, width, 3), np.uint8), ticks(results.context), 0
    for frame, _, picture, _ in pictures(results, path, backdrop, range(camera, camera + 1)):
        yield from repeat(shown, begins[frame] - done)
        shown, done = picture, begins[frame]
    yield from repeat(shown, begins[-1] + 1 - done)


def ticks(context: Context) -> list[int]:
    """Of every frame the tick of a video at which it begins: the one nearest to its time that no earlier frame has."""
    order = np.arange(len(context.source_frames))
    nearest = np.rint(play_times(context) * frame_rate(context)).astype(int)
    return [int(n) for n in np.maximum.accumulate(nearest - order) + order]


def export_frames(results: Results, path: CameraPath, folder: Path, alpha: bool, backdrop: Backdrop = BLACK) -> int:
    """Write `<camera>/<frame:06d>.png` and frames.csv; returns the number of pictures."""
    from posegaussian.storage.exporters.frames import write_frames

    context = results.context
    numbers, times = context.source_frames, context.time
    items = (
        (path.names[c], int(numbers[f]), picture, a if alpha else None)
        for f, c, picture, a in pictures(results, path, backdrop)
    )
    return write_frames(folder, path.names, numbers, times, items)


SHEET_FRAMES, SHEET_VIEWS, SHEET_MOMENTS = 3, 4, 6
"""Frames of a contact sheet, source views and novel views of each, and frames of a path that has one camera only."""


def spread(items: Sequence[int] | np.ndarray, most: int) -> list[int]:
    """At most `most` of some items, evenly spread, first and last among them."""
    return (
        [int(items[i]) for i in np.unique(np.linspace(0, len(items) - 1, min(most, len(items))).round().astype(int))]
        if len(items)
        else []
    )


def _novel_frames(context: Context, path: CameraPath) -> list[int]:
    """Frames whose novel views a contact sheet shows."""
    return spread(range(len(context.source_frames)), SHEET_FRAMES if len(path.names) > 1 else SHEET_MOMENTS)


def needed(context: Context, pictures: bool, sheet: bool) -> frozenset[Product]:
    """What an export of pictures or of a contact sheet reads:
    it must be there when the run is over, whatever `keep` says."""
    found: set[Product] = set()
    if pictures:
        arrays = [f"rendering/{name}/{kind}" for name in context.paths for kind in ("color", "alpha")]
        found |= {Product(a, p, None) for a in arrays for p in context.grid.partitions}
    return frozenset(found | _needed_by_sheet(context)) if sheet else frozenset(found)


def _needed_by_sheet(context: Context) -> set[Product]:
    length, found = context.grid.length, set()
    for frame in spread(range(len(context.source_frames)), SHEET_FRAMES):
        views = spread(context.views.sources, SHEET_VIEWS)
        shown = ("pose/joints2d", "frames/color", "frames/mask", depth_array(context.facts))
        found |= {Product(a, frame // length, v) for a in shown for v in views}
    for name, path in context.paths.items():
        for frame in _novel_frames(context, path):
            found.add(Product(f"rendering/{name}/color", frame // length, None))
            if path.kind == "held_out":
                cameras = spread(np.flatnonzero(path.served[frame]), SHEET_VIEWS)
                views = [context.rig.index(path.names[c]) for c in cameras]
                found |= {Product(a, frame // length, v) for a in ("frames/color", "frames/mask") for v in views}
    return found


def export_sheet(results: Results, path: CameraPath, file: Path) -> None:
    """Write a contact sheet."""
    from posegaussian.storage.exporters.contact_sheet import write_sheet

    write_sheet(file, filled_sheet(results, path))


def filled_sheet(results: Results, path: CameraPath) -> Sheet:
    """A contact sheet: novel views large, below them a strip of sources a frame: picture, mask, joints, depth."""
    from posegaussian.storage.exporters.contact_sheet import Sheet

    context = results.context
    sheet = Sheet(context.joint_set)
    sheet.begin()
    for frame in _novel_frames(context, path):
        color = results.read(f"rendering/{path.name}/color", range(frame, frame + 1))[0]
        for c in spread(np.flatnonzero(path.served[frame]), SHEET_VIEWS):
            w, h = path.size[c]
            truth = held_out_picture(results, path, c, range(frame, frame + 1))
            sheet.add_novel(f"{path.names[c]} frame {context.source_frames[frame]}", color[c, :h, :w], truth)
    for frame in spread(range(len(context.source_frames)), SHEET_FRAMES):
        sheet.begin()
        for view in spread(context.views.sources, SHEET_VIEWS):
            _add_source(sheet, results, frame, view)
    return sheet


def _add_source(sheet: Sheet, results: Results, frame: int, view: int) -> None:
    context, one = results.context, range(frame, frame + 1)
    width, height = context.rig.size[view]
    crop = (slice(height), slice(width))
    sheet.add_source(
        f"{context.views.names[view]} frame {context.source_frames[frame]}",
        results.read("frames/color", one, view)[0][crop],
        results.read("frames/mask", one, view)[0][crop],
        results.read("pose/joints2d", one, view)[0] if results.has("pose/joints2d") else None,
        results.read(depth_array(context.facts), one, view)[0][crop],
    )


def held_out_picture(results: Results, path: CameraPath, camera: int, frame: range) -> np.ndarray | None:
    """[h, w, 3] the held-out picture over black that a rendered one is compared with, or None."""
    if path.kind != "held_out":
        return None
    view = results.context.rig.index(path.names[camera])
    w, h = path.size[camera]
    color, mask = (results.read(a, frame, view)[0][:h, :w] for a in ("frames/color", "frames/mask"))
    return (color * (mask[..., None] / 255.0)).round().astype(np.uint8)


def own_names(context: Context) -> dict[str, str]:
    """By the name of a path what its files are called beside those of others: its kind, its name where two are of one
    kind; empty for the only one."""
    kinds = [p.kind for p in context.paths.values()]
    if len(kinds) == 1:
        return dict.fromkeys(context.paths, "")
    return {name: p.kind if kinds.count(p.kind) == 1 else name for name, p in context.paths.items()}


def check_frames(context: Context, folder: Path) -> None:
    """Raise UserError where the folder holds pictures of something else."""
    from posegaussian.storage.exporters.frames import refuse_strangers

    for name, own in own_names(context).items():
        refuse_strangers(folder / own, context.paths[name].names, context.source_frames)


def write_exports(
    p: Plan,
    video: Path | None,
    frames: Path | None,
    sheet: Path | None,
    alpha: bool = False,
    backdrop: Backdrop = BLACK,
) -> list[str]:
    """Write what was asked for of every path of a finished plan, for each its own files; returns sentences about
    them."""
    results = Results(p.context)
    said = []
    for name, own in own_names(p.context).items():
        chosen = p.context.paths[name]
        of = f" of {chosen.text}" if own else ""
        if video:
            said += [f"video{of}: {file}" for file in export_video(results, chosen, _own(video, own), backdrop)]
        if frames:
            count = export_frames(results, chosen, frames / own, alpha, backdrop)
            said.append(f"frames{of}: {count} pictures in {frames / own}")
        if sheet:
            export_sheet(results, chosen, _own(sheet, own))
            said.append(f"contact sheet{of}: {_own(sheet, own)}")
    return said


def _own(file: Path, own: str) -> Path:
    """The file of one path."""
    return file.with_name(f"{file.stem}_{own}{file.suffix}") if own else file
