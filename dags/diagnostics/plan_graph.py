"""A plan as a picture: stages and arrays with their states and counts, as a chart in SVG or as Mermaid text.

In the chart stages are columns in the order of flow, and below each other with the arrays they write, a line an array.
So no line crosses another, however many stages there are.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape, quoteattr

from posegaussian.dags.humanize.text import number
from posegaussian.dags.planning.plan import Plan, State
from posegaussian.stages.registry import STAGES
from posegaussian.storage.files.write import write_atomically
from posegaussian.storage.model.spec import ArraySpec

COLUMN, ROW, HEAD, LABELS = 0.5, 0.2, 1.4, 8.5
"""Inches: distance of two stages, of two lines, what is above the first; then columns that the words at the left
take."""

COLORS = {
    State.FRESH: "#2f9e63",
    State.STALE: "#e0841a",
    State.UNDECIDED: "#5f7fb8",
    State.KEPT: "#7a9e2f",
    None: "#b4b9c1",
}
"""By state; None: not needed, or nothing there."""
LEGEND = {
    State.FRESH: "fresh: nothing to do",
    State.STALE: "stale: will run",
    State.UNDECIDED: "undecided: runs if its input changes",
    State.KEPT: "kept: taken over",
    None: "not needed",
}
"""What the colours say."""


@dataclass
class Array:
    """One array or table of the picture."""

    name: str
    there: int = 0
    """Shards that are there."""
    dropped: int = 0
    """Shards that were given up and can be made again."""
    total: int = 0
    """Shards of a finished sequence."""
    size: int = 0
    """Bytes on disk."""
    readers: list[str] = field(default_factory=list)
    """Stages that read it under these settings."""

    def note(self) -> str:
        """Counts and size, a few words."""
        words = [
            f"{self.there}/{self.total}",
            *([f"{self.dropped} dropped"] if self.dropped else []),
            *([size_text(self.size)] if self.size else []),
        ]
        return " · ".join(words)


@dataclass
class StageCard:
    """One stage of the picture."""

    name: str
    counts: Counter[State] = field(default_factory=Counter)
    """Tasks by state, over all sequences."""
    unneeded: str | None = None
    """Why no sequence needs it."""
    sources: list[str] = field(default_factory=list)
    """Source files it opens."""
    arrays: list[Array] = field(default_factory=list)

    @property
    def state(self) -> State | None:
        """The state that decides the colour: the least finished one."""
        return next((s for s in (State.STALE, State.UNDECIDED, State.KEPT, State.FRESH) if self.counts[s]), None)

    def note(self) -> str:
        """Its counts in words."""
        return (
            self.unneeded
            or ", ".join(f"{self.counts[s]} {s.value}" for s in State if self.counts[s])
            or "nothing to do"
        )

    def words(self) -> str:
        """Its counts, and the files it opens."""
        return self.note() + (f"; reads the files {', '.join(self.sources)}" if self.sources else "")


def cards(plans: Sequence[Plan]) -> list[StageCard]:
    """The stages, in the order of flow, with what all plans together say of them and of their arrays."""
    out: list[StageCard] = []
    for stage in STAGES:
        card = StageCard(stage.name, arrays=[Array(w.name) for w in stage.writes])
        for p in plans:
            card.counts += p.counts(stage)
            _count_shards(card, p)
        if not card.counts:
            card.unneeded = "not needed: " + next(
                (p.unneeded[stage.name] for p in plans if stage.name in p.unneeded),
                "no camera path with truth is asked for",
            )
        out.append(card)
    arrays = {a.name: a for c in out for a in c.arrays}
    for p in plans:
        for stage in STAGES:
            if not p.counts(stage):
                continue
            for read in stage.reads_for(p.context.params(stage), p.context.facts):
                names = (
                    next(c for c in out if c.name == stage.name).sources
                    if read.is_source
                    else arrays[read.array].readers
                )
                item = read.array if read.is_source else stage.name
                if item not in names:
                    names.append(item)
    return out


def _count_shards(card: StageCard, plan: Plan) -> None:
    stage = next(s for s in STAGES if s.name == card.name)
    written = {w.name: w for w in stage.writes_for(plan.context.facts)}
    by_name = {a.name: a for a in card.arrays}
    tasks = [t for t in plan.verdicts if t.stage == stage.name]
    for name, spec in written.items():
        views = (
            len(plan.context.rig) if isinstance(spec, ArraySpec) and spec.per_view and "view" not in stage.over else 1
        )
        by_name[name].total += len(tasks) * views
    for task in tasks:
        receipt = plan.book.receipts.get(task)
        for o in receipt.outputs if receipt and task not in plan.book.problems else ():
            array = by_name.get(o.array.replace(task.path, "{path}") if task.path else o.array)
            if array is None:
                continue
            array.dropped += o.dropped
            array.there += not o.dropped
            array.size += 0 if o.dropped else sum(f.size for f in o.files)


def size_text(size: int) -> str:
    """Bytes in the largest unit that leaves a digit before the point."""
    value, units = float(size), ["B", "kB", "MB", "GB", "TB"]
    while value >= 1000 and len(units) > 1:
        value, units = value / 1000, units[1:]
    return f"{value:.3g} {units[0]}"


def write_picture(plans: Sequence[Plan], file: Path) -> Path:
    """Write the picture of some plans; the name's end, one of ENDINGS, decides the format. Raises NotWritten."""
    drawn, words, ending = cards(plans), title(plans), file.suffix.lower()
    if ending == ".svg":
        draw(drawn, words, file)
        return file
    text = mermaid(drawn, words)
    write_atomically(file, (f"```mermaid\n{text}```\n" if ending == ".md" else text).encode())
    return file


