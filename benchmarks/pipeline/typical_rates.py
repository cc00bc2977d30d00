"""What tasks of every stage take and write, from the finished ones of some archives, for estimates without a history.

    python -m benchmarks.pipeline.typical_rates ARCHIVE...

Seconds of one core per unit of work (frames x views x pixels): the median of processor time over the tasks' work. Ratio
of bytes on disk to bytes before compression: the highest of the archives, since small pictures are pressed least. The
`typical` of each `stages/NAME/stage.py` holds them, rounded up.
"""

from __future__ import annotations

import argparse
import statistics
from collections import defaultdict
from collections.abc import Sequence

from posegaussian.stages.registry import STAGES
from posegaussian.storage.archive.ledger import row
from posegaussian.storage.archive.receipts import Receipt, scan_receipts
from posegaussian.storage.archive.store import Archive


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a line a stage."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("archives", nargs="+", metavar="ARCHIVE")
    found: dict[str, list[list[Receipt]]] = defaultdict(list)
    for url in parser.parse_args(arguments).archives:
        archive, of_stage = Archive.open(url), defaultdict(list)
        for receipt in (r for name in archive.names() for r in scan_receipts(archive.sequence(name))):
            of_stage[receipt.stage].append(receipt)
        for stage, receipts in of_stage.items():
            found[stage].append(receipts)
    for s in (s for s in STAGES if s.name in found):
        counted = [r.facts for of_one in found[s.name] for r in of_one if r.facts.get("unit") == s.unit.name]
        rates = [f["cpu_seconds"] / f["work"] for f in counted if f["work"]]
        seconds = f"{statistics.median(rates):.1e} s, median of {len(rates)} tasks" if rates else "no task of its unit"
        print(f"{s.name:<11} {seconds}; ratio {max(map(ratio, found[s.name])):.2f}")


def ratio(receipts: list[Receipt]) -> float:
    """Bytes on disk over bytes before compression of an archive's tasks of one stage; 0 where none are projected."""
    raw = sum(r.facts.get("raw_bytes") or 0 for r in receipts)
    return sum(row("", r)["bytes"] for r in receipts) / raw if raw else 0.0


if __name__ == "__main__":
    main()
