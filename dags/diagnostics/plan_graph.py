"""A plan as a picture: stages and arrays with their states and counts, as SVG or as Mermaid text.

Stages go down a staircase in the order of flow, each with the arrays it writes. An array's line leaves to the right and
turns down, at a dot, into every stage that reads it; crossings without a dot are no connection. So no line ever runs
behind a card, however many stages there are.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from xml.sax.saxutils import escape, quoteattr

from posegaussian.dags.planning.plan import Plan, State
from posegaussian.stages.registry import STAGES
from posegaussian.storage.files.write import write_atomically
from posegaussian.storage.model.spec import ArraySpec

CARD, STEP, HEAD, ROW, GAP, MARGIN, TOP = 236, 172, 62, 21, 18, 24, 88
"""Lengths in px: width of a card, distance of two cards, a card's head, a row, the gap below, the border, the title."""

COLORS = {
    State.FRESH: "#2f9e63",
    State.STALE: "#e0841a",
    State.UNDECIDED: "#5f7fb8",
    State.KEPT: "#7a9e2f",
    None: "#b4b9c1",
}
"""By state; None: not needed, or nothing there."""


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
class Card:
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


def cards(plans: Sequence[Plan]) -> list[Card]:
    """The stages, in the order of flow, with what all plans together say of them and of their arrays."""
    out: list[Card] = []
    for stage in STAGES:
        card = Card(stage.name, arrays=[Array(w.name) for w in stage.writes])
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


def _count_shards(card: Card, plan: Plan) -> None:
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
    """Write the picture of some plans; the name's end, one of WRITERS, decides the format."""
    text = WRITERS[file.suffix.lower()](cards(plans), title(plans))
    write_atomically(file, (f"```mermaid\n{text}```\n" if file.suffix.lower() == ".md" else text).encode())
    return file


def title(plans: Sequence[Plan]) -> str:
    """Which sequences, how long."""
    some = [
        f"{p.context.sequence.name} ({p.context.grid.frames} frames in {len(p.context.grid.partitions)} partitions)"
        for p in plans[:3]
    ]
    return ", ".join(some) + (f" and {len(plans) - 3} more sequences" if len(plans) > 3 else "")


def mermaid(drawn: Sequence[Card], heading: str) -> str:
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


def svg(drawn: Sequence[Card], heading: str) -> str:
    """The graph as a standalone SVG file."""
    tops, y = [], TOP
    for c in drawn:
        tops.append(y)
        y += HEAD + ROW * len(c.arrays) + GAP
    width, height = MARGIN * 2 + STEP * (len(drawn) - 1) + CARD, y + MARGIN
    body = [
        _legend(heading),
        *_edges(drawn, tops),
        *(_card(c, MARGIN + STEP * i, tops[i]) for i, c in enumerate(drawn)),
    ]
    style = "text{font-family:Helvetica,Arial,'DejaVu Sans',sans-serif;fill:#1d2430}"
    opening = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}">'
    )
    return "\n".join(
        [
            opening,
            f"<title>{escape(heading)}</title>",
            f"<style>{style}</style>",
            f'<rect width="{width}" height="{height}" fill="#ffffff"/>',
            *body,
            "</svg>",
            "",
        ]
    )


def _text(x: float, y: float, text: str, size: int = 12, extra: str = "", whole: str = "") -> str:
    """One line of text; `whole` is shown when the pointer rests on it."""
    return (
        f'<text x="{x:g}" y="{y:g}" font-size="{size}"'
        f" {extra}>{escape(text)}{f'<title>{escape(whole)}</title>' if whole else ''}</text>"
    )


def _legend(heading: str) -> str:
    parts = [_text(MARGIN, 34, heading, 18, 'font-weight="bold"')]
    x = MARGIN
    for state, words in (
        (State.FRESH, "fresh: nothing to do"),
        (State.STALE, "stale: will run"),
        (State.UNDECIDED, "undecided: runs if its input changes"),
        (State.KEPT, "kept: taken over"),
        (None, "not needed"),
    ):
        parts += [
            f'<rect x="{x}" y="50" width="14" height="14" rx="3" fill="{COLORS[state]}"/>',
            _text(x + 20, 62, words, 13),
        ]
        x += 44 + round(7.0 * len(words))
    return "".join(parts)


