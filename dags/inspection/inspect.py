"""`posegaussian inspect`: what is wrong with a capture, in numbers, pictures and one page;
nothing is written to the archive."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from posegaussian.dags.humanize.listing import listing
from posegaussian.dags.inspection.judged import left_out_views
from posegaussian.dags.inspection.portraits import portraits, told_by_place, who_is_who
from posegaussian.dags.planning.context import Context
from posegaussian.stages.contract.facts import ESTIMATED, JOINTS2D, JOINTS3D, MASKS, Facts
from posegaussian.stages.depth.params import resolve_method
from posegaussian.stages.detection.asset import blazepose_is_here, estimator_of
from posegaussian.stages.detection.params import DetectionParams, estimator_choice
from posegaussian.stages.frames.params import matte_choice
from posegaussian.stages.imaging.camera_mapping import frames_rig, undistorted
from posegaussian.stages.inspection.cameras import of_sizes, size_unexplained
from posegaussian.stages.inspection.finding import TO_MEND, Finding, FindingVerdict, worst_first
from posegaussian.stages.inspection.footage import Footage, scope_of
from posegaussian.stages.inspection.people import Finder
from posegaussian.stages.inspection.planned import Planned
from posegaussian.stages.inspection.report import Report, inspect
from posegaussian.storage.readers.sources import open_source

LONGEST = 1280
"""Longer side in px of the pictures in which features are looked for:
larger ones have no more features that two views share."""
STYLE = {
    FindingVerdict.GOOD: "green",
    FindingVerdict.DOUBTFUL: "yellow",
    FindingVerdict.BAD: "red",
    FindingVerdict.LEFT_OUT: "magenta",
    FindingVerdict.UNKNOWN: "dim",
    FindingVerdict.NOTE: "cyan",
}


@dataclass(frozen=True)
class _Chosen:
    """A reader of some of the cameras, counted anew."""

    reader: Any
    views: tuple[int, ...]

    @property
    def joint_set(self) -> str:
        """Joint set of a reader of joints."""
        return str(self.reader.joint_set)

    def numbers(self, view: int) -> np.ndarray:
        """Frame numbers of a reader of pictures."""
        return np.asarray(self.reader.numbers(self.views[view]))

    def size(self, view: int) -> tuple[int, int]:
        """Captured size of a reader of pictures."""
        width, height = self.reader.size(self.views[view])
        return width, height

    def identity(self, view: int, number: int) -> str:
        """A text that no other picture has, of a reader of pictures."""
        return str(self.reader.identity(self.views[view], number))

    def read(self, view: int, number: Any) -> Any:
        """What the reader gives."""
        return self.reader.read(self.views[view], number)


def footage_of(context: Context, joints: Any = None) -> tuple[Footage, list[Finding]]:
    """What an inspection looks at, and the findings on picture sizes.

    `joints`: a reader of 2D joints of all cameras of the capture, in captured pixels, in place of those that came with
    it.
    """
    capture, views = context.capture, context.active_views
    source_rig = capture.rig.subset(views)
    streams = [capture.pictures[v] for v in views]
    crops, sizes = context.captured_to_calibrated[list(views)].copy(), []
    for v, stream in enumerate(streams):
        calibrated = (int(source_rig.size[v, 0]), int(source_rig.size[v, 1]))
        if tuple(stream.size) != calibrated and (crops[v] == [1.0, 0.0, 0.0]).all():
            scale = calibrated[0] / stream.size[0]
            crops[v] = scale, 0.0, (calibrated[1] - scale * stream.size[1]) / 2
            suggestion = f"{{crop: {{{source_rig.names[v]}: {{scale: {scale:.6g}, offset: [0, {crops[v, 2]:.4g}]}}}}}}"
            sizes.append(size_unexplained(source_rig.names[v], stream.size, calibrated, suggestion))
        else:
            sizes.append(of_sizes(source_rig, v, stream.size, crops[v]))
    captured = np.array([s.size for s in streams])
    rig = undistorted(frames_rig(source_rig, LONGEST), source_rig, captured, crops)
    pictures = open_source(capture, "pictures")
    readers: dict[str, Any] = {"pictures": _Chosen(pictures, views)}
    if blazepose_is_here():
        readers["found"] = _Chosen(
            Finder(pictures, estimator_of(DetectionParams(estimator="blazepose", zoom=2)), capture.rig), views
        )
    if all(capture.masks and capture.masks[v] is not None for v in views):
        readers["masks"] = _Chosen(open_source(capture, "masks"), views)
    as_calibrated = joints is None and context.settings.pose.joints_frame == "calibrated"
    if joints is None and any(capture.joints and capture.joints[v] is not None for v in views):
        joints = open_source(capture, "joints")
    if joints is not None:
        readers["joints"] = _Chosen(joints, views)
    if ESTIMATED in context.capture_facts:
        readers["estimator"] = estimator_of(context.asset_settings("estimator"))
    if capture.joints3d is not None:
        readers["joints3d"] = open_source(capture, "joints3d")
    facts = {"masks": MASKS, "joints": JOINTS2D, "joints3d": JOINTS3D}
    joint_crops = np.tile([1.0, 0.0, 0.0], (len(views), 1)) if as_calibrated else crops
    numbers = [np.intersect1d(s.numbers, context.source_frames) for s in streams]
    runs = capture.repeats(context.source_frames)
    return (
        Footage(
            scope_of(rig, source_rig, crops, Facts(frozenset(facts[k] for k in readers if k in facts))),
            joint_crops,
            captured,
            numbers,
            capture.frame_rate,
            readers,
            repeats={v: runs[view] for v, view in enumerate(views) if streams[v].kind == "images"},
        ),
        sizes,
    )


def planned_of(context: Context) -> Planned:
    """What a run under these settings will make of the capture: by the same functions that decide it there."""
    settings, facts = context.settings, context.capture_facts
    depth = settings.depth.model_copy(update={"method": resolve_method(settings.depth, facts).name})
    matte, estimator = matte_choice(settings.frames, facts), estimator_choice(settings.detection, facts)
    sources, trust = context.asked_views.sources, settings.views.trust
    return Planned(
        context.rig,
        context.active_views,
        sources,
        depth,
        matte,
        estimator,
        facts,
        trust,
        left_out_views(context),
        settings.survey.sample,
    )


def run_inspection(context: Context, console: Console, output: Path | None = None, joints: Any = None) -> int:
    """Measure, print, and write pictures and page into `output` (default: inspect-SEQUENCE); returns the exit
    status, 1 for a bad capture."""
    from posegaussian.dags.inspection.figures import write_pictures, write_portraits
    from posegaussian.dags.inspection.html_page import write_page

    name = context.sequence.name
    footage, sizes = footage_of(context, joints)
    report = inspect(footage, sizes, planned_of(context))
    footage = report.footage
    folder = output or Path(f"inspect-{name}")
    pictures = write_pictures(footage, report, folder)
    people = portraits(footage)
    report = told_by_place(report, people)
    seen = list(zip(people, write_portraits(footage, people, folder), strict=True))
    page = write_page(name, footage, report, pictures, folder / "index.html", seen)
    console.print(table(name, report, console.width))
    for line in (*report.outlook, *who_is_who(people, report.findings), *spoken(report)):
        console.print(line, markup=False, soft_wrap=True)
    console.print(f"{name}: {report.sentence}", style=STYLE[report.verdict], markup=False, soft_wrap=True)
    console.print(f"page: {page}", markup=False, soft_wrap=True)
    return 1 if report.verdict is FindingVerdict.BAD else 0


def table(name: str, report: Report, width: int) -> Table:
    """One row a finding, without its sentence; those that are good or only noted stand together, see `rows`. `width`:
    columns of the terminal."""
    told = [
        (
            f.measure,
            escape(f.about) + (f" and {more} more" if more else ""),
            f.number,
            f"[{STYLE[f.verdict]}]{f.verdict}[/]",
            f.bounds,
        )
        for f, more in rows(report.findings)
    ]
    title = f"{escape(name)}: is the capture usable?"
    return listing(("measure", "of", "number", "verdict", "bounds"), told, width, title)


def rows(findings: Sequence[Finding]) -> Iterator[tuple[Finding, int]]:
    """Findings worst first; of a measure that is good, noted or unknown the one nearest to its bound, and how many
    more there are."""
    kept: dict[tuple[str, FindingVerdict], list[Finding]] = {}
    for f in worst_first(findings):
        alone = f.verdict in TO_MEND
        kept.setdefault((f"{f.measure} {f.about}" if alone else f.measure, f.verdict), []).append(f)
    for same in kept.values():
        yield same[0], len(same) - 1


def spoken(report: Report) -> list[str]:
    """What to do, the most useful first, and what could not be measured."""
    wanted = [f"{i}. {verdict}: {found}. To do: {advice}" for i, (verdict, found, advice) in enumerate(report.to_do, 1)]
    return wanted + [f"not measured: {u}" for u in report.unmeasured]
