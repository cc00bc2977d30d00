"""The results as a table: Markdown, LaTeX, and rows of a Parquet file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any

from posegaussian.dags.evaluation.measured import Number
from posegaussian.dags.evaluation.results import Key, Result, keys
from posegaussian.dags.humanize.latex import latex_text
from posegaussian.dags.humanize.markdown import markdown_table
from posegaussian.dags.humanize.text import number
from posegaussian.stages.metrics.measures.registry import METRICS

NOT_RUN = "not run"
NOT_MEASURED = "no picture of it has one"
COSTS = {
    "ms_a_frame": ("ms a frame", "lower"),
    "frames_a_second": ("frames/s", "higher"),
    "drawing": ("drawing, ms a picture", "lower"),
    "once": ("once, s", "lower"),
    "optimised": ("optimised, s a frame", "lower"),
    "trained": ("weights trained, s", "lower"),
    "gaussians": ("Gaussians a frame", ""),
}
"""{number that is none of pictures: (heading, which is better)}."""
TITLES = {"delta_ssim": "ΔSSIM"}
"""Of measures whose title is long."""


@dataclass(frozen=True)
class Column:
    """One column of the table."""

    key: Key
    title: str
    """Of the measure, with its unit where that is not 1."""
    better: str
    """higher, lower or ""."""
    unit: str

    @property
    def part(self) -> str:
        """What tells it from the others of its title: the region."""
        return self.key[1]

    def text(self, result: Result) -> str:
        """The value; `-` where there is none."""
        value = result.value(self.key)
        if value is None:
            return "-"
        if self.key[0] in COSTS:
            return f"{value:.0f}" if value >= 100 else f"{value:.3g}"
        return f"{value:z.2f}" if self.unit == "dB" else f"{value:z.4f}"


def columns(results: Sequence[Result]) -> list[Column]:
    """Measures of pictures with their regions, then costs; those that have a value."""
    units = {k: n.unit for r in results for k, n in r.numbers.items() if n.value is not None}
    found = []
    for key in (k for k in keys(results) if k in units):
        better = COSTS[key[0]][1] if key[0] in COSTS else METRICS[key[0]].better
        found.append(Column(key, _title(key, units[key]), better, units[key]))
    first = {c.title: i for i, c in reversed(list(enumerate(found)))}
    return sorted(found, key=lambda c: (c.key[0] in COSTS, first[c.title]))


def _title(key: Key, unit: str) -> str:
    """Of a measure, with its unit where that is not 1."""
    measure, _, statistic = key
    if measure in COSTS:
        return COSTS[measure][0]
    of = {"deviation": "σ ", "mean": "µ "}[statistic] if METRICS[measure].change_of else ""
    return of + TITLES.get(measure, METRICS[measure].title) + ("" if unit == "1" else f", {unit}")


def markdown(results: Sequence[Result], protocol: str) -> list[str]:
    """The page: the table, one sentence on protocol, what each column is."""
    shown = columns(results)
    head = ["sequence", "method", *(f"{c.title} {c.part}".strip() for c in shown)]
    body = [[r.sequence, r.method, *_cells(r, shown)] for r in results]
    about = dict.fromkeys(f"- {r.sequence}, {r.method}: {NOT_RUN}: {r.why}." for r in results if not r.numbers)
    about |= dict.fromkeys(f"- {sentence}" for sentence in _without_column(results, shown))
    about |= dict.fromkeys(line for r in results if r.numbers for line in _missing(r, shown))
    about |= dict.fromkeys(f"- {sentence}" for sentence in _qualified(results, shown))
    return [*markdown_table(head, body), "", protocol, *(["", *about] if about else [])]


def _without_column(results: Sequence[Result], shown: Sequence[Column]) -> list[str]:
    """Why numbers that no line has are none, the regions of one reason together."""
    found: dict[tuple[str, str], dict[str, None]] = {}
    for r in results:
        for key, n in r.numbers.items():
            if n.value is None and key not in {c.key for c in shown}:
                found.setdefault((_title(key, n.unit), n.definition), {})[key[1]] = None
    return [f"{title} {', '.join(regions)}".strip() + f": {why}." for (title, why), regions in found.items()]


def _qualified(results: Sequence[Result], shown: Sequence[Column]) -> list[str]:
    """What numbers are not of: pictures that have none, and what is hidden in others."""
    told = []
    for r in results:
        found: dict[str, list[str]] = {}
        for c in shown:
            if c.key in r.numbers and (partly := r.numbers[c.key].partly):
                found.setdefault(partly, []).append(f"{c.title} {c.part}".strip())
        told += [f"{r.sequence}, {r.method}: {'; '.join(of)}: {partly}." for partly, of in found.items()]
    for r in results:
        pictures = number(r.hidden, "held-out picture")
        told += [f"{r.sequence}: hidden pixels are left out of {pictures}."] if r.hidden else []
    for r in results:
        pictures, agreeing = number(r.empty, "held-out picture"), "is" if r.empty == 1 else "are"
        told += [f"{r.sequence}: nobody is in {pictures}, which {agreeing} not measured."] if r.empty else []
    return list(dict.fromkeys(told))


def _missing(result: Result, shown: Sequence[Column]) -> list[str]:
    """Why cells of a line are empty, those with one reason together."""
    found: dict[str, list[str]] = {}
    for c in shown:
        if result.value(c.key) is None:
            why = result.numbers[c.key].definition if c.key in result.numbers else NOT_MEASURED
            found.setdefault(why, []).append(f"{c.title} {c.part}".strip())
    return [f"- {result.sequence}, {result.method}: {'; '.join(of)}: {why}." for why, of in found.items()]


def definitions(results: Sequence[Result]) -> list[str]:
    """A line of Markdown for every column: what exactly it is."""
    told = {}
    for c in columns(results):
        first = next(r.numbers[c.key] for r in results if r.value(c.key) is not None)
        told[c.key] = f"- {f'{c.title} {c.part}'.strip()}: {first.definition}."
    return list(dict.fromkeys(told.values()))


def _cells(result: Result, shown: Sequence[Column]) -> list[str]:
    if not result.numbers:
        return [NOT_RUN, *("" for _ in shown[1:])]
    return [c.text(result) for c in shown]


def latex(results: Sequence[Result], protocol: str) -> list[str]:
    """A table for booktabs: a heading over the regions of each measure, its arrow to the better side."""
    shown = columns(results)
    caption = " ".join([protocol, *_qualified(results, shown)])
    groups = [(t, [c for c in shown if c.title == t]) for t in dict.fromkeys(c.title for c in shown)]
    arrows = {"higher": r" $\uparrow$", "lower": r" $\downarrow$", "": ""}
    heads = [rf"\multicolumn{{{len(of)}}}{{c}}{{{latex_text(t)}{arrows[of[0].better]}}}" for t, of in groups]
    lines = [
        r"\begin{table*}[t]",
        r"\centering",
        r"\resizebox{\textwidth}{!}{%",
        rf"\begin{{tabular}}{{ll{'|'.join('r' * len(of) for _, of in groups)}}}",
        r"\toprule",
        " & ".join(["", "", *heads]) + r" \\",
        " & ".join(["Sequence", "Method", *(latex_text(c.part) for c in shown)]) + r" \\",
    ]
    before = None
    for r in results:
        lines += [r"\midrule"] if r.sequence != before else []
        name, before = ("" if r.sequence == before else latex_text(r.sequence)), r.sequence
        if r.numbers:
            cells = [latex_text(text) for text in _cells(r, shown)]
        else:
            cells = [rf"\multicolumn{{{len(shown)}}}{{c}}{{{NOT_RUN}}}"]
        lines.append(" & ".join([name, latex_text(r.method), *cells]) + r" \\")
    return [*lines, r"\bottomrule", r"\end{tabular}%", "}", rf"\caption{{{latex_text(caption)}}}", r"\end{table*}"]


def rows(results: Sequence[Result]) -> list[dict[str, Any]]:
    """A row a number, with its unit, definition and count; of what was not run one row that says why."""
    found = []
    for r in results:
        about = {"sequence": r.sequence, "data_set": r.data_set, "method": r.method}
        found += [{**about, **asdict(n), "definition": n.told} for n in r.numbers.values()]
        if not r.numbers:
            none = dict.fromkeys(f.name for f in fields(Number))
            found.append({**about, **none, "definition": f"{NOT_RUN}: {r.why}", "count": 0})
    return found