def title(plans: Sequence[Plan]) -> str:
    """Which sequences, how long."""
    some = [
        f"{p.context.sequence.name} ({number(p.context.grid.frames, 'frame')} in"
        f" {number(len(p.context.grid.partitions), 'partition')})"
        for p in plans[:3]
    ]
    return ", ".join(some) + (f" and {number(len(plans) - 3, 'more sequence')}" if len(plans) > 3 else "")


def mermaid(drawn: Sequence[StageCard], heading: str) -> str:
    """The graph as Mermaid flowchart text, left to right."""
    lines = ["---", f"title: {quoteattr(heading)}", "---", "flowchart LR"]
    classes = {
        State.FRESH: "fresh",
        State.STALE: "stale",
        State.UNDECIDED: "undecided",
        State.KEPT: "kept",
        None: "unneeded",
    }
    for name, color in zip(classes.values(), (COLORS[s] for s in classes), strict=True):
        lines.append(f"  classDef {name} fill:{color}22,stroke:{color},color:#1d2430")
    for c in drawn:
        lines.append(f'  {c.name}["<b>{c.name}</b><br/>{_quoted(c.note())}"]:::{classes[c.state]}')
        lines += [f"  source_{s}[({s})] --> {c.name}" for s in c.sources]
        for a in c.arrays:
            if not a.total:
                continue
            key = a.name.replace("/", "_").replace("{path}", "path")
            lines.append(f'  {c.name} --> {key}(["{_quoted(a.name)}<br/>{_quoted(a.note())}"]):::{classes[c.state]}')
            lines += [f"  {key} --> {reader}" for reader in a.readers]
    return "\n".join(lines) + "\n"


def _quoted(text: str) -> str:
    return escape(text).replace('"', "#quot;").replace("{", "#123;").replace("}", "#125;")


def draw(drawn: Sequence[StageCard], words: str, file: Path) -> None:
    """Write the graph as a chart: a line an array, from the square in its writer's column to the dots in its
    readers'."""
    from posegaussian.dags.charts.style import FAINT, chart, heading

    rows = sum(1 + len(c.arrays) for c in drawn)
    columns = [c.name for c in drawn]
    with chart(file, COLUMN * (LABELS + len(columns) + 1), ROW * (rows + 2) + HEAD) as figure:
        heading(figure, words, weight="bold")
        axes = figure.subplots()
        axes.set(xlim=(-LABELS - 0.3, len(columns)), ylim=(rows - 0.4, -0.8))
        y = 0
        for x, c in enumerate(drawn):
            axes.plot([-LABELS], [y], "s", markersize=8, color=COLORS[c.state])
            axes.text(-LABELS + 0.3, y, c.name, size=10.5, weight="bold", va="center")
            axes.text(-LABELS + 2.6, y, c.words(), size=8.5, color=FAINT, va="center")
            for a in c.arrays:
                y += 1
                _array(axes, a, (x, y), [columns.index(r) for r in a.readers], COLORS[c.state])
            y += 1
        axes.set_xticks(range(len(columns)), columns, rotation=40, ha="left", rotation_mode="anchor")
        axes.set_yticks([])
        axes.xaxis.tick_top()
        axes.spines[:].set_visible(False)
        for state, meaning in LEGEND.items():
            axes.plot([], [], "s", color=COLORS[state], label=meaning)
        axes.legend(loc="upper left", bbox_to_anchor=(0, 0), ncols=len(LEGEND), handletextpad=0.2, columnspacing=1.2)


def _array(axes: Any, array: Array, at: tuple[int, int], readers: Sequence[int], color: str) -> None:
    """The line of one array, at the column of its writer."""
    x, y = at
    shown = {"color": color, "alpha": 1.0 if array.total else 0.4}
    axes.text(-LABELS + 0.3, y, array.name, size=8.5, va="center", alpha=shown["alpha"])
    note = array.note() if array.total else "not made"
    axes.text(-0.5, y, note, size=8, va="center", ha="right", alpha=shown["alpha"])
    axes.plot([x], [y], "s", markersize=8, **shown)
    if readers:
        axes.plot([x, max(readers)], [y, y], linewidth=1.3, **shown)
        axes.plot(readers, [y] * len(readers), "o", markersize=5, gid=f"readers of {array.name}", **shown)


ENDINGS = (".svg", ".md", ".mmd")
"""Endings: a chart, or Mermaid text."""
