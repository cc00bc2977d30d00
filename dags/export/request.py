"""What one `posegaussian export` is asked to write:
checked before anything runs, told to the plan, written when it is done."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from posegaussian.dags.export import background as backdrop
from posegaussian.dags.export import layouts, pictures
from posegaussian.dags.export import page as exporting_page
from posegaussian.dags.export import splats as exporting_splats
from posegaussian.dags.export.background import Backdrop
from posegaussian.dags.export.output_paths import output_file, output_folder
from posegaussian.dags.planning.context import Context
from posegaussian.dags.planning.plan import Plan
from posegaussian.dags.planning.results import Results
from posegaussian.dags.planning.tasks import Product
from posegaussian.storage.exporters.video import check_rate
from posegaussian.storage.model.errors import ConfigError


@dataclass(frozen=True)
class ExportOrder:
    """Files to write; None where not asked for."""

    video: Path | None
    """H.264 video."""
    frames: Path | None
    """Folder of PNG pictures."""
    sheet: Path | None
    """Contact sheet."""
    splats: Path | None
    """Folder of 3DGS PLY files."""
    views: tuple[str, ...]
    """Source views whose Gaussians become splats or a page; empty for all."""
    alpha: bool
    """Whether pictures keep their coverage."""
    backdrop: Backdrop
    """What videos and pictures stand on."""
    splats_as: str = "ply"
    """How splats are named and written: a key of `SPLAT_FILES`."""
    layout: str | None = None
    """Layout of another tool that the capture is written in."""
    folder: Path = Path()
    """Where that goes."""
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

    @classmethod
    def of(
        cls,
        video: Path | None,
        frames: Path | None,
        sheet: Path | None,
        splats: Path | None,
        views: tuple[str, ...],
        alpha: bool,
        background: str,
        splats_as: str = "ply",
        layout: str | None = None,
        folder: Path | None = None,
        frame: int | None = None,
        page: Path | None = None,
        path: str | None = None,
        page_gaussians: int | None = None,
        budget: float | None = None,
    ) -> ExportOrder:
        """From the command's options.

        Raises ConfigError where nothing is asked for, two wishes exclude each other, or a file cannot be what or where
        it is named.
        """
        if not (video or frames or sheet or splats or layout or page):
            raise ConfigError(
                "export: say what to write with --video FILE, --frames FOLDER, --sheet FILE, --splats FOLDER, --page"
                " FILE or --to LAYOUT"
            )
        exporting_splats.chosen_files(splats_as)
        if layout:
            layouts.check_layout(layout)
            output_folder("export --output", folder or Path())
        elif frame is not None:
            raise ConfigError(f"export --frame {frame}: it chooses the instant of --to LAYOUT, which is not asked for")
        elif folder is not None:
            raise ConfigError(f"export --output {folder}: it is the folder of --to LAYOUT, which is not asked for")
        if alpha and not frames:
            raise ConfigError("export --alpha: it is for --frames FOLDER, which is not asked for")
        if views and not (splats or page):
            raise ConfigError(
                f"export --view {' '.join(views)}: it is for --splats FOLDER and --page FILE, which are not asked for"
            )
        if budget is not None:
            exporting_splats.check_budget(budget, bool(splats or layout))
        if page_gaussians is not None and page is None:
            raise ConfigError(
                f"export --page-gaussians {page_gaussians}: it is for --page FILE, which is not asked for"
            )
        behind = backdrop.parse(background)
        if behind.kind != "none" and not (video or frames or (page and behind.kind == "color")):
            raise ConfigError(
                f"export --background {background}: contact sheets and splats have none, and a page has a colour;"
                " write --video FILE or --frames FOLDER"
            )
        if behind.kind != "none" and alpha:
            raise ConfigError(
                f"export --background {background}: pictures with --alpha stay transparent; leave one of the two out"
            )
        for option, file, ending in (("--video", video, ".mp4"), ("--sheet", sheet, ".png"), ("--page", page, ".html")):
            if file is not None:
                output_file(f"export {option}", file, (ending,))
        for option, place in (("--frames", frames), ("--splats", splats)):
            if place is not None:
                output_folder(f"export {option}", place)
        return cls(
            video,
            frames,
            sheet,
            splats,
            views,
            alpha,
            behind,
            splats_as,
            layout,
            folder or Path(),
            frame,
            page,
            path,
            page_gaussians,
            budget,
        )

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
        return found | layouts.needed(context, self.frame) if self.layout else found

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
            layouts.check(context, self.layout, self.folder, self.frame)

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
            said += layouts.export_layout(Results(plan.context), self.layout, self.folder, self.frame, self.budget)
        return said
