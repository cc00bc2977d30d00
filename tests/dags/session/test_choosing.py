"""A name or a glob chooses sequences; a name that exists always means itself."""

from __future__ import annotations

from pathlib import Path

import pytest

from posegaussian.dags.session.choosing import chosen, chosen_one
from posegaussian.storage.archive.store import Archive
from posegaussian.storage.model.errors import ArchiveError
from tests.support.sample_captures import make_capture


def archive(folder: Path, *names: str) -> Archive:
    made = Archive.open(str(folder / "archive"), create=True)
    for name in names:
        made.create_sequence(name, make_capture(), 4)
    return made


def test_a_name_with_brackets_means_that_sequence_and_no_other(tmp_path: Path) -> None:
    both = archive(tmp_path, "walk[2]", "walk2", "kick")
    assert chosen(both, ["walk[2]"]) == ["walk[2]"]
    assert chosen_one(both, "walk[2]") == "walk[2]"
    assert chosen_one(both, "walk2") == "walk2"
    assert chosen(both, ["walk*"]) == ["walk2", "walk[2]"]
    assert chosen(both, ["[wk]*", "walk[2]"]) == ["kick", "walk2", "walk[2]"]
    assert chosen(both, []) == ["kick", "walk2", "walk[2]"]


def test_brackets_that_are_no_name_are_a_glob(tmp_path: Path) -> None:
    one = archive(tmp_path, "walk2", "walk3")
    assert chosen(one, ["walk[2-4]"]) == ["walk2", "walk3"]
    with pytest.raises(ArchiveError, match=r"'walk\[2-4\]' matches 2 sequences, walk2, walk3; name one"):
        chosen_one(one, "walk[2-4]")
    with pytest.raises(ArchiveError, match=r"no sequence matches 'walk\[4\]'; archive .* has walk2, walk3"):
        chosen(one, ["walk2", "walk[4]"])
