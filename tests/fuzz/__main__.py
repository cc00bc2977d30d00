"""`make fuzz`: every reader on hundreds of spoilt files; exit status 1 where one does anything but work or refuse
with a sentence."""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from posegaussian.dags.runtime import threads
from tests.fuzz.formats import formats
from tests.fuzz.pool import Outcome, make_wholes, run

COLUMNS = ("accepted", "refused", "traceback", "hang", "memory", "outside", "died")
GOOD = ("accepted", "refused")
EXAMPLES = 3
"""Faults of one kind that are told."""


def main() -> int:
    """Run, print the table, return the exit status."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--variants", type=int, default=300, help="of each format")
    parser.add_argument("--only", default="", help="formats whose names contain this")
    parser.add_argument("--index", type=int, help="one variant alone, told in full")
    parser.add_argument("--workers", type=int, default=2)
    chosen = parser.parse_args()
    rows = [f for f in formats() if chosen.only in f.name]
    start = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="fuzz-") as work:
        make_wholes(rows, Path(work), chosen.workers)
        indices = range(chosen.variants) if chosen.index is None else [chosen.index]
        outcomes = list(run(rows, [(f.name, n) for f in rows for n in indices], Path(work), chosen.workers))
    if chosen.index is not None:
        print(*outcomes, sep="\n")
    print(table([f.name for f in rows], outcomes))
    faults = [o for o in outcomes if o.how not in GOOD]
    print(*told(faults), sep="\n")
    print(
        f"{len(outcomes)} variants in {time.monotonic() - start:.0f} s, slowest "
        f"{max(o.seconds for o in outcomes):.1f} s, largest {max(o.grown for o in outcomes) / 1e6:.0f} MB: "
        f"{len(faults)} faults"
    )
    return 1 if faults else 0


def table(names: list[str], outcomes: list[Outcome]) -> str:
    """Totals of each format, as Markdown."""
    lines = [f"| format | variants | {' | '.join(COLUMNS)} | slowest s | MB |", "|" + " --- |" * (len(COLUMNS) + 4)]
    for name in names:
        found = [o for o in outcomes if o.format == name]
        count = Counter(o.how for o in found)
        lines.append(
            f"| {name} | {len(found)} | {' | '.join(str(count[c]) for c in COLUMNS)} | "
            f"{max((o.seconds for o in found), default=0):.1f} | "
            f"{max((o.grown for o in found), default=0) / 1e6:.0f} |"
        )
    count = Counter(o.how for o in outcomes)
    return "\n".join([*lines, f"| all | {len(outcomes)} | {' | '.join(str(count[c]) for c in COLUMNS)} | | |"])


def told(faults: list[Outcome]) -> list[str]:
    """Some of each kind of fault, by where it was."""
    kinds: dict[str, list[Outcome]] = {}
    for o in faults:
        kinds.setdefault(f"{o.how} {o.said.partition(': ')[0]}", []).append(o)
    return [
        f"{o.format} --index {o.index} [{o.damage}] {o.how} ({len(found)} alike): {o.said}"
        for found in kinds.values()
        for o in found[:EXAMPLES]
    ]


if __name__ == "__main__":
    threads.limit(1)
    sys.exit(main())
