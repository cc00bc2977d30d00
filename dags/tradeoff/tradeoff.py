"""What quality costs on the user's own machine and data: seconds a frame against PSNR, SSIM and EPE.

Every level of the chosen knobs is run in a variant of the sequence (`variants.py`); a stage that several levels have in
common is made once. Stages that differ are then run again until each has `repeats` times, one task at a time in this
process, level by level in turn, and the median counts; shared stages are timed by the one run that made them.
"""

from __future__ import annotations

import difflib
import itertools
import platform
import statistics
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from pydantic import ValidationError

from posegaussian.dags.budget.front_table import measured_under
from posegaussian.dags.compiling.warm_up import steady_seconds
from posegaussian.dags.config.faults import dotted, faults_of
from posegaussian.dags.config.settings import Settings, merge
from posegaussian.dags.config.yaml_source import parse_value
from posegaussian.dags.humanize.text import number
from posegaussian.dags.planning import effects
from posegaussian.dags.planning.context import Context
from posegaussian.dags.planning.plan import make_plan
from posegaussian.dags.planning.receipt_index import Book
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.planning.tasks import Task
from posegaussian.dags.planning.variants import others, settled_variant, share
from posegaussian.dags.runtime import threads
from posegaussian.dags.session.session import Session
from posegaussian.dags.tradeoff.pareto import QUALITIES, Level, front
from posegaussian.stages.contract.declaration import extra
from posegaussian.stages.registry import STAGES
from posegaussian.stages.registry import stage as stage_named
from posegaussian.storage.archive import ledger
from posegaussian.storage.archive.receipts import Receipt
from posegaussian.storage.archive.store import Archive, SequenceGroup
from posegaussian.storage.files.write import write_atomically
from posegaussian.storage.model.errors import ConfigError, UserError
from posegaussian.storage.model.spec import digest

PATH = ("held_out",)
MEASURES = "metrics"
"""The stage that measures and makes nothing: its seconds are no cost of the pictures."""


MISSPELT = 0.85
"""How alike a name must be to a knob's to be taken for it: settings of one stage share half of their letters."""


def declared_knobs() -> dict[str, list[Any]]:
    """{`stage.key`: levels, cheap to dear} of every setting that declares quality levels,
    and {`effects.NAME`: off, on}."""
    settings = {
        f"{s.name}.{key}": levels
        for s in STAGES
        for key, f in s.params.model_fields.items()
        if (levels := extra(f).get("quality_levels"))
    }
    return settings | {f"effects.{name}": ["off", "on"] for name in effects.declared()}


def chosen_levels(context: Context, names: Sequence[str], texts: Sequence[str]) -> dict[str, list[Any]]:
    """{knob: levels to run}: the declared ones, or those of `--levels`.

    `frames.size` may be given in pixels or, up to 1, as a share of the longest calibrated side; sizes that come to the
    same pictures count once. Raises ConfigError for unknown knobs and levels of knobs that were not asked for.
    """
    declared = declared_knobs()
    for name in names:
        knob, _, levels = name.partition("=")
        if levels and knob in declared:
            raise ConfigError(f"--knob {name}: its levels go elsewhere; write --knob {knob} --levels {name}")
        if name not in declared:
            close = difflib.get_close_matches(knob, declared, n=1, cutoff=MISSPELT)
            listed = "; ".join(f"{k} {v}" for k, v in declared.items())
            told = f'did you mean "{close[0]}"?' if close else f"these have: {listed}"
            raise ConfigError(f"--knob {name}: no such setting has quality levels; {told}")
    chosen = {name: list(declared[name]) for name in names}
    for text in texts:
        name, separator, values = text.partition("=")
        if not separator or name not in chosen:
            raise ConfigError(
                f"--levels {text}: write it as KNOB=LEVEL,LEVEL for a knob named by --knob ({', '.join(chosen)})"
            )
        chosen[name] = [parse_value(v) for v in values.split(",")]
    if "frames.size" in chosen:
        chosen["frames.size"] = _sizes(context, chosen["frames.size"])
    return {name: list({repr(v): v for v in values}.values()) for name, values in chosen.items()}


