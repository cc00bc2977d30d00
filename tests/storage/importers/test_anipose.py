"""anipose's and FreeMoCap's TOML for `import videos`: the unit follows from how far cameras lie apart."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from posegaussian.storage.importers.find import find_capture
from posegaussian.storage.model.errors import UserError
from tests.storage.importers.test_opencv_storage import rodrigues
from tests.storage.importers.test_videos import NAMES, films, find
from tests.support import ring


def write(base: Path, units: float = 1000.0, more: str = "") -> None:
    """Tables as FreeMoCap writes them, `units` in a metre; `more` goes into the last."""
    text = ""
    for v, name in enumerate(NAMES):
        text += f'[cam_{v}]\nname = "{name}"\nsize = [{ring.SIZE[0]}, {ring.SIZE[1]}]\n'
        text += f"matrix = {ring.intrinsics(v).tolist()}\ndistortions = {ring.DISTORTION.tolist()}\n"
        text += f"rotation = {rodrigues(ring.rotation(v)).tolist()}\n"
        text += f"translation = {(units * ring.translation(v)).tolist()}\n"
    (base / "calibration.toml").write_text(f"{text}{more}[metadata]\ncharuco_square_size = {0.039 * units}\n")


@pytest.fixture
def base(tmp_path: Path) -> Path:
    films(tmp_path)
    return tmp_path


def test_millimetres_are_told_by_distances(base: Path) -> None:
    write(base)
    capture = find_capture("auto", base, {})
    ring.check_cameras(capture, (0, 1, 2))
    np.testing.assert_allclose(capture.rig.distortion[0, :5], ring.DISTORTION)
    apart = 1000 * np.linalg.norm(ring.centre(0) - ring.centre(2))
    assert "layout: videos" in capture.notes
    assert (
        f"unit: 0.001 m, as cameras lie up to {apart:.4g} units apart, which are millimetres; the option scale"
        " overrules it"
    ) in capture.notes


def test_metres_are_left_to_pose2sim_and_read_here_by_name(base: Path) -> None:
    write(base, 1.0)
    assert "layout: pose2sim" in find_capture("auto", base, {}).notes
    capture = find(base)
    ring.check_cameras(capture, (0, 1, 2))
    assert any(n.startswith("unit: taken as metres, as cameras lie up to 3.") for n in capture.notes)


def test_another_unit_is_asked_for(base: Path) -> None:
    write(base, 1 / 0.039)  # squares of the board
    with pytest.raises(UserError, match=r"lie up to 9\d\.\d+ units apart; .* say --option distance=cam0,cam2,METRES"):
        find(base)
    ring.check_cameras(find(base, scale=0.039), (0, 1, 2))


def test_broken_tables_get_a_sentence(base: Path) -> None:
    for more, said in (
        ("fisheye = true\n", "camera cam2: fisheye = true"),
        ('[cam_9]\nname = "cam2"\nmatrix = []\n', "two cameras are named cam2; rename one"),
        ("rotation = []\n", "cannot be read"),
    ):
        write(base, more=more)
        with pytest.raises(UserError, match=said):
            find(base)
    write(base, more="ignore = true\n")
    assert "cam2 has no calibration in calibration.toml and is left out" in find(base).notes
    (base / "calibration.toml").write_text("matrix = 1\n")
    with pytest.raises(UserError, match="has no camera with matrix, rotation and translation"):
        find(base)
