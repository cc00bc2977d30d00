"""What is said in one place is written nowhere else: a second copy would sooner or later say something different."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
ONCE = {
    "foreground threshold": (r"[<>]=?\s*12[78]\b", "storage/model/masks.py", "FOREGROUND = 127"),
    "camera centre": (
        r"-\w*(\.world_to_camera)?(\[.*:3, :3\])?\.T @ .*",
        "storage/model/cameras.py",
        "-world_to_camera[:3, :3].T @",
    ),
    "person's height": (r"^\w*(HEIGHT|STATURE)\w* = 1\.[78]\b", "stages/geometry/subject.py", "STATURE = 1.7"),
    "share of the hull searched": (r"^(SEARCHED|IN_FRONT) = ", "stages/matching/bounds.py", "SEARCHED = 0.6"),
}
"""{what: (how a copy looks, the file that says it, what stands there)}."""


@pytest.mark.parametrize("what", ONCE)
def test_constants_and_formulas_stand_in_one_place(what: str) -> None:
    copy, home, said = ONCE[what]
    assert said in (ROOT / home).read_text()
    copies = [
        f"{file.relative_to(ROOT)}:{number}: {line.strip()}"
        for folder in ("dags", "stages", "storage")
        for file in sorted((ROOT / folder).rglob("*.py"))
        if file != ROOT / home
        for number, line in enumerate(file.read_text().splitlines(), 1)
        if re.search(copy, line) and '"""' not in line
    ]
    assert not copies, f"{what}: use what {home} has in place of\n" + "\n".join(copies)