def _sizes(context: Context, levels: Sequence[Any]) -> list[int | None]:
    """Sizes as settings: shares become px, what is not smaller than the calibrated picture becomes null."""
    longest = int(context.capture.rig.size.max())
    own = context.settings.frames.size
    out: list[int | None] = []
    for level in levels:
        px = (
            longest
            if level is None
            else round(level * longest)
            if isinstance(level, float) and 0 < level <= 1
            else level
        )
        if not isinstance(px, int) or px < 1:
            raise ConfigError(
                f"--levels frames.size={level}: a size in px, or a share of the longest side up to 1.0, is expected"
            )
        same = own is not None and min(own, longest) == min(px, longest)
        out.append(own if same else None if px >= longest else px)
    return out


def level_settings(context: Context, values: Mapping[str, Any]) -> Any:
    """The sequence's settings with the levels of some knobs; nothing is dropped in a variant."""
    partial: dict[str, Any] = {"run": {"keep": "everything"}}
    for knob, value in values.items():
        stage, _, key = knob.partition(".")
        partial.setdefault(stage, {})[key] = value
    settings = {**merge(context.settings.model_dump(), partial), "keep": {}}
    try:
        return Settings.model_validate(settings)
    except ValidationError as e:
        faults = faults_of(e, settings, lambda at: "unknown key")
        raise ConfigError("; ".join(f"--levels {dotted(at)}: {what}" for at, what in faults)) from e


class Clock:
    """Seconds of stages, by what they made."""

    def __init__(
        self, session: Session, fact: Literal["seconds", "cpu_seconds"] = "seconds", frames: int | None = None
    ) -> None:
        """No times yet; `fact` of the receipts says which seconds: by the clock, or of processors. What is done once a
        sequence is shared by its `frames`; None: by those of a level, which are all of them."""
        self.session, self.fact, self.frames = session, fact, frames
        self.times: dict[tuple[str, str], list[float]] = defaultdict(list)
        self._warm: set[tuple[str, str]] = set()

    def run(self, level: Level, force: frozenset[str] = frozenset()) -> None:
        """Run what is not fresh and what is forced; note the seconds of every stage that ran whole. Raises UserError
        when a task fails.

        A stage that runs for the first time in this process loads libraries, weights and kernels, which it does not do
        again: it is run once more, and that counts.
        """
        if cold := self._run(level, force):
            self._run(level, cold)

    def is_warm(self, level: Level, stage: str) -> bool:
        """Whether a stage ran in this process under the level's knobs of its own; what is made once a sequence always
        counts as if."""
        return stage_named(stage).sequence_wide or (stage, _own_knobs(level, stage)) in self._warm

    def _run(self, level: Level, force: frozenset[str]) -> frozenset[str]:
        """Run; the stages that ran whole and were cold, whose seconds are not noted."""
        from posegaussian.dags.runtime.executors.inline_run import RunFailed, run_here

        idle = level.context.unneeded()
        selection = Selection(frozenset(s.name for s in STAGES if s.name not in (MEASURES, *idle)), None, force)
        seconds: dict[str, dict[Task, float]] = defaultdict(dict)
        plan, run = make_plan(level.context, selection), self.session.configuration.default.run
        try:
            for task, receipt in run_here(plan, selection, run.threads, say=self.session.say_line).items():
                seconds[task.stage][task] = self._of(receipt)
        except RunFailed as e:
            raise UserError(f"tradeoff: {level.label()}: {e}") from e
        level.identities = identities(level.context)
        # a stage that a choice left without a reader is no part of the level
        whole = [
            s
            for s, of in seconds.items()
            if s in level.identities and all(t in of for t in plan.verdicts if t.stage == s)
        ]
        cold = frozenset(s for s in whole if not self.is_warm(level, s))
        self._warm |= {(s, _own_knobs(level, s)) for s in seconds}
        for stage in whole:
            if stage not in cold:
                self.times[stage, level.identities[stage]].append(sum(seconds[stage].values()))
        return cold

    def measure(self, levels: Sequence[Level], repeats: int) -> None:
        """Run every level once, then what differs between them until it has `repeats` times;
        fills in seconds a frame. Raises UserError where nobody is in what levels are compared with: after the first."""
        from posegaussian.dags.diagnostics.held_out_quality import require_subject

        for i, level in enumerate(levels):
            self.session.say([f"level {i + 1} of {len(levels)}: {level.label()}"])
            share(level.context, others(_origin(level.context)))
            self.run(level)
            require_subject(level.context)
        differing = {
            s for level in levels for s in level.identities if len({other.identities.get(s) for other in levels}) > 1
        }
        for i in range(repeats):
            self.session.say([f"timing {', '.join(sorted(differing))}: {i + 1} of {repeats}"])
            for level in levels:
                force = frozenset(
                    s for s in differing & level.identities.keys() if len(self.times[s, level.identities[s]]) <= i
                )
                if force:
                    self.run(level, force)
        for level in levels:
            level.seconds = self.seconds(level)

    def seconds(self, level: Level) -> dict[str, float]:
        """{stage: seconds a frame}: the median of the measured times,
        or the sum over the receipts of a stage taken over."""
        once: dict[str, float] = defaultdict(float)
        for task, receipt in Book.open(level.context).receipts.items():
            once[task.stage] += self._of(receipt)
        own = level.context.grid.frames
        return {
            s: (statistics.median(t) if (t := self.times.get((s, i))) else once[s])
            / (self.frames or own if stage_named(s).sequence_wide else own)
            for s, i in level.identities.items()
        }

    def _of(self, receipt: Receipt) -> float:
        """Seconds of one task."""
        return steady_seconds(receipt.facts) if self.fact == "seconds" else float(receipt.facts.get(self.fact, 0.0))


