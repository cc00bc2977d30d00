"""Laws of places: a key leads below its folder or is refused; a name is one folder's;
nothing is read through a link."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from posegaussian.storage.files.names import (
    FileSizes,
    Unsafe,
    below,
    check_camera_names,
    files_below,
    folders_in,
    is_word,
    name_fault,
    parse_json,
    read_file,
)
from posegaussian.storage.model.errors import CalibrationError

QUICK = settings(max_examples=300)
BAD_KEYS = [
    "",
    "/",
    "/etc/passwd",
    "..",
    ".",
    "a/..",
    "a/../b",
    "../a",
    "a//b",
    "a/",
    "./a",
    "a\\b",
    "a/\0",
    "a\nb",
    "\ud800",
]


@pytest.mark.parametrize("key", BAD_KEYS)
def test_keys_that_are_no_place_below_are_refused(key: str, tmp_path: Path) -> None:
    with pytest.raises(Unsafe, match="is no place in it"):
        below(tmp_path, key)


@QUICK
@given(st.text(st.sampled_from("ab./\\\0~"), max_size=12))
def test_whatever_a_key_is_its_place_lies_below(key: str) -> None:
    root = Path("/nowhere/at/all")
    try:
        place = below(root, key)
    except Unsafe:
        return
    assert os.path.normpath(place).startswith(f"{root}/")


def test_places_that_are_there_and_that_are_not_yet(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "a/f").write_text("x")
    assert [below(tmp_path, k) for k in ("a", "a/f", "a/g/h", "b/c")] == [
        tmp_path / k for k in ("a", "a/f", "a/g/h", "b/c")
    ]
    with pytest.raises(Unsafe, match="is a file, where the archive has a folder"):
        below(tmp_path, "a/f/g")


def test_links_and_pipes_on_the_way_are_refused_but_not_those_above(tmp_path: Path) -> None:
    (tmp_path / "real/a").mkdir(parents=True)
    (tmp_path / "root").symlink_to(tmp_path / "real")
    root = tmp_path / "root"
    assert below(root, "a/b") == root / "a/b"
    (root / "dangling").symlink_to("nothing")
    (root / "up").symlink_to("..")
    os.mkfifo(root / "pipe")
    for key, why in {
        "dangling": "symbolic link",
        "dangling/x": "symbolic link",
        "up/real": "symbolic link",
        "pipe": "neither a file nor a folder",
    }.items():
        with pytest.raises(Unsafe, match=why):
            below(root, key)
    with pytest.raises(Unsafe, match="symbolic link"):
        list(files_below(root))
    with pytest.raises(Unsafe, match="symbolic link"):
        folders_in(root)
    with pytest.raises(Unsafe, match="symbolic link"):
        FileSizes(root).size("up/real/x")


def test_files_are_walked_in_order_and_what_is_not_there_has_none(tmp_path: Path) -> None:
    for name in ("b/2", "b/1", "a/c/1", "0"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("")
    assert [os.path.relpath(f, tmp_path) for f in files_below(tmp_path)] == ["0", "a/c/1", "b/1", "b/2"]
    assert [p.name for p in folders_in(tmp_path)] == ["a", "b"]
    assert list(files_below(tmp_path / "none")) == folders_in(tmp_path / "none") == []


def test_sizes_of_files_alone(tmp_path: Path) -> None:
    (tmp_path / "a/folder").mkdir(parents=True)
    (tmp_path / "a/f").write_text("123")
    look = FileSizes(tmp_path)
    assert [look.size(k) for k in ("a/f", "a/folder", "a/none", "b/c/d")] == [3, -1, -1, -1]
    (tmp_path / "a/l").symlink_to("f")
    with pytest.raises(Unsafe, match="symbolic link"):
        look.size("a/l")


def test_a_file_is_read_whole_or_refused(tmp_path: Path) -> None:
    file = tmp_path / "f"
    file.write_bytes(b"12345")
    assert read_file(file, 5) == b"12345"
    with pytest.raises(Unsafe, match="has 5 bytes, such a file has at most 4"):
        read_file(file, 4)
    (tmp_path / "l").symlink_to(file)
    os.mkfifo(tmp_path / "p")
    (tmp_path / "d").mkdir()
    for name, why in {
        "l": "symbolic link",
        "p": "neither a file nor a folder",
        "d": "is a folder, where the archive has a file",
    }.items():
        with pytest.raises(Unsafe, match=why):
            read_file(tmp_path / name, 5)
    with pytest.raises(FileNotFoundError):
        read_file(tmp_path / "none", 5)


def test_text_that_is_nested_too_deep_is_no_json() -> None:
    with pytest.raises(ValueError, match="nested too deep"):
        parse_json(b"[" * 100_000)


@pytest.mark.parametrize("name", ["cam01", "Camera 1", "ä-ö", "GH010017", "1", "a.b", "_x", "x" * 100])
def test_names_of_cameras(name: str) -> None:
    check_camera_names([name])


@pytest.mark.parametrize(
    "name",
    [
        "",
        " ",
        ".",
        "..",
        ".hidden",
        "../../x",
        "/etc",
        "a/b",
        "a\\b",
        "C:",
        "a\nb",
        "a\x1b[31m",
        "\ud800",
        "x" * 101,
        "a*",
        None,
        3,
    ],
)
def test_names_that_no_camera_has(name: object) -> None:
    assert name_fault(name) is not None
    with pytest.raises(CalibrationError, match="cannot name a folder"):
        check_camera_names(["cam01", name])


def test_words_are_what_the_program_names_things() -> None:
    assert all(is_word(w) for w in ("depth", "orbit-01234567", "joints2d", "a.b_c"))
    assert not any(is_word(w) for w in ("", "..", ".a", "a/b", "_a", "a b", "a\n", "ä", None, 3, "x" * 128))
