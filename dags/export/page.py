"""From the finished Gaussians of a sequence to one HTML file that plays them.

The file holds the maps that rendering lifts Gaussians from, view by view, so that the browser shows to every camera
what the renderer would: the nearest source views, each Gaussian as opaque as it is from there. What rendering does to
finished pictures (closing of gaps, evening of outlines) needs the masks and is left out.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from posegaussian.dags.export.background import Backdrop
from posegaussian.dags.export.pictures import frame_rate, play_times
from posegaussian.dags.export.splats import chosen_views, frame_gaussians, frame_maps
from posegaussian.dags.export.splats import needed as needed_by_splats
from posegaussian.dags.humanize.text import number
from posegaussian.dags.planning.context import Context
from posegaussian.dags.planning.results import Results
from posegaussian.dags.planning.tasks import Product
from posegaussian.stages.geometry.subject import look_at_point, up_direction
from posegaussian.stages.registry import PATHS
from posegaussian.stages.rendering.effects import ANTI_ALIASING, SILHOUETTE_CLIPPING
from posegaussian.stages.rendering.sources import REFINEMENT, map_arrays
from posegaussian.stages.silhouettes.hull import Silhouettes
from posegaussian.stages.silhouettes.places import agreed
from posegaussian.stages.silhouettes.points import within
from posegaussian.storage.exporters.page import maps as coding
from posegaussian.storage.exporters.page.document import write_page
from posegaussian.storage.exporters.page.maps import CodedView, ViewMaps, coded, present
from posegaussian.storage.exporters.page.merging import merged
from posegaussian.storage.model.cameras import CameraPath
from posegaussian.storage.model.errors import ConfigError

MOST_VIEWS = 128
"""Source views of a page: the shader holds a weight for each."""
THUMBNAIL, QUALITY = 240, 70
"""Longest side in px of the small pictures of source cameras, and their WebP quality."""
BEHIND = "#101418"
"""What the person stands before unless a colour was asked for."""
LARGE = 50e6
"""Bytes above which an export says how to get a smaller page."""
HELD = 2_000_000
"""Gaussians of a frame that every device holds: 1024 in a row of a texture, and WebGL2 promises 2048 rows."""
STANDING = ("held_out", "still", "file")
"""Kinds of paths whose cameras are places, not the steps of a move."""


def needed(context: Context, views: Sequence[int]) -> frozenset[Product]:
    """What an export reads: it must be there when the run is over, whatever `keep` says."""
    filmed = {Product("frames/color", p, v) for p in context.grid.partitions for v in views}
    masks = {Product("frames/mask", p, v) for p in context.grid.partitions for v in context.views.sources}
    clipped = SILHOUETTE_CLIPPING.name in context.facts
    return needed_by_splats(context, views) | filmed | (masks if clipped else set())


def check(context: Context, names: Sequence[str], path: str | None) -> None:
    """Raise UserError for views without Gaussians, more views than a page takes, and a text that is no camera path."""
    views = chosen_views(context, names)
    if len(views) > MOST_VIEWS:
        raise ConfigError(
            f"export --page: {len(views)} source views, a page takes {MOST_VIEWS}; choose some with --view CAMERA"
        )
    _path(context, path)


def export_page(
    results: Results,
    names: Sequence[str],
    file: Path,
    path: str | None,
    backdrop: Backdrop,
    most: int | None = None,
) -> list[str]:
    """Write the page of some source views; returns sentences.

    `path` is the text of the camera path it flies along, None for the default one; blocks of pixels are merged until a
    frame has `most` Gaussians, about. Raises UserError as `check` does, and NotWritten.
    """
    context = results.context
    check(context, names, path)
    views = chosen_views(context, names)
    side = _side(results, views, most)
    counts: list[int] = []

    def head() -> dict[str, Any]:
        return page_head(context, views, path, backdrop, _middle(results, views), side, counts)

    size = write_page(file, context.sequence.name, _frames(results, views, side, counts), head)
    frames = f"{number(len(counts), 'frame')} of {_span(counts, 'd')} Gaussians"
    told = [f"page: {file}, {size / 1e6:.1f} MB, {frames}; open it in any browser"]
    if size > LARGE:
        told.append(
            "fewer frames (--set frames.range=START:STOP:STRIDE), fewer Gaussians (--page-gaussians 60000) or some of"
            " the views (--view CAMERA) make a smaller page"
        )
    if max(counts) > HELD:
        told.append(
            f"a frame of {max(counts)} Gaussians is more than some devices hold ({HELD}), phones above all;"
            f" --page-gaussians {HELD} makes a page for all of them"
        )
    return told


def _span(counts: Sequence[int], form: str) -> str:
    """The least and the greatest of some counts, or what all of them are."""
    least, greatest = format(min(counts), form), format(max(counts), form)
    return least if least == greatest else f"{least} to {greatest}"


def _frames(
    results: Results, views: Sequence[int], side: int, counts: list[int]
) -> Iterator[tuple[list[CodedView], list[bytes]]]:
    """Coded views and small pictures, frame by frame; appends every frame's number of Gaussians to `counts`."""
    for frame in range(len(results.context.source_frames)):
        found, pictures = coded_frame(results, frame, views, side)
        counts.append(sum(c.count for c in found))
        yield found, pictures


