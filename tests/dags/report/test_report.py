"""`posegaussian report`: one file that shows every sequence, also those that failed, and that nothing can break out
of."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from posegaussian.dags.cli.app import app
from posegaussian.dags.planning.results import Results
from posegaussian.dags.report.account import Account
from posegaussian.dags.report.changes import changes_of
from posegaussian.dags.report.curves import MOST_POINTS, plot
from posegaussian.dags.report.page import page
from posegaussian.dags.report.pictures import MOST_BYTES, PAGE_BYTES, bytes_each, most_changes, pictures_of
from posegaussian.storage.model.errors import ConfigError
from tests.support.pipeline import NAME, Pipeline

HOSTILE = "<script>alert(1)</script> \"q\" 'b' zoë & co"


class Tags(HTMLParser):
    """Every tag of a page, and its text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        self.text += data


def test_the_page_of_a_finished_archive_shows_it_and_asks_for_nothing(finished: Pipeline, tmp_path: Path) -> None:
    before = sorted(p for p in finished.root.rglob("*") if "_cache" not in p.parts)
    file = tmp_path / "a page.html"
    done = CliRunner().invoke(app, ["report", *finished.options, "--page", str(file)])
    assert done.exit_code == 0, done.output
    assert str(file) in done.output
    assert "next: " in done.output
    found = Tags(file.read_text(encoding="utf-8"))
    loaded = [v for _, a in found.tags for k, v in a.items() if k in ("src", "href") and v]
    assert loaded
    assert all(v.startswith(("data:image/jpeg;base64,", "#s")) for v in loaded)
    assert not re.search(r"url\(|@import|<script", file.read_text(encoding="utf-8"))
    for said in (NAME, "Measures over time", "psnr", "where the seconds went", "partition.frames", "numpy"):
        assert said in found.text, said
    assert sorted(p for p in finished.root.rglob("*") if "_cache" not in p.parts) == before


def test_pictures_stay_within_their_bytes(finished: Pipeline) -> None:
    results = Results(finished.context())
    for most in (MOST_BYTES, 6_000):
        drawn = pictures_of(results, changes_of(results)[: most_changes(most)], most)
        assert {d.kind for d in drawn} >= {"strip", "sheet"}
        assert ("change" in {d.kind for d in drawn}) == (most == MOST_BYTES), "nothing is seen on a kilobyte"
        assert sum(len(d.uri) for d in drawn) <= most + 100
    assert bytes_each(100) * 100 <= PAGE_BYTES


def test_names_and_sentences_are_text_and_never_tags() -> None:
    told = [
        Account(HOSTILE, refused=f"no {HOSTILE}"),
        Account(
            HOSTILE,
            about=HOSTILE,
            stages={"depth": {"all": 2, "done": 1, "failed": 1}},
            measures={HOSTILE: {HOSTILE: [(0, 1.0), (1, 2.0)]}},
            effects=[HOSTILE],
            failures=[HOSTILE],
            retry=[HOSTILE],
            warnings=[HOSTILE],
            settings=[(HOSTILE, HOSTILE, HOSTILE)],
            libraries={HOSTILE: HOSTILE},
        ),
    ]
    text = page(HOSTILE, told, {HOSTILE: HOSTILE})
    assert "<script" not in text
    found = Tags(text)
    assert "script" not in {tag for tag, _ in found.tags}
    assert found.text.count(HOSTILE) >= 14
    assert all(not name.startswith("on") for _, attributes in found.tags for name in attributes)


def test_an_archive_without_results_and_a_folder_that_is_no_sequence_have_their_place(
    person_folder: Path, tmp_path: Path
) -> None:
    pipeline = Pipeline(tmp_path / "archive", person_folder)
    pipeline.register()
    (pipeline.root / "<b>").mkdir()
    (pipeline.root / "<b>" / "zarr.json").write_bytes((pipeline.root / NAME / "zarr.json").read_bytes())
    file = tmp_path / "report.html"
    done = CliRunner().invoke(app, ["report", *pipeline.options, "--page", str(file)])
    assert done.exit_code == 0, done.output
    found = Tags(file.read_text(encoding="utf-8"))
    assert "2 sequences: 1 failed, 1 empty" in found.text
    assert "cannot be a sequence" in found.text


def test_curves_are_thinned_and_leave_out_what_is_no_number() -> None:
    long = plot("psnr", {"cam": [(i, float(np.sin(i))) for i in range(5000)]})
    assert long.count(",") <= MOST_POINTS
    assert plot("psnr", {"cam": [(0, float("nan"))]}) == ""
    alone = plot("psnr", {"cam": [(3, 20.0)]})
    assert "<circle" in alone
    assert re.findall(r"<text[^>]*>([^<]*)</text>", alone) == ["20", "frame 3"], "a value alone is said once"
    two = plot("psnr", {"cam": [(3, 20.0), (5, 21.0)]})
    assert re.findall(r"<text[^>]*>([^<]*)</text>", two) == ["21", "20", "frame 3", "5"]


def test_a_page_of_another_ending_is_refused_before_anything_is_read(tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["report", "--page", str(tmp_path / "report.pdf")])
    assert isinstance(done.exception, ConfigError)
    with pytest.raises(ConfigError, match=r"must be \.htm or \.html"):
        raise done.exception
