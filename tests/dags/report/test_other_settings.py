"""A report under other settings than a sequence was made with: it shows no picture of another size or moment, says what
differs, and keeps every other sequence."""

from __future__ import annotations

import shutil
from html import escape
from pathlib import Path

import pytest
from typer.testing import CliRunner

from posegaussian.dags.cli.app import app
from posegaussian.dags.planning import fingerprint
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.report.account import Account, accounts
from posegaussian.dags.report.page import page
from tests.support.pipeline import NAME, Pipeline, film

FRAMES = 5
"""Of the capture; three are worked on, in partitions of two."""
RANGE, SIZE = "0:3", 48


@pytest.fixture(scope="module")
def first_look(tmp_path_factory: pytest.TempPathFactory) -> Pipeline:
    """Three frames of 48 px of pictures of 64, by a run whose settings are kept. Read it, do not change it."""
    folder = tmp_path_factory.mktemp("first_look")
    film(folder / "capture", views=4, size=64, frames=FRAMES, held_out=0)
    common = ["depth.method=hull", 'rendering.paths=["still cam00"]', "run.report=off", "effects.noise_averaging=on"]
    pipeline = Pipeline(folder / "archive", folder / "capture", common, held_out="[]")
    pipeline.register()
    session = pipeline.with_settings(f"frames.range={RANGE}", f"frames.size={SIZE}").session
    assert session.run_and_report([session.plan(NAME, Selection())], Selection()) == 0
    return pipeline


def told(pipeline: Pipeline, *settings: str) -> Account:
    (account,) = accounts(pipeline.with_settings(*settings).session, [NAME])
    return account


@pytest.mark.parametrize("size", [32, SIZE, 64])
@pytest.mark.parametrize("asked", ["0:2", RANGE, "0:4", "0:5", "1:4", "2:5", "0:5:2"])
def test_what_is_shown_is_of_the_size_and_the_frames_that_are_asked_for(
    first_look: Pipeline, asked: str, size: int
) -> None:
    account = told(first_look, f"frames.range={asked}", f"frames.size={size}")
    assert account.refused == ""
    as_made = (asked, size) == (RANGE, SIZE)
    # their first partition is the one that was made; of 0:4 and 0:5 the others are not there
    assert bool(account.pictures) == (size == SIZE and asked in ("0:2", RANGE, "0:4", "0:5"))
    assert bool(account.made_otherwise) != as_made


def test_pictures_of_two_sizes_are_never_put_beside_each_other(first_look: Pipeline, tmp_path: Path) -> None:
    """A run under another size that got as far as the frames."""
    copy = first_look.copy(tmp_path / "archive")
    larger = copy.with_settings(f"frames.range={RANGE}", "frames.size=64")
    larger.run(selection=Selection(only=frozenset({"survey", "judge", "frames"})))
    assert {p.kind for p in told(larger).pictures} >= {"strip"}
    assert told(copy, f"frames.range={RANGE}", f"frames.size={SIZE}").refused == ""


def test_what_was_made_from_results_of_other_settings_is_not_shown_either(first_look: Pipeline) -> None:
    as_made = (f"frames.range={RANGE}", f"frames.size={SIZE}")
    rendered, filmed = (
        next(p.caption for p in told(first_look, *as_made, *more).pictures if p.kind == "strip")
        for more in ((), ("depth.consistency=1",))
    )
    assert rendered.startswith("along ")
    assert filmed.startswith("a source view"), "pictures of the path follow from another depth"


def test_results_of_older_code_are_shown(first_look: Pipeline, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fingerprint, "code_digest", lambda _: "of a newer version")
    account = told(first_look, f"frames.range={RANGE}", f"frames.size={SIZE}")
    assert not any(counted.get("done") for counted in account.stages.values())
    assert {p.kind for p in account.pictures} >= {"strip", "sheet", "change"}
    assert account.made_otherwise == []


def test_page_and_command_say_what_differs_and_how_to_see_what_was_made(first_look: Pipeline, tmp_path: Path) -> None:
    copy, file = first_look.copy(tmp_path / "archive"), tmp_path / "report.html"
    done = CliRunner().invoke(app, ["report", *copy.options, "--page", str(file)])
    assert done.exit_code == 0, done.output
    (sentence,) = told(copy).made_otherwise
    assert f"frames: range: {RANGE} -> ::, frames: size: {SIZE} -> nothing" in sentence
    assert sentence in done.output
    assert done.output.splitlines()[-1].startswith("next: ")
    text = file.read_text(encoding="utf-8")
    assert escape(sentence) in text
    assert "made with other settings" in text
    assert "data:image" not in text
    config = sentence.rpartition("--config ")[2]
    done = CliRunner().invoke(app, ["report", "--archive", str(copy.root), "--config", config, "--page", str(file)])
    assert done.exit_code == 0, done.output
    assert "other settings" not in done.output
    assert "data:image" in file.read_text(encoding="utf-8")


def test_one_sequence_that_cannot_be_read_is_a_sentence_beside_the_others(first_look: Pipeline, tmp_path: Path) -> None:
    copy = first_look.copy(tmp_path / "archive").with_settings(f"frames.range={RANGE}", f"frames.size={SIZE}")
    shutil.copytree(copy.root / NAME, copy.root / "broken")
    (copy.root / "broken" / "zarr.json").write_text("{}")
    broken, whole = accounts(copy.session, ["broken", NAME])
    assert broken.refused
    assert whole.pictures
    assert escape(broken.refused) in page("archive", [broken, whole], {})
