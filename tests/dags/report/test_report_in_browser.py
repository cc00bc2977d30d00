"""The page of an archive as a browser shows it: on a screen and on a phone, from any folder, without a request."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.report.report import write_report
from posegaussian.storage.archive.receipts import receipt_file, scan_receipts
from posegaussian.storage.archive.store import Archive
from tests.support.browser import Browser
from tests.support.pipeline import NAME, Pipeline

ARCHIVE = """<script>alert('1') "zoë" & co"""
FAILED, WARNED = "it failed", "it's &amp; warned"
OTHERS = ("zoë läuft", "'b' & co", "a" * 100, NAME)
WIDTHS = (1280, 390)
SHOT = "POSEGAUSSIAN_REPORT_PICTURES"
"""Variable that names a folder for pictures of the page, to look at."""


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with Browser(WIDTHS[0], 900) as opened:
        yield opened


@pytest.fixture(scope="module")
def file(browser: Browser, finished: Pipeline, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of six sequences, one failed, one with warnings, taken away from where it was written."""
    folder = tmp_path_factory.mktemp("report")
    pipeline = finished.copy(folder / ARCHIVE)
    for name in (FAILED, WARNED, *OTHERS[:-1]):
        shutil.copytree(pipeline.root / NAME, pipeline.root / name)
    warn(Archive.open(str(pipeline.root)), WARNED)
    fail(pipeline, FAILED)
    write_report(pipeline.session, [], folder / "report.html")
    away = folder / "sent & söme where"
    away.mkdir()
    shutil.move(folder / "report.html", away / "a report.html")
    return away / "a report.html"


def warn(archive: Archive, name: str) -> None:
    sequence = archive.sequence(name)
    receipt = next(r for r in scan_receipts(sequence) if r.stage == "depth")
    warned = replace(receipt, warnings=("<b>the mask</b> is 'empty'",))
    place = receipt_file(sequence, receipt.stage, receipt.partition, receipt.view, receipt.path)
    place.write_bytes(warned.to_json())


def fail(pipeline: Pipeline, name: str) -> None:
    """A run whose depth fails in every partition."""
    import posegaussian.stages.depth.run as depth

    def failing(inputs: object, params: object) -> object:
        raise RuntimeError("<img src=x onerror=alert(1)> the cosmic ray")

    selection = Selection(force=frozenset({"depth"}))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(depth, "run", failing)
        assert pipeline.session.run_and_report([pipeline.session.plan(name, selection)], selection) == 1


@pytest.mark.parametrize("width", WIDTHS)
def test_it_is_whole_at_any_width(browser: Browser, file: Path, width: int) -> None:
    browser.resize(width, 900, mobile=width < 500)
    browser.open(file)
    text = browser.run("document.body.innerText")
    assert browser.run("document.querySelector('h1').innerText") == ARCHIVE
    for said in (FAILED, WARNED, *OTHERS, "<b>the mask</b> is 'empty'", "onerror=alert(1)> the cosmic ray"):
        assert said in text, said
    assert "6 sequences: 4 done, 1 with warnings, 1 failed" in text
    assert browser.run("document.querySelectorAll('script').length") == 0
    browser.run("document.querySelectorAll('details').forEach((d) => d.open = true)")
    assert browser.run("document.documentElement.scrollWidth") <= width, "nothing is cut off at the side"
    assert browser.run("document.images.length") > 3 * len(OTHERS)
    assert browser.run("[...document.images].every((i) => i.complete && i.naturalWidth > 0)")
    assert browser.run("document.querySelectorAll('.flow').length") == len(OTHERS) + 2, "everyone's plan is drawn"
    assert text.count("blended with those before") == len(OTHERS) + 2, "what smoothing changes is shown"
    if folder := os.environ.get(SHOT):
        Path(folder, f"report-{width}.png").write_bytes(browser.screenshot())
    silent(browser)


def test_every_link_leads_to_its_sequence(browser: Browser, file: Path) -> None:
    browser.resize(WIDTHS[1], 900)
    browser.open(file)
    names = browser.run("[...document.querySelectorAll('a')].map((a) => a.querySelector('b').innerText)")
    assert sorted(names) == sorted((FAILED, WARNED, *OTHERS))
    for n, name in enumerate(names):
        browser.run(f"window.scrollTo(0, 0), document.querySelectorAll('a')[{n}].click()")
        browser.wait("window.scrollY > 0")
        assert name in browser.run("document.querySelector(location.hash).querySelector('h2').innerText")
        assert -1 < browser.run("document.querySelector(location.hash).getBoundingClientRect().top") < 900
    silent(browser)


def silent(browser: Browser) -> None:
    """Nothing went wrong, and nothing was asked for but the file."""
    assert browser.complaints == []
    addresses = {address.partition("#")[0] for address in browser.requests if not address.startswith("data:")}
    assert len(addresses) == 1
    assert next(iter(addresses)).startswith("file:")