def _own_knobs(level: Level, stage: str) -> str:
    """The level's values of a stage's own knobs: with others it may load other libraries and kernels."""
    return str({k: v for k, v in level.values.items() if k.startswith(f"{stage}.")})


def _origin(context: Context) -> SequenceGroup:
    """The user's sequence of a variant."""
    root = context.sequence.root
    return SequenceGroup(root.parents[2] / root.name)


def identities(context: Context) -> dict[str, str]:
    """{stage: digest of what its tasks depend on} of the stages that make pictures; every task has a receipt."""
    plan = make_plan(context)
    found: dict[str, list[Any]] = defaultdict(list)
    for task in plan.verdicts:
        if task.stage != MEASURES:
            found[task.stage].append([*task[1:4], plan.book.receipts[task].fingerprint])
    return {stage: digest(parts) for stage, parts in found.items()}


def with_truth(session: Session, name: str) -> Context:
    """The sequence with the path of its held-out cameras. Raises UserError where it has none."""
    own = Context(session.archive.sequence(name), session.configuration.for_sequence(name), ())
    if not own.held_out:
        raise UserError(
            f"tradeoff: sequence {name} has no held-out truth to measure against; name cameras to keep aside, for"
            f" example --set 'views.held_out=[{own.capture.rig.names[-1]}]'"
        )
    return session.context(name, PATH)


def measured(
    session: Session, name: str, knobs: Sequence[str], texts: Sequence[str], repeats: int
) -> tuple[list[Level], int]:
    """Run and measure every combination of levels; (levels, longest side in px at which quality was measured).

    Raises UserError without held-out cameras, ConfigError for knobs, levels and settings that cannot be.
    """
    from posegaussian.dags.diagnostics.held_out_quality import quality

    origin = with_truth(session, name)
    chosen = chosen_levels(origin, knobs, texts)
    combinations = [dict(zip(chosen, values, strict=True)) for values in itertools.product(*chosen.values())]
    if len(combinations) < 2:
        raise ConfigError(
            f"tradeoff: {', '.join(f'{k}={v[0]}' for k, v in chosen.items())} is a single level on this capture; give"
            " more with --levels KNOB=LEVEL,LEVEL"
        )
    threads.limit(session.configuration.default.run.threads)
    levels = [Level(v, settled_variant(origin.sequence, level_settings(origin, v), v, PATH)) for v in combinations]
    Clock(session).measure(levels, repeats)
    reference = max(levels, key=lambda level: int(level.context.rig.size.max())).context
    for level in levels:
        level.quality = quality(level.context, reference)
        ledger.rebuild(Archive(level.context.sequence.root.parent))  # plans of this archive learn from these times, too
    return sorted(levels, key=lambda level: level.total), int(reference.rig.size.max())


def machine(threads_each: int) -> str:
    """The machine the times were taken on, as one line: processor, cores, threads, host."""
    import os

    model = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.is_file():
        named = [
            line.partition(":")[2].strip() for line in info.read_text().splitlines() if line.startswith("model name")
        ]
        model = named[0] if named else model
    return f"{model}, {os.cpu_count()} cores, {number(threads_each, 'thread')} a task, host {platform.node()}"


