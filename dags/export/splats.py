"""From the finished Gaussians of a sequence to splat files that other viewers open: one a frame, 3DGS PLY or SPZ.

World axes are the capture's, in metres; colour is sRGB as harmonics of degree 0. A Gaussian's opacity is the one it
shows face-on, and it is seen from both sides: a splat file knows neither grazing angles nor inner sides.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from posegaussian.dags.humanize.text import number
from posegaussian.dags.planning.context import Context
from posegaussian.dags.planning.results import Results
from posegaussian.dags.planning.tasks import Product
from posegaussian.stages.rendering.sources import COUNTS, REFINED, REFINEMENT, map_arrays, unrefined_arrays
from posegaussian.storage.exporters.layouts.registry import LAYOUTS
from posegaussian.storage.model.errors import ConfigError, UserError
from posegaussian.storage.model.splats import Splats

if TYPE_CHECKING:
    import torch

    from posegaussian.stages.rendering.lift import GaussianMaps
    from posegaussian.stages.splatting.definition.scene import Gaussians


class SplatFiles(NamedTuple):
    """How splats are named and written."""

    name: str
    """`str.format` of a file's name: `number` is the source frame's, `place` counts from 1."""
    spz: bool
    """Whether as SPZ, else as PLY."""


SPLAT_FILES: Mapping[str, SplatFiles] = {
    "ply": SplatFiles("{number:06d}.ply", False),
    "spz": SplatFiles("{number:06d}.spz", True),
    "sequence": SplatFiles("frame{place:04d}.ply", False),
}
"""By what `--splats-as` calls it; SuperSplat plays files of the last kind as a sequence."""


NONE_MERGED = "within --budget {:.10g}, none merged"
"""What is said of a budget that all Gaussians fit in."""


def chosen_files(kind: str) -> SplatFiles:
    """How splats of a kind are named and written. Raises ConfigError for an unknown one."""
    if kind not in SPLAT_FILES:
        raise ConfigError(f"export --splats-as {kind}: unknown; known are {', '.join(SPLAT_FILES)}")
    return SPLAT_FILES[kind]


def check_budget(budget: float, asked: bool) -> None:
    """Raise ConfigError for a budget that says nothing, and for one of an export without Gaussians (not `asked`)."""
    from posegaussian.stages.splatting.budget import allowed

    try:
        allowed(1, budget)
    except ValueError as e:
        raise ConfigError(f"export --budget {budget:g}: {e}") from None
    if not asked:
        raise ConfigError(
            f"export --budget {budget:g}: it is one of Gaussians, and none are written; add --splats FOLDER or"
            " --to LAYOUT,"
            f" one with a cloud ({', '.join(name for name, layout in LAYOUTS.items() if layout.cloud)})"
        )


def chosen_views(context: Context, names: Sequence[str]) -> tuple[int, ...]:
    """Indices of the source views of these names; all source views without names.
    Raises ConfigError for other names."""
    sources = {context.views.names[v]: v for v in context.views.sources}
    for name in names:
        if name not in sources:
            raise ConfigError(
                f"export --view {name}: no source view of sequence {context.sequence.name}; these have Gaussians:"
                f" {', '.join(sources)}"
            )
    return tuple(sorted({sources[n] for n in names})) if names else context.views.sources


def needed(context: Context, views: Sequence[int]) -> frozenset[Product]:
    """What an export reads: it must be there when the run is over, whatever `keep` says."""
    arrays = (*map_arrays(context.facts), *((COUNTS,) if REFINEMENT in context.facts else ()))
    return frozenset(Product(a, p, v) for a in arrays for p in context.grid.partitions for v in views)


def export_splats(
    results: Results, names: Sequence[str], folder: Path, kind: str = "ply", budget: float | None = None
) -> list[str]:
    """Write a file a frame of the Gaussians of some source views, named and written as `kind` says, no more of them
    than the budget; returns a sentence.

    Raises UserError for a folder with splat files of something else.
    """
    from posegaussian.storage.formats.splat_ply import write_splats
    from posegaussian.storage.formats.spz import write_spz

    context = results.context
    views = chosen_views(context, names)
    files = _files(context, folder, kind)
    refuse_strangers(context, folder, kind)
    write = write_spz if chosen_files(kind).spz else write_splats
    counts, lifted = [], []
    for frame, file in enumerate(files):
        splats, whole = frame_splats(results, frame, views, budget)
        write(file, splats)
        counts.append(len(splats))
        lifted.append(whole)
    names = ", ".join(context.views.names[v] for v in views)
    said = (
        f"splats: {number(len(files), 'file')} in {folder}, {min(counts)} to {max(counts)} Gaussians each, of {names}"
    )
    if budget is None:
        return [said]
    merged = f"merged from {min(lifted)} to {max(lifted)} (--budget {budget:.10g})"
    return [f"{said}; {NONE_MERGED.format(budget) if counts == lifted else merged}"]


def _files(context: Context, folder: Path, kind: str) -> list[Path]:
    name = chosen_files(kind).name
    return [folder / name.format(number=int(n), place=at) for at, n in enumerate(context.source_frames, start=1)]


def refuse_strangers(context: Context, folder: Path, kind: str = "ply") -> None:
    """Raise UserError when the folder holds splat files that an export of this sequence would leave beside its own."""
    found = {p for ending in ("ply", "spz") for p in folder.glob(f"*.{ending}")}
    strangers = sorted(found - set(_files(context, folder, kind)))
    if strangers:
        raise UserError(
            f"folder {folder} holds {number(len(strangers), 'splat file')} of something else, for example"
            f" {strangers[0].name}; empty it or name another folder"
        )


def frame_splats(results: Results, frame: int, views: Sequence[int], budget: float | None = None) -> tuple[Splats, int]:
    """The Gaussians that rendering lifts from one frame of some views as splats in the world: view by view, or with a
    budget merged to no more than it; and how many were lifted."""
    import torch

    from posegaussian.stages.splatting.budget import within_budget
    from posegaussian.stages.splatting.splat_scene import splats_of

    lifted = frame_gaussians(results, frame, views, torch.float64)
    return splats_of(lifted if budget is None else within_budget(lifted, budget)), len(lifted)


def frame_gaussians(results: Results, frame: int, views: Sequence[int], dtype: torch.dtype) -> Gaussians:
    """The Gaussians that rendering lifts from one frame of some views, view by view, in the world."""
    import torch

    from posegaussian.stages.rendering.lift import lift
    from posegaussian.stages.splatting.definition.scene import Gaussians

    parts = []
    for view in views:
        lifted = lift(
            frame_maps(results, frame, view),
            results.context.rig.intrinsics[view],
            results.context.rig.world_to_camera[view],
            dtype,
            torch.device("cpu"),
        )
        parts.append(lifted.from_all_sides())
    return Gaussians.concatenate(parts)


def frame_maps(results: Results, frame: int, view: int) -> GaussianMaps:
    """What rendering lifts the Gaussians of one frame of a view from, the refined ones where there are any: a list."""
    from posegaussian.stages.rendering.lift import GaussianMaps, from_list

    context, at = results.context, range(frame, frame + 1)
    if REFINEMENT not in context.facts:
        return GaussianMaps(*(results.read(array, at, view)[0] for array in unrefined_arrays(context.facts)))
    count = int(results.read(COUNTS, at, view)[0])
    return from_list([results.read(array, at, view, count)[0] for array in REFINED], context.rig)