def coded_frame(
    results: Results, frame: int, views: Sequence[int], side: int = 1
) -> tuple[list[CodedView], list[bytes]]:
    """The coded views of one frame, blocks of `side` x `side` px as one Gaussian, and of each view a small picture
    (WebP), empty where its camera took none. Raises ShardMissing where the frame is not finished."""
    valid, silhouettes = results.context.valid, silhouettes_at(results, frame)
    found = [coded(merged(view_maps(results, frame, v, silhouettes), side)) for v in views]
    return found, [_thumbnail(results, frame, v) if valid[frame, v] else b"" for v in views]


def _side(results: Results, views: Sequence[int], most: int | None) -> int:
    """Side in px of the blocks that are merged, so that the frame in the middle has `most` Gaussians."""
    if most is None:
        return 1
    frame = len(results.context.source_frames) // 2
    count = sum(int(present(view_maps(results, frame, v, None)).sum()) for v in views)
    return max(1, math.ceil(math.sqrt(count / most)))


def silhouettes_at(results: Results, frame: int) -> Silhouettes | None:
    """What the masks of a frame say about where the subject is; None where pictures are not clipped by them."""
    context = results.context
    if SILHOUETTE_CLIPPING.name not in context.facts:
        return None
    views = [v for v in context.views.sources if context.valid[frame, v]]
    return agreed(context.rig, {v: results.read("frames/mask", range(frame, frame + 1), v)[0] for v in views})


def view_maps(results: Results, frame: int, view: int, silhouettes: Silhouettes | None) -> ViewMaps:
    """What rendering lifts Gaussians from, of one frame of a source view.

    With silhouettes, a Gaussian outside their hull is moved into it along its own pixel's ray: rendering takes it away
    from every picture that shows it beside the person, and leaves it in those that show it before the person, where it
    would be a hole without it. One whose ray meets no hull is left out.
    """
    rig = results.context.rig
    width, height = (int(n) for n in rig.size[view])
    maps = frame_maps(results, frame, view)
    maps = maps if maps.places is None else maps.spread(int(rig.size[:, 1].max()))
    color = np.asarray(maps.color)[:height, :width]
    depth, scale, normal, opacity = (
        np.asarray(m)[..., :height, :width] for m in (maps.depth, maps.scale, maps.normal, maps.opacity)
    )
    twist, shift = (None if m is None else np.asarray(m)[..., :height, :width] for m in (maps.twist, maps.shift))
    focal = float(rig.intrinsics[view, [0, 1], [0, 1]].mean())
    if silhouettes is not None:
        moved = within(silhouettes, depth, rig, view)
        scale = scale * (moved / np.where(depth > 0, depth, 1))
        depth = moved
    return ViewMaps(color, depth, scale, normal, opacity, twist, focal, shift)


