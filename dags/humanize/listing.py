"""Rows for the terminal: a table whose columns break no word, and where it is too narrow for one, line by line."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

LONGEST_WORD = 24
"""Characters of a word beyond which it is folded: a path, a setting."""
BETWEEN = 2
"""Columns of the terminal between two columns of a table, and one at its end."""


def listing(
    head: Sequence[str], rows: Sequence[Sequence[str]], width: int, title: str = "", whole: Collection[str] = ()
) -> Table:
    """Rows of cells (markup) under their heads, in `width` columns of the terminal.

    Cells wrap at spaces, those of the columns that are named `whole` nowhere. Where words do not fit side by side,
    every row becomes lines of `head  cell`, and an empty line follows.
    """
    columns = [[Text(name), *(Text.from_markup(row[i]) for row in rows)] for i, name in enumerate(head)]
    full = [max(line.cell_len for cell in column for line in cell.split(allow_blank=True)) for column in columns]
    words = [max((Text(w).cell_len for cell in column for w in cell.plain.split()), default=0) for column in columns]
    least = [
        of_all if name in whole else min(of_word, LONGEST_WORD)
        for name, of_all, of_word in zip(head, full, words, strict=True)
    ]
    room = width - sum(least) - BETWEEN * len(head) - 1
    table = Table(
        title=title or None, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0), show_header=room >= 0
    )
    if room < 0:
        table.add_column(style="bold", no_wrap=True)
        table.add_column(overflow="fold")
        for number, row in enumerate(rows):
            for name, cell in zip(head, row, strict=True):
                table.add_row(name, cell)
            if number < len(rows) - 1:
                table.add_row()
        return table
    for name, wide in zip(head, _shared(least, full, room), strict=True):
        table.add_column(name, width=wide, overflow="fold", justify="right" if name in whole else "left")
    for row in rows:
        table.add_row(*row)
    return table


def _shared(least: Sequence[int], full: Sequence[int], room: int) -> list[int]:
    """Widths of columns: what each needs at least, and its share of the room, no more than it can use; those that want
    least come first, so that what they leave goes to the others."""
    found = list(least)
    order = sorted(range(len(least)), key=lambda i: full[i] - least[i])
    for place, i in enumerate(order):
        more = min(full[i] - least[i], room // (len(order) - place))
        found[i] += more
        room -= more
    return found
