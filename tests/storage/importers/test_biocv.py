"""bioCV's text files, one a camera, for `import videos`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from posegaussian.storage.importers.find import find_capture
from posegaussian.storage.model.errors import UserError
from tests.storage.importers.test_videos import NAMES, films, find
from tests.support import ring


def rows(values: np.ndarray) -> str:
    return "\n".join(" ".join(repr(float(x)) for x in row) for row in np.atleast_2d(values))


def write(base: Path, last_row: bool = False, change: Callable[[str], str] = lambda t: t) -> None:
    """A file a camera, named after its video; `change` spoils that of the last."""
    for v, name in enumerate(NAMES):
        pose = ring.pose(v)
        pose[:3, 3] *= 1000
        parts = [
            f"{ring.SIZE[0]}\n{ring.SIZE[1]}\n{rows(ring.intrinsics(v))}",
            rows(pose if last_row else pose[:3]),
            rows(ring.DISTORTION),
        ]
        text = "\n\n".join(parts) + "\n"
        (base / f"{name}.mp4.calib").write_text(change(text) if v == 2 else text)


@pytest.fixture
def base(tmp_path: Path) -> Path:
    films(tmp_path)
    return tmp_path


@pytest.mark.parametrize("last_row", [False, True])
def test_cameras(base: Path, last_row: bool) -> None:
    write(base, last_row)
    capture = find_capture("auto", base, {})
    ring.check_cameras(capture, (0, 1, 2))
    np.testing.assert_allclose(capture.rig.distortion[0, :5], ring.DISTORTION)
    assert {"layout: videos", "unit: 0.001 m, as the format has it"} < {*capture.notes}
    for name in NAMES:
        (base / f"{name}.mp4.calib").rename(base / f"{name}.calib")
    ring.check_cameras(find(base), (0, 1, 2))


def test_wrong_conventions_and_broken_files_get_a_sentence(base: Path) -> None:
    def metres(text: str) -> str:
        place = 1000 * ring.pose(2)[:3, 3]
        for x in place:
            assert repr(float(x)) in text
            text = text.replace(repr(float(x)), repr(float(x) * 1000))
        return text

    for change, said in (
        (metres, "is it in millimetres"),
        (lambda t: t.replace("64\n48", "64 48"), "must hold width, height, .*; its lines have 2, 3, 3, 3, 4"),
        (lambda t: t.replace("64\n", "x\n", 1), "cam2: picture size .* is not made of numbers"),
        (lambda t: t.replace("64\n", "64.5\n", 1), r"cam2: picture size \[64.5, 48.0\] px must be two whole numbers"),
        (lambda t: t.replace("64\n48", "128\n96"), "camera cam2: .* are for pictures of another size"),
        (lambda _: "", "must hold width"),
    ):
        write(base, change=change)
        with pytest.raises(UserError, match=said):
            find(base)
    for v, name in enumerate(NAMES):
        inverted = np.linalg.inv(ring.pose(v))[:3]
        inverted[:, 3] *= 1000
        text = f"64\n48\n{rows(ring.intrinsics(v))}\n{rows(inverted)}\n{rows(ring.DISTORTION)}\n"
        (base / f"{name}.mp4.calib").write_text(text)
    with pytest.raises(UserError, match="the poses were written in the other direction"):
        find(base)
