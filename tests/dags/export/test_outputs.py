"""What cannot be written is refused before any work."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from posegaussian.dags.cli.app import app
from posegaussian.dags.export.output_paths import output_file, output_folder
from posegaussian.dags.export.request import ExportOrder
from posegaussian.storage.model.errors import ConfigError, UserError
from tests.support.pipeline import NAME, Pipeline


def test_a_good_name_is_given_back_and_nothing_is_made(tmp_path: Path) -> None:
    file, folder = tmp_path / "a.mp4", tmp_path / "frames"
    assert output_file("--video", file, (".mp4",)) == file
    assert output_folder("--frames", folder) == folder
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["a.gif", "a", "a.mp4.part"])
def test_an_ending_that_no_writer_takes(tmp_path: Path, name: str) -> None:
    with pytest.raises(ConfigError, match=r"--video .*must be \.mp4"):
        output_file("--video", tmp_path / name, (".mp4",))


def test_a_folder_that_is_not_there_is_not_made(tmp_path: Path) -> None:
    for refused in (lambda p: output_file("--video", p, (".mp4",)), lambda p: output_folder("--frames", p)):
        with pytest.raises(ConfigError, match=r"nope does not exist; make it first"):
            refused(tmp_path / "nope" / "a.mp4")
    assert not any(tmp_path.iterdir())


def test_what_is_already_something_else(tmp_path: Path) -> None:
    (tmp_path / "a.mp4").mkdir()
    (tmp_path / "frames").write_text("a file")
    with pytest.raises(ConfigError, match="there is a folder of that name"):
        output_file("--video", tmp_path / "a.mp4", (".mp4",))
    with pytest.raises(ConfigError, match="there is a file of that name"):
        output_folder("--frames", tmp_path / "frames")
    with pytest.raises(ConfigError, match="frames is no folder"):
        output_file("--video", tmp_path / "frames" / "a.mp4", (".mp4",))


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_nobody_may_write_to(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    with pytest.raises(ConfigError, match="nothing can be written"):
        output_file("--video", tmp_path / "a.mp4", (".mp4",))


@pytest.mark.parametrize(
    "options",
    [
        ["--video", "a.gif"],
        ["--sheet", "a.jpg"],
        ["--video", "nope/a.mp4"],
        ["--frames", "nope/frames"],
        ["--splats", "nope/splats"],
    ],
)
def test_an_export_refuses_before_it_computes(
    finished: Pipeline, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: list[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(app, ["export", NAME, *finished.options, "--set", "pose.sigma=0.07", *options])
    assert isinstance(result.exception, ConfigError), result.output
    assert finished.with_settings().plan().all_fresh, "nothing was computed"
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("option", "given", "other"),
    [
        ("--alpha", {"alpha": True}, {"video": "a.mp4"}),
        ("--view cam00 cam01", {"views": ("cam00", "cam01")}, {"frames": "frames"}),
        ("--output there", {"folder": Path("there")}, {"sheet": "a.png"}),
        ("--path orbit", {"path": "orbit"}, {"splats": "splats"}),
    ],
)
def test_an_option_of_something_that_is_not_asked_for_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, option: str, given: dict[str, Any], other: dict[str, str]
) -> None:
    monkeypatch.chdir(tmp_path)
    asked: dict[str, Any] = {key: Path(name) for key, name in other.items()}
    ExportOrder(**asked)
    with pytest.raises(ConfigError, match=rf"export {option}: it is .* asked for"):
        ExportOrder(**asked, **given)


def test_pictures_of_something_else_are_found_before_the_run(finished: Pipeline, tmp_path: Path) -> None:
    stranger = tmp_path / "frames/cam77/000000.png"
    stranger.parent.mkdir(parents=True)
    stranger.write_bytes(b"somebody's")
    order = ExportOrder(frames=tmp_path / "frames")
    with pytest.raises(UserError, match=r"holds 1 picture of something else"):
        order.check(finished.context())
    (tmp_path / "splats").mkdir()
    (tmp_path / "splats/other.ply").write_bytes(b"somebody's")
    with pytest.raises(UserError, match=r"holds 1 splat file of something else"):
        ExportOrder(splats=tmp_path / "splats").check(finished.context())
