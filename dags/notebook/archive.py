"""An archive as a notebook sees it: sequences, their arrays as NumPy and xarray, and the command line's plans and runs.

Everything goes through the mechanisms of a run: names are checked before they are followed, arrays of stages are read
against their receipts, and nothing is computed unless `run` is called.
"""

from __future__ import annotations

import fnmatch
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from textwrap import shorten
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console

from posegaussian.dags.humanize.text import number
from posegaussian.dags.notebook.arguments import camera_index, listed
from posegaussian.dags.planning.context import Context
from posegaussian.dags.planning.results import Results
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.planning.tasks import PRODUCERS
from posegaussian.dags.runtime.ordering import lacks_description
from posegaussian.dags.session.session import Session
from posegaussian.storage.archive.store import SequenceGroup
from posegaussian.storage.model.cameras import Rig
from posegaussian.storage.model.errors import ArchiveError, UserError
from posegaussian.storage.model.spec import ArraySpec, TableSpec

if TYPE_CHECKING:
    import xarray

    from posegaussian.dags.planning.plan import Plan
    from posegaussian.stages.splatting.definition.scene import Gaussians


LINE = 120
"""Characters of settings in the line that an archive is printed as."""


class NoSuchFrames(UserError, ValueError):
    """Frames that a sequence does not have under its settings, or that do not follow one another."""


@dataclass(frozen=True)
class ArrayInfo:
    """What an array of a sequence is."""

    name: str
    """For example `depth/depth`."""
    dims: tuple[str, ...]
    """Names of its axes."""
    shape: tuple[int, ...]
    """Their lengths."""
    dtype: np.dtype[Any]
    """Of its values."""
    unit: str
    """SI, px, or 1 for numbers without one."""
    meaning: str
    """One sentence."""


def open_archive(
    url: str | Path = "archive", settings: Sequence[str] = (), config: str | Path | None = None, quiet: bool = True
) -> OpenArchive:
    """Open an archive, as the command line does.

    Args:
        url: its folder, or a file:// URL.
        settings: overrides as for `--set`, for example `depth.method=hull`; one alone needs no list.
        config: a configuration laid over the packaged default.
        quiet: whether plans and runs print nothing.

    Raises:
        ArchiveError: where there is no archive.
        ConfigError: for settings that are not valid, with all their faults.
    """
    console = Console(quiet=quiet)
    session = Session.open(Path(config) if config is not None else None, list(listed(settings)), str(url), console)
    _ = session.archive
    return OpenArchive(session)


@dataclass(frozen=True, repr=False)
class OpenArchive:
    """An archive under some settings."""

    session: Session

    def names(self) -> list[str]:
        """Names of the sequences, sorted."""
        return self.session.archive.names()

    def __getitem__(self, name: str) -> OpenSequence:
        """One sequence. Raises ArchiveError with the names there are."""
        self.session.archive.sequence(name)
        return OpenSequence(self.session, name)

    def __contains__(self, sequence: object) -> bool:
        """Whether a sequence, or one of this name, is there."""
        return sequence in self.names() if isinstance(sequence, str) else any(sequence == own for own in self)

    def __iter__(self) -> Iterator[OpenSequence]:
        """The sequences, by name."""
        return (self[name] for name in self.names())

    def __len__(self) -> int:
        """How many sequences there are."""
        return len(self.names())

    def __repr__(self) -> str:
        """Its folder and the options it was opened with."""
        return f"<archive {_opened(self.session)}>"


