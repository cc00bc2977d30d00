"""Every benchmark that is called by its name says what it is before it measures or writes anything."""

from __future__ import annotations

import ast
import importlib
import sys
from pathlib import Path

import pytest

from benchmarks.report import ROOT
from benchmarks.simulator import cast_pictures

CALLED = sorted(
    file.relative_to(ROOT).with_suffix("").as_posix().replace("/", ".")
    for file in (ROOT / "benchmarks").rglob("*.py")
    if any(isinstance(node, ast.FunctionDef) and node.name == "main" for node in ast.parse(file.read_text()).body)
)


@pytest.mark.parametrize("module", CALLED)
def test_help_is_shown_and_nothing_else_is_done(
    module: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "docs" / "reference").mkdir(parents=True)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [module, "--help"])
    with pytest.raises(SystemExit) as ended:
        importlib.import_module(module).main()
    assert not ended.value.code
    assert capsys.readouterr().out.startswith("usage:")
    assert [f for f in tmp_path.rglob("*") if not f.is_dir()] == []


def test_a_picture_that_cannot_be_written_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """OpenCV says it by what it returns."""
    monkeypatch.setattr(cast_pictures, "WEARERS", cast_pictures.WEARERS[:1])
    monkeypatch.setattr(cast_pictures, "MOMENTS", {"stand": 0.0})
    monkeypatch.setattr(cast_pictures, "pictures", lambda *rest: [cast_pictures.np.zeros((4, 4, 3), "uint8")] * 2)
    monkeypatch.setattr(sys, "argv", ["cast_pictures", "--folder", str(tmp_path / "missing")])
    with pytest.raises(SystemExit, match=r"missing/cast\.png was not written"):
        cast_pictures.main()
    (tmp_path / "missing").mkdir()
    cast_pictures.main()
    assert {f.name for f in (tmp_path / "missing").iterdir()} == {"cast.png", "motions.png"}
