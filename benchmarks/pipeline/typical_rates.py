"""Seconds of one core per unit of work (frames x views x pixels) by stage, from the finished tasks of some archives.

    python -m benchmarks.pipeline.typical_rates ARCHIVE...

Medians of processor time over the tasks' work; `posegaussian.dags.diagnostics.remaining_time.TYPICAL` holds them,
rounded, for runs without a history.
"""

from __future__ import annotations

import statistics
import sys
from collections import defaultdict

from posegaussian.stages.registry import STAGES
from posegaussian.storage.archive.receipts import scan_receipts
from posegaussian.storage.archive.store import Archive


def main(urls: list[str]) -> None:
    found: dict[str, list[float]] = defaultdict(list)
    for url in urls:
        archive = Archive.open(url)
        for receipt in (r for name in archive.names() for r in scan_receipts(archive.sequence(name))):
            if receipt.facts.get("work"):
                found[receipt.stage].append(receipt.facts["cpu_seconds"] / receipt.facts["work"])
    for stage in (s.name for s in STAGES if s.name in found):
        print(f"{stage:<11} {statistics.median(found[stage]):.1e} s, median of {len(found[stage])} tasks")


if __name__ == "__main__":
    main(sys.argv[1:])
