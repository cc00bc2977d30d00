"""What is remembered of source files is what parsing them says, of their content alone, and never in the way."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from posegaussian.dags.provenance import syntax
from posegaussian.dags.provenance.code_digest import ROOT
from posegaussian.dags.provenance.syntax import Remembered, syntax_of

FILES = [ROOT / "stages/registry.py", ROOT / "stages/depth/stage.py", ROOT / "storage/files/write.py"]


def parsed_by(memory: Remembered, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What was parsed while a memory was asked about FILES, each of which it answers rightly."""
    parsed: list[str] = []

    def watched(content: bytes, file: str) -> syntax.Syntax:
        parsed.append(file)
        return syntax_of(content, file)

    right = {f: syntax_of(f.read_bytes(), str(f)) for f in FILES}
    with monkeypatch.context() as patch:
        patch.setattr(syntax, "syntax_of", watched)
        for file in FILES:
            assert memory.of(file.read_bytes(), str(file)) == right[file]
    return parsed


def test_what_was_kept_is_what_parsing_says_and_is_not_parsed_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    memory = Remembered(tmp_path / "a" / "memory.json")
    assert parsed_by(memory, monkeypatch) == [str(f) for f in FILES]
    assert parsed_by(memory, monkeypatch) == []
    memory.keep()
    assert parsed_by(Remembered(memory.file), monkeypatch) == []


def test_a_file_is_known_by_what_it_holds(tmp_path: Path) -> None:
    memory = Remembered(tmp_path / "memory.json")
    assert memory.of(b"x = 1\n", "a.py") == memory.of(b"x = 1\n", "b.py") == memory.of(b"x = 1  # one\n", "a.py")
    assert memory.of(b"x = 2\n", "a.py") != memory.of(b"x = 1\n", "a.py")


@pytest.mark.parametrize("held", [b"", b"{", b"[]", b'{"a": 1}', b'{"a": ["b"]}', b"\xff"])
def test_a_memory_that_cannot_be_read_is_none(held: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "memory.json"
    file.write_bytes(held)
    memory = Remembered(file)
    assert len(parsed_by(memory, monkeypatch)) == len(FILES)
    memory.keep()
    assert parsed_by(Remembered(file), monkeypatch) == []


def test_where_nothing_can_be_written_nothing_is_kept_and_nothing_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").touch()
    memory = Remembered(tmp_path / "file" / "memory.json")
    assert len(parsed_by(memory, monkeypatch)) == len(FILES)
    memory.keep()
    assert [f.name for f in tmp_path.iterdir()] == ["file"]


def test_nothing_is_kept_where_nobody_has_a_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    memory = Remembered(Path("~/memory.json"))
    memory.of(b"x = 1\n", "a.py")
    memory.keep()
    assert list(tmp_path.iterdir()) == []


def test_what_was_asked_for_last_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(syntax, "KEPT", 2)
    memory = Remembered(tmp_path / "memory.json")
    for name in "abac":
        memory.of(f"x = '{name}'\n".encode(), "x.py")
    memory.keep()
    kept = Remembered(memory.file)
    assert len(kept.known) == 2
    for name, news in (("a", False), ("c", False), ("b", True)):
        kept.of(f"x = '{name}'\n".encode(), "x.py")
        assert kept.news is news


def test_the_next_process_parses_nothing_and_has_the_same_digest(tmp_path: Path) -> None:
    """Two processes of one home: the second one is forbidden to parse."""
    ask = "from posegaussian.dags.provenance import code_digest as c, syntax as s; {}print(c.code_digest({!r}))"
    forbidden = "s.syntax_of = None; "
    run = "posegaussian.stages.silhouettes.hull:run"
    environment = os.environ | {"XDG_CACHE_HOME": str(tmp_path)}
    said = [
        subprocess.run(
            [sys.executable, "-c", ask.format(before, run)], env=environment, text=True, capture_output=True, check=True
        ).stdout
        for before in ("", forbidden)
    ]
    assert said[0] == said[1] != ""
    assert [f.suffix for f in (tmp_path / "posegaussian" / "syntax").iterdir()] == [".json"]
