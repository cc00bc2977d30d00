"""A single source camera, with and without depth maps, masks and joints: it runs, renders what lies near it, and
says what it can give."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from posegaussian.dags.cli.app import app
from posegaussian.dags.diagnostics.effects_table import effects_reasons
from posegaussian.dags.planning.results import Results
from posegaussian.dags.runtime.events import TaskDone
from posegaussian.storage.exporters.images_layout import write_capture
from posegaussian.storage.readers import images
from tests.support.pipeline import Pipeline, assert_same_content, content, film

AUTO = [
    "depth.method=auto",
    *(f"effects.{e}=off" for e in ("temporal_smoothing", "silhouette_clipping", "hole_filling", "outline_evening")),
]


def one_camera(
    tmp_path: Path, *settings: str, maps: bool = False, partition: int = 2, name: str = "archive", **leave_out: bool
) -> Pipeline:
    folder = tmp_path / "capture"
    if not folder.exists():
        person = film(folder, views=1, size=64, frames=3, held_out=0, depth=False, **leave_out)
        if maps:
            write_capture(folder, person.rig, None, depth_maps=person.depth, numbers=range(3))
    pipeline = Pipeline(tmp_path / name, folder, [*AUTO, *settings], partition, held_out="[]")
    pipeline.register()
    return pipeline


def alpha(pipeline: Pipeline) -> np.ndarray:
    results = Results(pipeline.context())
    (path,) = results.context.paths.values()
    return np.asarray(results.read(f"rendering/{path.name}/alpha", range(3)))


@pytest.mark.parametrize("maps", [False, True], ids=["relief", "given"])
@pytest.mark.parametrize("leave_out", [{}, {"joints": False}, {"masks": False}], ids=["all", "no joints", "no masks"])
def test_one_camera_runs_and_says_what_it_can_give(maps: bool, leave_out: dict[str, bool], tmp_path: Path) -> None:
    # Three frames are no background plate.
    pipeline = one_camera(tmp_path, *(["frames.matte=none"] if "masks" in leave_out else []), maps=maps, **leave_out)
    plan = pipeline.plan()
    (note,) = [n for n in plan.notes if "cam00 is the only source view" in n]
    assert f"up to {20 if maps else 10} degrees" in note
    assert ("by assumption" in note) != maps
    assert any(r.startswith(f"depth.method {'given' if maps else 'relief'}: ") for r in effects_reasons(plan))
    assert [p.kind for p in plan.context.paths.values()] == ["sway"]
    done = [e for e in pipeline.run() if isinstance(e, TaskDone)]
    assert not [w for e in done if e.task.stage in ("pose", "depth", "rendering") for w in e.receipt.warnings]
    assert pipeline.plan().all_fresh
    assert (alpha(pipeline) > 200).mean() > 0.05, "somebody is seen"


def test_the_partition_length_does_not_change_a_byte(tmp_path: Path) -> None:
    two, three = one_camera(tmp_path, name="two"), one_camera(tmp_path, name="three", partition=3)
    for p in (two, three):
        p.run()
    assert_same_content(content(two), content(three))


def test_the_assumed_distance_does_not_change_what_sway_shows(tmp_path: Path) -> None:
    """Seen by one camera, a small person nearby and a large one far away are the same picture."""
    shown = []
    for distance in (1.0, 4.0):
        pipeline = one_camera(tmp_path, f"depth.subject_distance={distance}", name=f"at_{distance}")
        pipeline.run()
        shown.append(alpha(pipeline).astype(int))
    assert np.abs(shown[0] - shown[1]).max() <= 2  # float32 and float16 of other depths and sizes
    assert shown[0].any()


def test_paths_beyond_the_useful_cone_are_named(tmp_path: Path) -> None:
    pipeline = one_camera(tmp_path)
    assert [n for n in pipeline.plan("orbit").notes if "degrees away from cam00" in n]
    assert not [n for n in pipeline.plan("sway cam00 8").notes if "degrees away from cam00" in n]


def test_a_subject_that_is_elsewhere_than_assumed_is_reported(tmp_path: Path) -> None:
    pipeline = one_camera(tmp_path, "depth.subject_distance=9", maps=True)
    warnings = [
        w for e in pipeline.run() if isinstance(e, TaskDone) and e.task.stage == "depth" for w in e.receipt.warnings
    ]
    assert warnings
    assert all("`sway` turns about a point at 9 m; set depth.subject_distance: 2." in w for w in warnings)


@pytest.mark.parametrize("method", ["sgbm", "sweep", "hull", "given"])
def test_methods_that_a_single_view_cannot_serve_are_refused(method: str, tmp_path: Path) -> None:
    from posegaussian.storage.model.errors import ConfigError

    with pytest.raises(ConfigError, match=f"depth.method is {method}.*use auto"):
        one_camera(tmp_path, f"depth.method={method}").plan()


def test_held_out_cameras_beside_a_single_source_are_measured(tmp_path: Path) -> None:
    person = film(tmp_path / "capture", views=1, size=64, frames=1, held_out=1)
    write_capture(tmp_path / "capture", person.rig.subset([0]), None, depth_maps=person.depth[:, :1], numbers=range(1))
    write_capture(tmp_path / "capture", person.rig, None)
    pipeline = Pipeline(tmp_path / "archive", tmp_path / "capture", AUTO)
    pipeline.register()
    assert "metrics" not in pipeline.plan().unneeded
    assert "given_depth" in pipeline.context().capture_facts, "held-out cameras need no depth maps"
    pipeline.run()
    assert pipeline.plan().all_fresh


def test_given_depth_of_many_views_shows_what_true_depth_shows(tmp_path: Path) -> None:
    person = film(tmp_path / "capture", views=6, size=64, frames=2)
    write_capture(tmp_path / "capture", person.rig, None, depth_maps=person.depth, numbers=range(2))
    shown = {}
    for method in ("auto", "truth"):
        p = Pipeline(tmp_path / method, tmp_path / "capture", [f"depth.method={method}"])
        p.register()
        p.run()
        results = Results(p.context())
        (path,) = results.context.paths.values()
        shown[method] = results.read(f"rendering/{path.name}/color", range(2)).astype(int)
        np.testing.assert_array_equal(results.read("depth/depth", range(2), 0) > 0, person.depth[:, 0] > 0)
    # Depth is the same; beside edges, confidence 1/2 takes 7 % of a Gaussian's opacity.
    assert np.abs(shown["auto"] - shown["truth"]).mean() < 0.5
    assert shown["auto"].any()


def test_export_of_one_camera_with_maps_in_millimetres(tmp_path: Path) -> None:
    import OpenImageIO as oiio

    person = film(tmp_path / "capture", views=1, size=64, frames=2, held_out=0, depth=False, joints=False)
    maps = tmp_path / "capture" / "depth_maps" / "cam00"
    maps.mkdir(parents=True)
    for f in range(2):
        out = oiio.ImageBuf(np.ascontiguousarray((person.depth[f, 0, ..., None] * 1000).round().astype(np.uint16)))
        assert out.write(str(maps / f"{f:06d}.png"))
    runner, archive = CliRunner(), ["--archive", str(tmp_path / "archive"), "--set", "run.scheduler=serial"]
    said = runner.invoke(app, ["import", "images", str(tmp_path / "capture"), "--sequence", "one", *archive])
    assert "--option depth_scale=0.001" in str(said.exception)
    said = runner.invoke(
        app,
        ["import", "images", str(tmp_path / "capture"), "--sequence", "one", "--option", "depth_scale=0.001", *archive],
    )
    assert said.exit_code == 0, said.output
    done = runner.invoke(app, ["export", "one", "--frames", str(tmp_path / "out"), *archive])
    assert done.exit_code == 0, done.output
    assert images.read_picture(next((tmp_path / "out").rglob("*.png"))).max() > 50


def test_a_view_that_becomes_a_source_brings_its_depth_maps_along(tmp_path: Path) -> None:
    """And a picture without a map is a hole with a warning, no failure."""
    person = film(tmp_path / "capture", views=2, size=48, frames=2, held_out=0, depth=False)
    write_capture(tmp_path / "capture", person.rig, None, depth_maps=person.depth, numbers=range(2))
    (tmp_path / "capture" / "depth_maps" / "cam01" / "000001.exr").unlink()
    one = Pipeline(tmp_path / "archive", tmp_path / "capture", [*AUTO, "views.sources=[cam00]"], held_out="[cam01]")
    one.register()
    one.run()
    both = Pipeline(one.root, one.folder, AUTO, held_out="[]")
    warnings = [w for e in both.run() if isinstance(e, TaskDone) for w in e.receipt.warnings] + list(
        map(str, both.plan().notes)
    )
    depth = Results(both.context()).read("depth/depth", range(2), 1)
    np.testing.assert_array_equal(depth[0] > 0, person.depth[0, 1] > 0)
    assert not depth[1].any()
    assert not [w for w in warnings if "only source view" in w]
