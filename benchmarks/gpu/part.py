"""One part of the table in a process of its own: what breaks a device's context, or ends the process, takes no other
part along.

    python -m benchmarks.gpu.part renderer rows.jsonl [--device cuda] [--repeats 50] [--minutes 0] [--training FOLDER]
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import sys
import traceback
from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace
from pathlib import Path

import torch

from benchmarks.gpu.rows import UNMEASURED, Row, Setup

PARTS = ("tests", "renderer", "network", "refinement", "frame", "training")
"""In their order: each is a module beside this one with a function `rows`."""


def rows(part: str, setup: Setup) -> Iterator[Row]:
    """Of a part, as they are measured; without a CUDA device no figure is told, for it would be another machine's.

    Whatever the part raises ends it with a row of that; the traceback is printed.
    """
    try:
        for row in importlib.import_module(f"benchmarks.gpu.{part}").rows(setup):
            hidden = setup.small and measured(row) and not row.wrong
            yield replace(row, figure=UNMEASURED, unit="", on="") if hidden else row
    except Exception as e:
        traceback.print_exc()
        yield Row(part, "", f"failed: {type(e).__name__}: {str(e).partition(chr(10))[0]}", wrong=True)


def measured(row: Row) -> bool:
    """Whether a row has a figure."""
    return isinstance(row.figure, float)


def main(arguments: Sequence[str] | None = None) -> None:
    """Append a line of JSON a row to the file, each at once."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("part", choices=PARTS)
    parser.add_argument("file", type=Path)
    parser.add_argument("--device", default="cuda", help="cuda, or cpu: small, and no figure counts")
    parser.add_argument("--repeats", type=int, default=Setup.repeats)
    parser.add_argument("--minutes", type=float, default=Setup.minutes)
    parser.add_argument("--training", type=Path, default=Setup.training)
    given = parser.parse_args(arguments)
    setup = Setup(torch.device(given.device), given.repeats, given.minutes, given.training)
    if setup.small:
        os.environ["CUDA_VISIBLE_DEVICES"] = ""
        os.environ["TRITON_INTERPRET"] = "1"  # before Triton is imported
    failed = False
    with given.file.open("a", encoding="utf-8") as out:
        for row in rows(given.part, setup):
            out.write(json.dumps(asdict(row)) + "\n")
            out.flush()
            print(row.told, flush=True)
            failed |= row.wrong
    sys.exit(failed)


if __name__ == "__main__":
    main()
