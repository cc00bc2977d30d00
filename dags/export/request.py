"""What one `posegaussian export` is asked to write:
checked before anything runs, told to the plan, written when it is done."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from posegaussian.dags.export import background as backdrop
from posegaussian.dags.export import layouts, pictures
from posegaussian.dags.export import page as exporting_page
from posegaussian.dags.export import splats as exporting_splats
from posegaussian.dags.export.background import BLACK, Backdrop
from posegaussian.dags.export.output_paths import output_file, output_folder
from posegaussian.dags.planning.context import Context
from posegaussian.dags.planning.plan import Plan
from posegaussian.dags.planning.results import Results
from posegaussian.dags.planning.tasks import Product
from posegaussian.storage.exporters.layouts.registry import LAYOUTS
from posegaussian.storage.exporters.video import check_rate
from posegaussian.storage.model.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class ExportOrder:
    """Files to write; None where not asked for.

    Raises ConfigError where nothing is asked for, two wishes exclude each other, or a file cannot be what or where it
    is named.
    """

    video: Path | None = None
    """H.264 video."""
    frames: Path | None = None
    """Folder of PNG pictures."""
    sheet: Path | None = None
    """Contact sheet."""
    splats: Path | None = None
    """Folder of 3DGS PLY files."""
    views: tuple[str, ...] = ()
    """Source views whose Gaussians become splats or a page; empty for all."""
    alpha: bool = False
    """Whether pictures keep their coverage."""
    backdrop: Backdrop = BLACK
    """What videos and pictures stand on."""
    splats_as: str = "ply"
    """How splats are named and written: a key of `SPLAT_FILES`."""
    layout: str | None = None
    """Layout of another tool that the capture is written in."""
    folder: Path | None = None
    """Where that goes; None for the working folder."""
    frame: int | None = None
    """Source frame number of the one instant that is written so; None for all."""
    page: Path | None = None
    """HTML page that plays the Gaussians."""
    path: str | None = None
    """Camera path that the page flies along; None for the default one."""
    page_gaussians: int | None = None
    """Gaussians of a frame of the page, about, at most; None for all."""
    budget: float | None = None
    """Gaussians of splats and of the layout's cloud: a share of a frame's up to 1, else how many; None for all."""

    def __post_init__(self) -> None:
        if not (self.renders or self.splats or self.layout or self.page):
            raise ConfigError(
                "export: say what to write with --video FILE, --frames FOLDER, --sheet FILE, --splats FOLDER, --page"
                " FILE or --to LAYOUT"
            )
        exporting_splats.chosen_files(self.splats_as)
        if self.layout:
            layouts.check_layout(self.layout)
        self._refuse_idle_options()
        self._refuse_backdrop()
        self._check_places()

    def _refuse_idle_options(self) -> None:
        """Raise ConfigError for an option of something that is not asked for."""
        idle = "which is not asked for"
        if self.path is not None and not (self.renders or self.page):
            raise ConfigError(
                f"export --path {self.path}: it is the way of --video, --frames, --sheet and --page, none of which is"
                " asked for"
            )
        if self.frame is not None and not self.layout:
            raise ConfigError(f"export --frame {self.frame}: it chooses the instant of --to LAYOUT, {idle}")
        if self.folder is not None and not self.layout:
            raise ConfigError(f"export --output {self.folder}: it is the folder of --to LAYOUT, {idle}")
        if self.alpha and not self.frames:
            raise ConfigError(f"export --alpha: it is for --frames FOLDER, {idle}")
        if self.views and not (self.splats or self.page):
            raise ConfigError(
                f"export --view {' '.join(self.views)}: it is for --splats FOLDER and --page FILE, which are not asked"
                " for"
            )
        if self.page_gaussians is not None and self.page is None:
            raise ConfigError(f"export --page-gaussians {self.page_gaussians}: it is for --page FILE, {idle}")
        if self.budget is not None:
            exporting_splats.check_budget(
                self.budget, bool(self.splats or (self.layout and LAYOUTS[self.layout].cloud))
            )

    def _refuse_backdrop(self) -> None:
        """Raise ConfigError for a backdrop that nothing could stand on."""
        if self.backdrop.kind == "none":
            return
        if not (self.video or self.frames or (self.page and self.backdrop.kind == "color")):
            raise ConfigError(
                f"export --background {self.backdrop}: contact sheets and splats have none, and a page has a colour;"
                " write --video FILE or --frames FOLDER"
            )
        if self.alpha:
            raise ConfigError(
                f"export --background {self.backdrop}: pictures with --alpha stay transparent; leave one of the two out"
            )

    def _check_places(self) -> None:
        """Raise ConfigError where a file or folder cannot be what or where it is named."""
        files = (("--video", self.video, ".mp4"), ("--sheet", self.sheet, ".png"), ("--page", self.page, ".html"))
        for option, file, ending in files:
            if file is not None:
                output_file(f"export {option}", file, (ending,))
        for option, place in (("--frames", self.frames), ("--splats", self.splats), ("--output", self.folder)):
            if place is not None:
                output_folder(f"export {option}", place)

    @property
    def renders(self) -> bool:
        """Whether pictures of camera paths are needed: splats, pages and captures in a layout need none."""
        return bool(self.video or self.frames or self.sheet)

    def needed(self, context: Context) -> frozenset[Product]:
        """What must be there when the run is over, whatever `keep` says."""
        found = pictures.needed(context, bool(self.video or self.frames), bool(self.sheet)) | backdrop.needed(
            context, self.backdrop
        )
        if self.splats:
            found |= exporting_splats.needed(context, exporting_splats.chosen_views(context, self.views))
        if self.page:
            found |= exporting_page.needed(context, exporting_splats.chosen_views(context, self.views))
        return found | layouts.needed(context, self.layout, self.frame) if self.layout else found

    def check(self, context: Context) -> None:
        """Raise UserError, before anything runs,
        where the files of this sequence would mix with those of something else, or cannot hold it."""
        if self.video:
            check_rate(self.video, pictures.frame_rate(context))
        if self.frames:
            pictures.check_frames(context, self.frames)
        if self.splats:
            exporting_splats.refuse_strangers(context, self.splats, self.splats_as)
        if self.page:
            exporting_page.check(context, self.views, self.path)
        if self.layout:
            layouts.check(context, self.layout, self.folder or Path(), self.frame)

    def write(self, plan: Plan) -> list[str]:
        """Write everything from a finished plan; returns sentences about the files."""
        said = pictures.write_exports(plan, self.video, self.frames, self.sheet, self.alpha, self.backdrop)
        if self.splats:
            said += exporting_splats.export_splats(
                Results(plan.context), self.views, self.splats, self.splats_as, self.budget
            )
        if self.page:
            said += exporting_page.export_page(
                Results(plan.context), self.views, self.page, self.path, self.backdrop, self.page_gaussians
            )
        if self.layout:
            folder = self.folder or Path()
            said += layouts.export_layout(Results(plan.context), self.layout, folder, self.frame, self.budget)
        return said
