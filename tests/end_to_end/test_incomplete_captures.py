"""A capture without truth, without joints or without masks runs too; what does not apply is said to be not needed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import zarr
from typer.testing import CliRunner

from posegaussian.dags.cli.app import app
from posegaussian.stages.registry import STAGES
from posegaussian.storage.readers import images
from tests.support.pipeline import Pipeline, film


@pytest.mark.parametrize(
    ("missing", "held_out", "not_needed"),
    [
        ({"joints": False}, "[mid00]", {"pose", "smoothing", "survey"}),
        ({"masks": False}, "[mid00]", set()),
        ({"depth": False}, "[]", {"metrics", "survey"}),
        ({"depth": False, "joints": False, "masks": False}, "[]", {"pose", "smoothing", "metrics"}),
    ],
)
def test_a_capture_that_lacks_something_runs(
    missing: dict[str, bool], held_out: str, not_needed: set[str], tmp_path: Path
) -> None:
    film(tmp_path / "capture", views=4, frames=3, **missing)
    pipeline = Pipeline(tmp_path / "archive", tmp_path / "capture", held_out=held_out)
    pipeline.register()
    plan = pipeline.plan()
    told_elsewhere = {"detection", "tracks", "people", "judge"}
    assert set(plan.unneeded) - {s.name for s in STAGES if s.optional} - told_elsewhere == not_needed
    assert "detection" in plan.unneeded, "joints came with the capture, or nobody estimates them"
    assert all(reason for reason in plan.unneeded.values())
    pipeline.run()
    assert pipeline.plan().all_fresh


def test_export_of_any_path_works_without_truth(tmp_path: Path) -> None:
    film(tmp_path / "capture", views=4, frames=3, held_out=0, depth=False, joints=False)
    runner = CliRunner()
    archive = ["--archive", str(tmp_path / "archive"), "--set", "run.scheduler=serial"]
    done = runner.invoke(app, ["import", "images", str(tmp_path / "capture"), "--sequence", "walk", *archive])
    assert done.exit_code == 0, done.output
    for path in ("orbit", "arc cam00 cam01", "still cam02"):
        out = tmp_path / path.replace(" ", "_")
        done = runner.invoke(
            app, ["export", "walk", "--path", path, "--video", f"{out}.mp4", "--frames", str(out), *archive]
        )
        assert done.exit_code == 0, done.output
        pictures = sorted(out.rglob("*.png"))
        assert [p.name for p in pictures] == ["000000.png", "000001.png", "000002.png"]
        assert images.read_picture(pictures[0]).max() > 50, f"{path} shows nothing"
        assert (out / "frames.csv").read_text().splitlines()[0] == "frame,index,time"
        assert Path(f"{out}.mp4").stat().st_size > 500


def test_a_frame_that_one_camera_lacks_does_not_carve_the_others(tmp_path: Path) -> None:
    film(tmp_path / "capture", views=6, frames=3, held_out=1)
    for kind in ("images", "masks", "depth"):
        next((tmp_path / "capture" / kind / "cam03").glob("000001.*")).unlink()
    pipeline = Pipeline(tmp_path / "archive", tmp_path / "capture")
    pipeline.register()
    pipeline.run()
    group = zarr.open_group(pipeline.root / "person", mode="r")
    valid = np.asarray(group["frames/valid"][...])
    assert not valid[1, 3]
    assert valid.sum() == valid.size - 1
    depth = np.asarray(group["depth/depth"][...])
    assert (depth[1, 3] == 0).all()
    others = (depth[:, [0, 1, 2, 4, 5]] > 0).sum(axis=(2, 3))
    assert (others[1] > 0.8 * others[0]).all(), "a missing picture must not carve the hull of the others"


def test_a_picture_without_a_mask_is_left_out_where_masks_are_used(tmp_path: Path) -> None:
    """Its frame is made of the other cameras, to the bit as if the picture were not there; without masks it is used."""
    film(tmp_path / "capture", views=4, frames=2, held_out=1)
    made = []
    for kind in ("masks", "images"):
        next((tmp_path / "capture" / kind / "cam02").glob("000001.*")).unlink()
        pipeline = Pipeline(tmp_path / kind, tmp_path / "capture", ["views.trust=auto", "effects.gap_opening=auto"])
        pipeline.register()
        assert [len(s.numbers) for s in pipeline.context().capture.pictures] == [2, 2, 1, 2, 2]
        pipeline.run()
        group = zarr.open_group(pipeline.root / "person", mode="r")
        made.append([np.asarray(group[a][...]) for a in ("frames/valid", "depth/depth", "gaussians/scale")])
        if kind == "masks":
            unused = pipeline.with_settings("frames.matte=none").context().capture
            assert [len(s.numbers) for s in unused.pictures] == [2, 2, 2, 2, 2]
    for unmasked, gone in zip(*made, strict=True):
        np.testing.assert_array_equal(unmasked, gone)
    assert np.argwhere(~made[0][0]).tolist() == [[1, 2]]


def test_a_single_frame_gets_an_orbit_of_48_steps(tmp_path: Path) -> None:
    film(tmp_path / "capture", views=4, frames=1, held_out=0)
    pipeline = Pipeline(tmp_path / "archive", tmp_path / "capture", held_out="[]")
    pipeline.register()
    pipeline.run("orbit")
    assert [p.served.shape for p in pipeline.context("orbit").paths.values()] == [(1, 48)]
