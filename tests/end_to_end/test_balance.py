"""The real four-camera capture, from its folder to a video of a camera that was never there."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from posegaussian.dags.cli.app import app
from posegaussian.storage.readers import images
from posegaussian.storage.readers.video import VideoFile

CONFIG = """
frames:
  range: "0:4:2"
  size: 320
pose: {joints_frame: calibrated}
survey: {sample: 9}
run: {scheduler: serial}
"""


@pytest.mark.captures
def test_balance_becomes_a_novel_view_video(captures: Path, tmp_path: Path) -> None:
    config = tmp_path / "balance.yaml"
    config.write_text(CONFIG)
    common = ["--archive", str(tmp_path / "archive"), "--config", str(config)]
    runner = CliRunner()
    done = runner.invoke(
        app, ["import", "pose2sim", str(captures / "captures" / "balance"), "--sequence", "balance", *common]
    )
    assert done.exit_code == 0, done.output
    video, frames, sheet = tmp_path / "out.mp4", tmp_path / "frames", tmp_path / "sheet.png"
    done = runner.invoke(
        app,
        [
            "export",
            "balance",
            "--path",
            "arc cam01 cam02",
            "--video",
            str(video),
            "--frames",
            str(frames),
            "--sheet",
            str(sheet),
            *common,
        ],
    )
    assert done.exit_code == 0, done.output
    assert VideoFile(video).count == 2
    pictures = [images.read_picture(p) for p in sorted(frames.rglob("*.png"))]
    assert [p.name for p in sorted(frames.rglob("*.png"))] == ["000000.png", "000002.png"]
    for picture in pictures:
        assert picture.shape == (320, 181, 3)
        lit = picture.max(axis=2) > 40
        # The person covers a few per cent of the picture; carved away it would cover none, without a matte all.
        assert 0.02 < lit.mean() < 0.15
        rows = np.nonzero(lit.any(axis=1))[0]
        assert rows[-1] - rows[0] > 80, "a standing person is taller than a quarter of the picture"
    assert images.read_picture(sheet).shape[0] > 500
