"""Tables as Markdown."""

from __future__ import annotations

from collections.abc import Sequence


def markdown_table(head: Sequence[str], body: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a Markdown table with even columns, whatever its texts hold."""
    lines = [[" ".join(text.splitlines()).replace("|", r"\|") for text in line] for line in (head, *body)]
    widths = [max(len(line[i]) for line in lines) for i in range(len(head))]
    rows = ["| " + " | ".join(text.ljust(w) for text, w in zip(line, widths, strict=True)) + " |" for line in lines]
    return [rows[0], "| " + " | ".join("-" * w for w in widths) + " |", *rows[1:]]
