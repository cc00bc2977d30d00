"""Compiled kernels: said when they are made, forgotten when any of their sources has changed."""

import logging
from pathlib import Path

import pytest

from stages.rendering import cpu

KERNELS = ("cpu_tiles.sort_tiles-1.py311.nbi", "cpu_tiles.sort_tiles-1.py311.1.nbc", "cpu_composite.forward-9.py311.nbi")


def test_kernels_of_other_sources_are_forgotten_and_nothing_else(tmp_path: Path) -> None:
    for name in (*KERNELS, "raycast.cast-1.py311.nbi", "cpu_tiles.cpython-311.pyc"):
        (tmp_path / name).touch()
    cpu.forget_stale_kernels(tmp_path)  # no note: nobody knows what these were made from
    assert sorted(p.name for p in tmp_path.iterdir()) == ["cpu_tiles.cpython-311.pyc", "raycast.cast-1.py311.nbi", "renderer.digest"]
    (tmp_path / KERNELS[0]).touch()
    cpu.forget_stale_kernels(tmp_path)
    assert (tmp_path / KERNELS[0]).exists()
    (tmp_path / "renderer.digest").write_text("of another version")
    cpu.forget_stale_kernels(tmp_path)
    assert not (tmp_path / KERNELS[0]).exists()


def test_a_folder_that_does_not_exist_is_made(tmp_path: Path) -> None:
    cpu.forget_stale_kernels(tmp_path / "new")
    assert (tmp_path / "new" / "renderer.digest").is_file()


def test_compiling_is_announced_once_and_only_where_nothing_is_compiled(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        cpu.announce(tmp_path)
        cpu.announce(tmp_path)
        assert len(caplog.messages) == 1
        assert "compiling the renderer" in caplog.messages[0]
        (tmp_path / "more").mkdir()
        (tmp_path / "more" / "cpu_projection.project-154.py311.1.nbc").touch()
        cpu.announce(tmp_path / "more")
    assert len(caplog.messages) == 1