def rows(levels: Sequence[Level]) -> list[dict[str, Any]]:
    """One row a level: knobs, seconds a frame by stage and in all, quality,
    and whether it is on the front of `psnr box`."""
    stages = [s.name for s in STAGES if any(s.name in level.seconds for level in levels)]
    names = [q for q in QUALITIES if all(q in level.quality for level in levels)]
    out = []
    for level, on_front in zip(levels, front(levels, "psnr box"), strict=True):
        seconds = {f"{stage} s/frame": level.seconds.get(stage, 0.0) for stage in stages}
        knobs: dict[str, Any] = {k: "full" if v is None else str(v) for k, v in level.values.items()}
        values = {q if QUALITIES[q].unit == "1" else f"{q} {QUALITIES[q].unit}": level.quality[q] for q in names}
        out.append({**knobs, **seconds, "total s/frame": level.total, **values, "front": on_front})
    return out


def as_lines(found: Sequence[Mapping[str, Any]]) -> list[str]:
    """The rows as aligned text, cheapest first, numbered as in the picture; those on the front have a star."""
    columns = [c for c in found[0] if c != "front"]
    heads = [
        ["", *(c.removesuffix(" s/frame") for c in columns)],
        ["", *("s/frame" if c.endswith(" s/frame") else "" for c in columns)],
    ]
    cells = [
        [
            f"{i + 1}{'*' if row['front'] else ' '}",
            *(v if isinstance(v := row[c], str) else f"{v:.3f}" for c in columns),
        ]
        for i, row in enumerate(found)
    ]
    widths = [max(len(line[i]) for line in [*heads, *cells]) for i in range(len(columns) + 1)]
    lines = [
        "  ".join(text.rjust(w) for text, w in zip(line, widths, strict=True)).rstrip() for line in [*heads, *cells]
    ]
    return [*lines, "* on the Pareto front of total seconds and box PSNR"]


def write_parquet(file: Path, found: Sequence[Mapping[str, Any]], about: Mapping[str, str]) -> None:
    """The rows as Parquet; `about` goes into the file's metadata."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = pa.Table.from_pylist([dict(r) for r in found])
    sink = pa.BufferOutputStream()
    pq.write_table(table.replace_schema_metadata(dict(about)), sink)
    write_atomically(file, sink.getvalue().to_pybytes())


def run_tradeoff(
    session: Session,
    sequence: str | None,
    knobs: Sequence[str],
    texts: Sequence[str],
    repeats: int,
    output: Path | None,
) -> list[Level]:
    """The command: measure, print the table, write tradeoff.parquet and tradeoff.png;
    returns the levels, cheapest first."""
    name = only_sequence(session, sequence)
    levels, size = measured(session, name, knobs, texts, repeats)
    present(session, name, levels, size, repeats, output)
    return levels


def only_sequence(session: Session, sequence: str | None) -> str:
    """The one that is meant. Raises ConfigError for several."""
    names = session.names([sequence] if sequence else ())
    if len(names) != 1:
        raise ConfigError(
            f"tradeoff works on one sequence; say which with --sequence, the archive has {', '.join(names)}"
        )
    return names[0]


def present(session: Session, name: str, levels: Sequence[Level], size: int, repeats: int, output: Path | None) -> None:
    """Print the table of levels, cheapest first, measured at `size` px and timed so often; write it, and its
    picture."""
    from posegaussian.dags.tradeoff.figure import draw

    context = levels[0].context
    where = machine(session.configuration.default.run.threads)
    taken = f"medians of {repeats}" if repeats > 1 else "single runs"
    what = (
        f"{name}: {number(context.grid.frames, 'frame')}, {len(context.views.sources)} source views,"
        f" {len(context.views.held_out)} held-out pictures a frame, quality measured at {size} px"
    )
    file, found = table_file(name, output), rows(levels)
    session.say([what, *as_lines(found)])
    session.say([f"times are {taken} on {where}"])
    about = {
        "sequence": name,
        "machine": where,
        "repeats": str(repeats),
        "measured_at_px": str(size),
        "frames": str(context.grid.frames),
        **measured_under(context, levels[0].values),
    }
    picture = file.with_suffix(".png")
    write_parquet(file, found, about)
    draw(picture, levels, what, f"{taken} on {where}")
    session.say([f"table: {file}", f"picture: {picture}"])


def table_file(name: str, output: Path | None) -> Path:
    """Where the table of a sequence is written."""
    return (output or Path(f"tradeoff-{name}")) / "tradeoff.parquet"
