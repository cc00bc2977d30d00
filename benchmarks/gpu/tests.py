"""All tests of the GPU's kernels and of what uses a device: on it, or by Triton's interpreter where there is none."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from xml.etree import ElementTree

from benchmarks.gpu.rows import Row, Setup
from benchmarks.report import ROOT

TESTS = (
    "tests/stages/splatting/gpu",
    "tests/stages/refinement/test_on_device.py",
    "tests/hard_cases/test_splatting.py",
)
CHOSEN = "gpu"
"""Of the hard cases those that `gpu` draws."""


def rows(setup: Setup) -> Iterator[Row]:
    """One row: how many passed, failed, were skipped."""
    if find_spec("pytest") is None:
        yield Row("tests", "", "not run: pytest is not installed in this Python")
        return
    environment = {**os.environ, **({"TRITON_INTERPRET": "1"} if setup.small else {})}
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "tests.xml"
        words = ["-m", "pytest", *TESTS, "-k", CHOSEN, f"--junitxml={report}", "-p", "no:cacheprovider"]
        subprocess.run([sys.executable, *words], cwd=ROOT, env=environment, check=False)
        if not report.exists():
            raise RuntimeError("pytest ended without a report; its own words are above")
        on, (said, wrong) = "Triton's interpreter" if setup.small else setup.name, told(report)
        yield Row("tests", "", said, "", on, wrong)


def told(report: Path) -> tuple[str, bool]:
    """The counts of a JUnit file, as "30 passed, 2 skipped", and whether any failed."""
    suites = list(ElementTree.parse(report).getroot().iter("testsuite"))
    all_, failed, skipped = (
        sum(int(s.get(k, 0)) for s in suites for k in keys)
        for keys in (("tests",), ("failures", "errors"), ("skipped",))
    )
    counts = {"passed": all_ - failed - skipped, "failed": failed, "skipped": skipped}
    return ", ".join(f"{n} {what}" for what, n in counts.items() if n or what == "passed"), failed > 0