@dataclass(frozen=True, repr=False)
class OpenSequence:
    """One sequence under the settings it was opened with."""

    session: Session
    name: str

    def __repr__(self) -> str:
        """Its name, its archive's folder, and the options that was opened with."""
        return f"<sequence {self.name} of {_opened(self.session)}>"

    @property
    def context(self) -> Context:
        """The sequence under its settings, as a plan sees it."""
        return self.session.context(self.name)

    @property
    def stored(self) -> SequenceGroup:
        """Its place in the archive."""
        return self.session.archive.sequence(self.name)

    @cached_property
    def views(self) -> tuple[str, ...]:
        """Names of the cameras, in the order of the `view` axis."""
        return self.context.views.names

    @property
    def rig(self) -> Rig:
        """The cameras of `frames/*`: intrinsics [V, 3, 3] px, world_to_camera [V, 4, 4] m, size [V, 2] px."""
        return self.context.rig

    def arrays(self, pattern: str = "*") -> dict[str, ArrayInfo]:
        """The arrays that are on disk, by name, those that match a pattern such as `depth/*`. No data is read."""
        root, found = self.stored.root, {}
        for file in sorted(root.rglob("zarr.json")):
            name = file.parent.relative_to(root).as_posix()
            if name.startswith(("_", ".")) or not fnmatch.fnmatchcase(name, pattern):
                continue
            try:
                array = self.stored.open_array(name)
            except (FileNotFoundError, UserError):
                continue  # a group, or a description that nobody should follow
            dims = tuple(array.metadata.dimension_names or ())
            attributes = dict(array.attrs)
            found[name] = ArrayInfo(
                name,
                dims,
                tuple(array.shape),
                np.dtype(array.dtype),
                str(attributes.get("unit", "1")),
                str(attributes.get("meaning", "")),
            )
        return found

    def read(self, array: str, frames: range | slice | int | None = None, view: str | int | None = None) -> np.ndarray:
        """An array as NumPy.

        Args:
            array: its name, such as `depth/depth` or `rendering/orbit-1e28255c/color`.
            frames: frame indices, for arrays that a stage makes over time; None: all. One index takes the axis away, a
                slice ends with the sequence, as Python's do.
            view: one camera by name or index, for arrays with a view axis; None: every view
                that has the array, stacked: [frames, views, ...].

        Returns:
            [frames, views, ...] as the array's `dims` say.

        Raises:
            NoSuchFrames: for frames that `frames.range` leaves out, or that do not follow one another.
            ShardMissing: where a frame was not computed, or was dropped to save space.
            ArchiveError: for an array that nobody made, for a camera that is not there, and for a view of an array
                without a view axis.
        """
        spec = _made_over_time(array)
        if spec is None:
            values = self.stored.get(array)
            if view is not None or frames is not None:
                raise ArchiveError(f"{array} is read whole: it is not made frame by frame; leave frames and view out")
            return values
        context = self.context
        results, span = Results(context), _span(context, frames)
        if not spec.per_view:
            if view is not None:
                axes = ", ".join(spec.dims)
                raise ArchiveError(f"{array} has no view axis (its axes: {axes}), got view={view!r}; leave view out")
            values = results.read(array, span, None)
        elif view is not None:
            values = results.read(array, span, self._index(view))
        else:
            values = np.stack([results.read(array, span, v) for v in self._views_of(results, array)], axis=1)
        return values[0] if isinstance(frames, int | np.integer) else values

    def table(self, name: str, path: str) -> list[dict[str, Any]]:
        """The rows of a table, such as `table("metrics/{path}", "held_out")`: one dict a row.

        Args:
            name: of the table, as its stage declares it.
            path: name of a camera path in the archive; or its kind, or the text that asked for it, where one alone is
                meant.

        Raises:
            ArchiveError: for a table that no stage writes, and a path that it was not made of.
        """
        context = self.context
        results = Results(context)
        tables = [table for table, (_, spec) in PRODUCERS.items() if isinstance(spec, TableSpec)]
        if name not in tables:
            raise ArchiveError(f"no stage writes a table {name!r}; there is {', '.join(tables)}")
        made = results.paths_of(name)
        texts = {made_path.name: made_path.text for made_path in context.paths.values()}
        meant = [path] if path in made else [m for m in made if path in (m.rpartition("-")[0], texts.get(m))]
        if len(meant) != 1:
            told = ", ".join(made)
            raise ArchiveError(
                f"sequence {self.name} has {'several' if meant else 'no'} {name} of camera path {path!r}; it has"
                f" {f'those of {told}' if told else 'none yet: run first'}"
            )
        return results.table(name, meant[0])

    def dataset(self, group: str) -> xarray.Dataset:
        """A group such as `frames` as an xarray Dataset: every array by name, read when it is asked for.

        Raises:
            UserError: where xarray is not installed, with how to install it.
            ArchiveError: where there is no such group.
        """
        try:
            import xarray
        except ImportError as e:
            raise UserError("dataset() needs xarray: pip install 'posegaussian[notebook]'") from e
        place = self.stored.place(f"{group}/zarr.json").parent
        if not place.is_dir():
            known = sorted({name.partition("/")[0] for name in self.arrays()})
            raise ArchiveError(f"sequence {self.name} has no group {group}; it has {', '.join(known)}")
        return xarray.open_zarr(place, consolidated=False, chunks=None)

    def gaussians(self, frame: int, views: Sequence[str | int] | str | int | None = None) -> Gaussians:
        """The Gaussians of one frame, N of them in world axes, metres: of the source views, of some, or of one.

        Raises NoSuchFrames for anything but the index of a frame that `frames.range` has, ArchiveError for cameras that
        are no source views, ShardMissing where the frame was not computed.
        """
        import torch

        from posegaussian.dags.export.splats import frame_gaussians

        context = self.context
        if not isinstance(frame, int | np.integer):
            raise _no_such(context, "Gaussians are those of one frame, by its index", frame)
        return frame_gaussians(Results(context), _span(context, frame).start, self._sources(views), torch.float32)

    def plan(
        self,
        only: Sequence[str] = (),
        start: str | None = None,
        force: Sequence[str] = (),
        paths: Sequence[str] = (),
    ) -> Plan:
        """What a run would do and why, by stage where it is printed; nothing is computed. One name needs no list.

        Args:
            only: stages that may run; none: all.
            start: this stage and every later one is made anew.
            force: stages that are made anew though they are fresh.
            paths: camera paths to render instead of the settings' ones, such as `orbit`.
        """
        selection = Selection(frozenset(listed(only)), start, frozenset(listed(force)))
        return self.session.plan(self.name, selection, listed(paths))

    def run(
        self,
        only: Sequence[str] = (),
        start: str | None = None,
        force: Sequence[str] = (),
        paths: Sequence[str] = (),
    ) -> None:
        """Do what `plan` says; what is fresh is left alone.

        Raises:
            UserError: with a sentence for every task that failed, when all others are done.
        """
        plan = self.plan(only, start, force, paths)
        if plan.all_fresh and not lacks_description(plan):
            return
        outcome = self.session.run([plan], plan.selection)
        if outcome.ended.interrupted:
            raise KeyboardInterrupt
        if outcome.collector.failures:
            failed = "\n".join(f"{f.task.label()}: {f.error.strip()}" for f in outcome.collector.failures)
            raise UserError(f"{number(len(outcome.collector.failures), 'task')} failed:\n{failed}")

    def _sources(self, views: Sequence[str | int] | str | int | None) -> tuple[int, ...]:
        """Source views that are named, each once, all where none is. Raises ArchiveError for others, and for none."""
        sources = self.context.views.sources
        if views is None:
            return sources
        named = (views,) if isinstance(views, str | int | np.integer) else views
        chosen = tuple(dict.fromkeys(self._index(v) for v in named))
        others = [self.views[v] for v in chosen if v not in sources]
        if others or not chosen:
            raise ArchiveError(
                f"sequence {self.name} has Gaussians of its source views {', '.join(self.views[v] for v in sources)},"
                f" got {', '.join(others) or 'no view'}; leave views out for all of them"
            )
        return chosen

    def _index(self, view: str | int) -> int:
        return camera_index(self.views, view, f"sequence {self.name}")

    def _views_of(self, results: Results, array: str) -> list[int]:
        """Views that have finished outputs of an array. Raises ShardMissing where none has."""
        found = results.views_of(array)
        return found if found else list(self.context.active_views)


