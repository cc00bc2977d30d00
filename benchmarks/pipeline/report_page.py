"""The report page of an archive of many sequences: bytes and seconds.

    python -m benchmarks.pipeline.report_page [--sequences 100] [--size 192] [--frames 12] [--repeats 3]

One simulated person is computed, which the seconds leave out, and its folder copied under other names: every copy has
its own pictures, receipts and measures, read as those of any sequence. Reading starts anew with every repetition, in
the same process. Seconds of the processor are those of a machine that has nothing else to do.
"""

from __future__ import annotations

import argparse
import shutil
import statistics
import tempfile
import time
from pathlib import Path

from benchmarks.report import publish
from posegaussian.dags.report.report import write_report
from tests.support.pipeline import NAME, Pipeline, film


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sequences", type=int, default=100)
    parser.add_argument("--size", type=int, default=192, help="width and height of the pictures, px")
    parser.add_argument("--frames", type=int, default=12)
    parser.add_argument("--repeats", type=int, default=3)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        pipeline = computed(Path(folder), arguments.size, arguments.frames)
        for n in range(1, arguments.sequences):
            shutil.copytree(pipeline.root / NAME, pipeline.root / f"{NAME}{n:03d}")
        page, times, processor = Path(folder) / "report.html", [], []
        for _ in range(arguments.repeats):
            start, used = time.perf_counter(), time.process_time()
            write_report(pipeline.session, [], page)
            times.append(time.perf_counter() - start)
            processor.append(time.process_time() - used)
        size = page.stat().st_size
    row = {
        "sequences": arguments.sequences,
        "picture px": arguments.size,
        "frames": arguments.frames,
        "MB": size / 1e6,
        "median s": statistics.median(times),
        "max s": max(times),
        "median processor s": statistics.median(processor),
    }
    publish("report_page", [row], vars(arguments))


def computed(folder: Path, size: int, frames: int) -> Pipeline:
    """An archive of one finished sequence."""
    film(folder / "capture", size=size, frames=frames)
    pipeline = Pipeline(folder / "archive", folder / "capture")
    pipeline.register()
    pipeline.run()
    return pipeline


if __name__ == "__main__":
    main()