def _edges(drawn: Sequence[Card], tops: Sequence[int]) -> list[str]:
    """From every array right to a dot above each reader, and down into it."""
    lines = []
    place = {c.name: i for i, c in enumerate(drawn)}
    taken: Counter[str] = Counter()
    for i, c in enumerate(drawn):
        for row, a in enumerate(c.arrays):
            color = COLORS[c.state]
            start, y = MARGIN + STEP * i + CARD, tops[i] + HEAD + ROW * row + ROW / 2
            ends = []
            for reader in a.readers:
                j = place[reader]
                x = MARGIN + STEP * j + CARD - 14 - 15 * taken[reader]
                taken[reader] += 1
                ends.append(x)
                lines.append(f'<path d="M{x} {y:g}V{tops[j] - 2}" stroke="{color}" stroke-width="1.6" fill="none"/>')
                lines.append(
                    f'<path d="M{x - 4} {tops[j] - 9}L{x} {tops[j] - 1}L{x + 4} {tops[j] - 9}Z" fill="{color}"/>'
                )
                lines.append(f'<circle cx="{x}" cy="{y:g}" r="3" fill="{color}"/>')
            if ends:
                lines.append(f'<path d="M{start} {y:g}H{max(ends)}" stroke="{color}" stroke-width="1.6" fill="none"/>')
    return lines


def _card(c: Card, x: int, y: int) -> str:
    color, height = COLORS[c.state], HEAD + ROW * len(c.arrays)
    parts = [
        f'<rect x="{x}" y="{y}" width="{CARD}" height="{height}" rx="7" fill="#ffffff" stroke="{color}"'
        ' stroke-width="2"/>'
    ]
    parts.append(_text(x + 12, y + 22, c.name, 15, 'font-weight="bold"'))
    if c.sources:
        parts.append(
            _text(x + CARD - 10, y + 21, "files: " + ", ".join(c.sources), 10, 'text-anchor="end" fill-opacity="0.7"')
        )
    parts.append(_text(x + 12, y + 39, _fit(c.note(), CARD - 24, 11), 11, 'fill-opacity="0.85"', c.note()))
    at, total = float(x + 12), c.counts.total()
    for state in State:
        share = (CARD - 24) * c.counts[state] / total if total else 0.0
        if share:
            parts.append(f'<rect x="{at:.1f}" y="{y + 46}" width="{share:.1f}" height="6" fill="{COLORS[state]}"/>')
        at += share
    if not total:
        parts.append(f'<rect x="{x + 12}" y="{y + 46}" width="{CARD - 24}" height="6" fill="{COLORS[None]}"/>')
    for row, a in enumerate(c.arrays):
        middle = y + HEAD + ROW * row + ROW / 2
        faint = "" if a.total else 'fill-opacity="0.4"'
        parts.append(
            f'<rect x="{x + 6}" y="{middle - 8.5:g}" width="{CARD - 12}" height="17" rx="4" fill="{color}"'
            f' fill-opacity="{0.13 if a.total else 0.05}"/>'
        )
        parts.append(_text(x + 12, middle + 4, a.name, 11, faint))
        parts.append(
            _text(x + CARD - 12, middle + 4, a.note() if a.total else "not made", 10, f'text-anchor="end" {faint}')
        )
    return "".join(parts)


def _fit(text: str, width: float, size: int) -> str:
    """The text, cut where it would leave the card (a letter is 0.58 times as wide as its size)."""
    most = int(width / (0.58 * size))
    return text if len(text) <= most else text[: most - 1].rstrip() + "…"


WRITERS = {".svg": svg, ".md": mermaid, ".mmd": mermaid}
"""By ending: a picture, or Mermaid text."""