def _opened(session: Session) -> str:
    """The archive's folder and the settings it is seen under, the first of many."""
    options = zip(session.options[::2], session.options[1::2], strict=True)
    settings = " ".join(f"{option} {value}" for option, value in options if option != "--archive")
    return " ".join(filter(None, [session.archive_url, shorten(settings, LINE, placeholder=" ...")]))


def _made_over_time(array: str) -> ArraySpec | None:
    """The declaration of an array that a stage makes frame by frame, camera paths filled in; None for others."""
    for name, (_, spec) in PRODUCERS.items():
        pattern = name.replace("{path}", "*")
        if isinstance(spec, ArraySpec) and "frame" in spec.dims and fnmatch.fnmatchcase(array, pattern):
            return spec
    return None


def _span(context: Context, frames: range | slice | int | None) -> range:
    """Frame indices as a range. Raises NoSuchFrames for those that are not there, and for steps."""
    every = range(context.grid.frames)
    if isinstance(frames, int | np.integer):
        frame = int(frames)
        if not -len(every) <= frame < len(every):
            raise _no_such(context, "a frame must be", frame)
        return range(every[frame], every[frame] + 1)
    if not isinstance(frames, range | slice | None):
        raise _no_such(context, "frames must be an index, a range or a slice", frames)
    chosen = every if frames is None else every[frames] if isinstance(frames, slice) else frames
    if chosen.step != 1 or chosen.start < 0 or chosen.stop > len(every):
        raise _no_such(context, "frames must be consecutive", frames)
    return chosen


def _no_such(context: Context, rule: str, frames: range | slice | int | None) -> NoSuchFrames:
    count, filmed = context.grid.frames, len(context.capture.numbers)
    others = "these are all that were filmed"
    if count < filmed:
        others = (
            f"frames.range: '{context.settings.frames.range}' leaves out others of the {filmed} that were filmed;"
            " open_archive(..., settings=['frames.range=START:STOP']) has them"
        )
    return NoSuchFrames(f"sequence {context.sequence.name}: {rule} within 0..{count - 1}, got {frames!r}; {others}")