def _thumbnail(results: Results, frame: int, view: int) -> bytes:
    """A small picture of what the camera filmed, as WebP."""
    import cv2

    width, height = (int(n) for n in results.context.rig.size[view])
    picture = results.read("frames/color", range(frame, frame + 1), view)[0][:height, :width]
    scale = min(1.0, THUMBNAIL / max(width, height))
    small = cv2.resize(picture, (round(width * scale), round(height * scale)), interpolation=cv2.INTER_AREA)
    done, data = cv2.imencode(".webp", small[..., ::-1], [cv2.IMWRITE_WEBP_QUALITY, QUALITY])
    assert done, "OpenCV writes WebP"
    return data.tobytes()


def _middle(results: Results, views: Sequence[int]) -> list[float]:
    """[3] metres in the world: the middle of the Gaussians halfway through the sequence, which whoever turns the view
    turns about."""
    import torch

    context = results.context
    means = frame_gaussians(results, len(context.source_frames) // 2, views, torch.float32).mean
    if len(means):
        return [float(x) for x in means.median(dim=0).values]
    return [float(x) for x in look_at_point(context.rig.subset(context.views.sources))]


def page_head(
    context: Context,
    views: Sequence[int],
    path: str | None,
    backdrop: Backdrop,
    target: Sequence[float] | None = None,
    side: int = 1,
    counts: Sequence[int] = (),
) -> dict[str, Any]:
    """What a page knows besides frames, as JSON has it.

    `target`: [3] metres in the world, what the view turns about, without one the point the source cameras look at;
    `counts`: Gaussians of every frame, empty where they are not known yet.
    """
    from posegaussian.stages.splatting.definition.scene import Cutoffs

    sources = context.rig.subset(context.views.sources)
    cameras, steps = _cameras(context, _path(context, path))
    cutoffs = asdict(Cutoffs())
    subject = [float(x) for x in look_at_point(sources)]
    return {
        "title": context.sequence.name,
        "frames": [int(n) for n in context.source_frames],
        "rate": frame_rate(context),
        "times": _times(context, steps),
        "steps": steps,
        "views": [_coarser(_camera(context, v), side) for v in views],
        "usable": [[bool(context.valid[f, v]) for v in views] for f in range(len(context.source_frames))],
        "sources": context.settings.rendering.sources,
        "allSides": REFINEMENT in context.facts,
        "subject": subject,
        "target": subject if target is None else list(target),
        "up": up_direction(sources).tolist(),
        "coarse": 1.0 if ANTI_ALIASING.name in context.facts else ANTI_ALIASING.threshold,
        "cutoffs": {name: cutoffs[key] for name, key in SHADER_CUTOFFS.items()},
        "coding": {
            "normalSteps": coding.NORMAL_STEPS,
            "scaleSteps": coding.SCALE_STEPS,
            "scaleZero": coding.SCALE_ZERO,
            "opacitySteps": coding.OPACITY_STEPS,
            "turnSteps": coding.TURN_STEPS,
            "shiftSteps": coding.SHIFT_STEPS,
            "shiftZero": coding.SHIFT_ZERO,
            "turns": len(map_arrays(context.facts)) > 5,
            "shifts": REFINEMENT in context.facts,
        },
        "cameras": cameras,
        "background": str(backdrop) if backdrop.kind == "color" else BEHIND,
        "info": _info(context, views, side, counts),
    }


def _times(context: Context, steps: int) -> list[float]:
    """Seconds from the first step on at which a page shows each: frames as a video does, else steps of one instant."""
    single = len(context.source_frames) == 1
    return [float(t) for t in (np.arange(steps) / frame_rate(context) if single else play_times(context))]


SHADER_CUTOFFS = {
    "near": "near",
    "frustumMargin": "frustum_margin",
    "varianceMin": "variance_min",
    "compensationMin": "compensation_min",
    "alphaMin": "alpha_min",
    "alphaMax": "alpha_max",
}
"""Uniforms of the page's shaders, and the cut-off of the renderer that each is."""


def _path(context: Context, text: str | None) -> CameraPath:
    """The cameras of a path, of the first that is rendered where none is named. Raises UserError for a text that names
    none."""
    given = context.rig, context.views
    text = text or next(iter(context.path_texts), None) or PATHS.default(*given, context.settings)
    return PATHS.make(text, *given, context.source_frames, context.settings)


def _cameras(context: Context, path: CameraPath) -> tuple[list[dict[str, Any]], int]:
    """The cameras to look through, those of the path first, and how many steps of time there are."""
    frames = len(path.served)
    moves = frames == 1 and path.kind not in STANDING
    found = []
    for at, name in [(range(len(path.names)), path.kind)] if moves else [([c], n) for c, n in enumerate(path.names)]:
        k, pose = (a[0, at] if moves else a[:, at[0]] for a in (path.intrinsics, path.world_to_camera))
        stands = bool((k == k[:1]).all() and (pose == pose[:1]).all())
        found.append(
            {
                "name": name if len(path.names) > 1 and not moves else path.kind,
                "group": f"path {path.kind}",
                "size": [int(n) for n in path.size[at[0]]],
                "lens": [_lens(i) for i in (k[:1] if stands else k)],
                "pose": [_pose(p) for p in (pose[:1] if stands else pose)],
            }
        )
    for view in context.active_views:
        group = "held-out cameras" if view in context.views.held_out else "source cameras"
        camera = _camera(context, view)
        found.append({**camera, "group": group, "lens": [camera["lens"]], "pose": [camera["pose"]]})
    return found, len(path.names) if moves else frames


def _camera(context: Context, view: int) -> dict[str, Any]:
    rig = context.rig
    return {
        "name": rig.names[view],
        "size": [int(n) for n in rig.size[view]],
        "lens": _lens(rig.intrinsics[view]),
        "pose": _pose(rig.world_to_camera[view]),
    }


def _coarser(camera: dict[str, Any], side: int) -> dict[str, Any]:
    """The camera with pixels `side` times as wide."""
    return {**camera, "lens": [n / side for n in camera["lens"]]}


def _lens(k: np.ndarray) -> list[float]:
    return [float(n) for n in (k[0, 0], k[0, 1], k[0, 2], k[1, 1], k[1, 2])]


def _pose(world_to_camera: np.ndarray) -> list[float]:
    return [float(n) for n in world_to_camera[:3].ravel()]


def _info(context: Context, views: Sequence[int], side: int, counts: Sequence[int]) -> list[tuple[str, str]]:
    """Rows of the page's information, as it stands for the whole sequence."""
    numbers, settings = context.source_frames, context.settings
    sizes = sorted({tuple(int(n) for n in context.rig.size[v]) for v in views})
    effects = [name for name, verdict in context.effects.items() if verdict.state == "on"]
    few = min(settings.rendering.sources, len(views))
    drawn = "all make" if REFINEMENT in context.facts else "1 makes" if few == 1 else f"{few} make"
    return [
        ("Frames", f"{len(numbers)} (source {numbers[0]} to {numbers[-1]}, {context.capture.frame_rate:g} a second)"),
        *([("Total", f"{sum(counts):,} Gaussians, {_span(counts, ',d')} a frame")] if counts else []),
        ("Views", f"{', '.join(context.rig.names[v] for v in views)}; {drawn} a picture"),
        ("Pictures", ", ".join(f"{w} × {h} px" for w, h in sizes) + f", {side} × {side} px merged" * (side > 1)),
        ("Depth", f"depth.method {settings.depth.method}, refinement of up to {settings.refinement.steps} steps"),
        ("Effects", ", ".join(effects) or "none"),
    ]
