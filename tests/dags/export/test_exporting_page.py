"""A page by the command: what it needs is made, and what it cannot be is refused before anything runs."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from posegaussian.dags.export import page
from posegaussian.dags.export.background import parse
from posegaussian.dags.planning.results import Results
from posegaussian.storage.model.errors import ConfigError, UserError
from tests.dags.cli.test_cli import assert_says, posegaussian
from tests.support.pipeline import NAME, Pipeline, film


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Pipeline:
    folder = tmp_path_factory.mktemp("page")
    film(folder / "capture", views=3, frames=3)
    pipeline = Pipeline(
        folder / "archive", folder / "capture", ["depth.method=truth", "frames.range=1:3", "rendering.paths=[]"]
    )
    pipeline.register()
    pipeline.run()
    return pipeline


def head_of(file: Path) -> dict:
    found = re.search(r'id="head">(.*?)</script>', file.read_text(encoding="utf-8"))
    assert found is not None
    return json.loads(found[1])


def test_the_command_makes_what_was_dropped_and_flies_along_the_configured_path(made: Pipeline, tmp_path: Path) -> None:
    archive = made.copy(tmp_path / "archive").with_settings(
        "run.keep=as_declared", "rendering.paths=[sway cam01, orbit]"
    )
    options = ("--page", "a.html", "--view", "cam01", "--view", "cam00", "--background", "#30a040", *archive.options)
    done = posegaussian("export", NAME, *options, cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "a.html, 0." in done.stdout
    assert not (archive.root / NAME / "rendering").exists()
    head = head_of(tmp_path / "a.html")
    assert [v["name"] for v in head["views"]] == ["cam00", "cam01"]
    assert head["cameras"][0] | {"lens": [], "pose": []} == {
        "name": "sway", "group": "path sway", "size": [48, 48], "lens": [], "pose": []
    }  # fmt: skip
    assert [len(head["cameras"][0][key]) for key in ("lens", "pose")] == [2, 2]
    assert {c["group"] for c in head["cameras"][1:]} == {"source cameras", "held-out cameras"}
    assert (head["frames"], head["steps"], head["background"]) == ([1, 2], 2, "#30a040")


def test_wishes_that_cannot_be_are_refused(made: Pipeline, tmp_path: Path) -> None:
    def refused(*words: str, **said: str) -> None:
        assert_says(posegaussian("export", NAME, *words, *made.options, cwd=tmp_path), *said.values())

    refused("--page", "a.htm", ending=".html")
    refused("--page", "no/a.html", folder="does not exist")
    refused("--page", "a.html", "--background", "plate", color="a page has a colour")
    refused("--page", "a.html", "--path", "orbot", near="did you mean 'orbit'")
    refused("--page", "a.html", "--view", "nobody", view="--view nobody")
    refused("--sheet", "a.png", "--page-gaussians", "5000", page="it is for --page FILE")
    assert not list(tmp_path.iterdir())


def test_a_single_frame_is_flown_around_in_steps(made: Pipeline, tmp_path: Path) -> None:
    results = Results(made.with_settings("frames.range=1:2").context())
    page.export_page(results, (), tmp_path / "a.html", "orbit", parse("none"))
    head = head_of(tmp_path / "a.html")
    assert (head["steps"], len(head["frames"]), len(head["cameras"][0]["pose"])) == (48, 1, 48)
    page.export_page(results, (), tmp_path / "a.html", "held_out", parse("none"))
    head = head_of(tmp_path / "a.html")
    assert (head["steps"], head["cameras"][0]["group"]) == (1, "path held_out")


def test_more_views_than_a_shader_holds_are_refused(made: Pipeline, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(page, "MOST_VIEWS", 2)
    with pytest.raises(ConfigError, match="3 source views, a page takes 2; choose some with --view"):
        page.check(made.context(), (), "orbit")
    with pytest.raises(UserError, match="none of"):
        page.check(made.context(), ("cam00",), "spiral")


def test_what_a_page_holds_is_told(made: Pipeline, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A single count is no range, and more than some devices hold is said with what to do."""
    results = Results(made.with_settings("frames.range=1:2").context())
    (said,) = page.export_page(results, (), tmp_path / "a.html", "orbit", parse("none"))
    (count,) = re.findall(r"1 frame of (\d+) Gaussians;", said)
    monkeypatch.setattr(page, "HELD", int(count) - 1)
    (_, hint) = page.export_page(results, (), tmp_path / "a.html", "orbit", parse("none"))
    assert f"a frame of {count} Gaussians is more than some devices hold" in hint
    assert f"--page-gaussians {int(count) - 1}" in hint
    monkeypatch.setattr(page, "HELD", int(count))
    assert len(page.export_page(results, (), tmp_path / "a.html", "orbit", parse("none"))) == 1


def test_how_many_views_make_a_picture(made: Pipeline) -> None:
    """No more than there are; and all of them of a refined sequence, whose Gaussians are the same from all sides."""

    def views(*names: int, settings: str = "rendering.sources=2") -> str:
        info = page.page_head(made.with_settings(settings).context(), names, None, parse("none"))["info"]
        return dict(info)["Views"]

    assert views(0, 1, 2).endswith("; 2 make a picture")
    assert views(0).endswith("; 1 makes a picture")
    assert views(0, 1, settings="rendering.sources=8").endswith("; 2 make a picture")
    assert views(0, 1, 2, settings="refinement.steps=5").endswith("; all make a picture")
