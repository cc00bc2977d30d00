"""A table of the paper with what was found here: its parts as text, and every number of them as a row."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from posegaussian.dags.humanize.latex import latex_table, latex_text
from posegaussian.dags.humanize.markdown import markdown_table
from posegaussian.dags.tradeoff.tradeoff import write_parquet
from posegaussian.storage.files.write import write_atomically

NOT_RUN = "not run"
HERE = "here: "
"""Before the name of every row that was measured here."""


@dataclass(frozen=True)
class Part:
    """One table of text."""

    title: str
    """"" where the page has one part."""
    head: list[str]
    body: list[list[str]]
    records: list[dict[str, Any]]
    """Of every number: row, column, data_set, method, region, text, value, definition, and `source`, paper or here."""


@dataclass(frozen=True)
class Page:
    """All that `evaluate --paper NAME` says."""

    name: str
    title: str
    label: str
    """The place in the paper."""
    parts: list[Part]
    told: list[str]
    """Sentences: what is comparable, the protocol, why something was not run."""
    status: int = 0
    """Exit status of what was run for it."""


def record(row: str, column: str, text: str, definition: str, **more: Any) -> dict[str, Any]:
    """A number as a row of the Parquet file; its value is None where the text is no number."""
    empty: dict[str, Any] = dict.fromkeys(("data_set", "sequence", "method", "region", "value"))
    with suppress(ValueError):
        empty["value"] = float(text)
    return {"row": row, "column": column, "text": text, "definition": definition, "source": "here", **empty, **more}


def printed(row: str, label: str, head: list[str], cells: Mapping[str, str], **more: Any) -> list[dict[str, Any]]:
    """Records of what the paper prints in a row."""
    told = f"as printed in {label}"
    return [record(row, c, cells[c], told, source="paper", method=row, **more) for c in head if c in cells]


def markdown(page: Page) -> list[str]:
    """Lines of the page."""
    named = any(text.startswith(HERE) for part in page.parts for line in (part.head, *part.body) for text in line)
    ours = f" What begins with `{HERE.strip()}` was measured here." if named else ""
    lines = [f"# {page.title}", "", f"The paper: {page.label}.{ours}"]
    for part in page.parts:
        lines += ["", *([f"## {part.title}", ""] if part.title else []), *markdown_table(part.head, part.body)]
    return [*lines, *(line for told in page.told for line in ("", told))]


def latex(page: Page) -> list[str]:
    """The same as one LaTeX table, a tabular a part."""
    lines = [r"\begin{table*}[t]", r"\centering"]
    for part in page.parts:
        lines += [rf"\textbf{{{latex_text(part.title)}}}\\"] if part.title else []
        lines += [*latex_table(part.head, part.body), r"\par\medskip"]
    caption = latex_text(f"{page.title}. {' '.join(page.told)}")
    return [*lines, rf"\caption{{{caption}}}", r"\end{table*}"]


def write(page: Page, output: Path) -> str:
    """Write it as Markdown, LaTeX and Parquet; returns where. Raises NotWritten."""
    write_atomically(output / f"{page.name}.md", "\n".join([*markdown(page), ""]).encode())
    write_atomically(output / f"{page.name}.tex", "\n".join([*latex(page), ""]).encode())
    rows = [{"table": page.name, "part": part.title, **r} for part in page.parts for r in part.records]
    write_parquet(output / f"{page.name}.parquet", rows, {"label": page.label, "told": "\n".join(page.told)})
    return f"table: {output / page.name}.md, .tex and .parquet (with every number's definition)"
