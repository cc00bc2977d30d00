"""A finished sequence leaves in another tool's layout and comes in again: cameras, pictures and masks are those of the
frames."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from posegaussian.dags.export.layouts import export_layout, needed
from posegaussian.dags.export.request import ExportOrder
from posegaussian.dags.planning.results import Results
from posegaussian.storage.exporters.layouts.registry import LAYOUTS
from posegaussian.storage.formats.colmap_model import read_model
from posegaussian.storage.importers.find import find_capture
from posegaussian.storage.model.errors import ConfigError, ShardMissing, UserError
from posegaussian.storage.readers.sources import open_source
from tests.dags.cli.test_cli import assert_says, posegaussian
from tests.support.pipeline import NAME, Pipeline, film


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Pipeline:
    folder = tmp_path_factory.mktemp("layouts")
    film(folder / "capture", views=3, frames=3)
    pipeline = Pipeline(
        folder / "archive", folder / "capture", ["depth.method=truth", "frames.range=1:3", "rendering.paths=[]"]
    )
    pipeline.register()
    pipeline.run()
    return pipeline


@pytest.mark.parametrize("name", LAYOUTS)
def test_the_capture_that_comes_back_is_the_one_that_was_worked_on(made: Pipeline, tmp_path: Path, name: str) -> None:
    results = Results(made.context())
    said = export_layout(results, name, tmp_path / "out", None)
    context = results.context
    assert f"{2 * len(context.active_views)} pictures with masks" in said[0]
    capture = find_capture("auto", tmp_path / "out", {})
    assert capture.layout == name
    assert capture.numbers.tolist() == [1, 2]
    for own, cam in enumerate(capture.rig.names):
        v = context.rig.index(cam)
        w, h = context.rig.size[v]
        np.testing.assert_allclose(capture.rig.intrinsics[own], context.rig.intrinsics[v], atol=1e-12)
        np.testing.assert_allclose(capture.rig.world_to_camera[own], context.rig.world_to_camera[v], atol=1e-12)
        for kind, array in (("pictures", "frames/color"), ("masks", "frames/mask")):
            back = list(open_source(capture, kind).read(own, [1, 2]))
            np.testing.assert_array_equal(back, results.read(array, range(2), v)[:, :h, :w])


def test_one_instant_and_its_cloud(made: Pipeline, tmp_path: Path) -> None:
    results = Results(made.context())
    export_layout(results, "colmap", tmp_path, 2)
    model = read_model(tmp_path / "sparse" / "0")
    assert {i.name.rpartition("/")[2] for i in model.images} == {"000002.png"}
    context = results.context
    raw = (tmp_path / "sparse" / "0" / "points3D.bin").read_bytes()
    assert int.from_bytes(raw[:8], "little") > 100
    point = np.dtype([("id", "<u8"), ("at", "<f8", 3), ("color", "u1", 3), ("error", "<f8"), ("track", "<u8")])
    points = np.frombuffer(raw, point, offset=8)
    view = context.active_views[1]
    pose, k = context.rig.world_to_camera[view], context.rig.intrinsics[view]
    seen = (points["at"] @ pose[:3, :3].T + pose[:3, 3]) @ k.T
    column, row = np.floor(seen[:, :2] / seen[:, 2:]).astype(int).T
    assert (results.read("frames/mask", range(1, 2), view)[0][row, column] > 0).mean() > 0.9
    assert {p.partition for p in needed(context, "colmap", 2)} == {0}
    assert {p.view for p in needed(context, "colmap", 2)} == set(context.active_views)


@pytest.mark.parametrize("name", LAYOUTS)
def test_a_cloud_is_made_and_told_where_the_layout_has_one(made: Pipeline, tmp_path: Path, name: str) -> None:
    """Without one no Gaussian is read, no point is told, and a budget says nothing."""
    context, cloud = made.context(), name in ("colmap", "nerfstudio")
    results = Results(context)
    read: list[str] = []
    own = results.read
    results.read = lambda array, *rest, **more: (read.append(array), own(array, *rest, **more))[1]  # type: ignore[method-assign]
    (said, *_) = export_layout(results, name, tmp_path, None)
    assert ("points of frame 1" in said) == cloud
    lifted = {product.array for product in needed(context, name, None)} - {"frames/color", "frames/mask"}
    assert bool(lifted) == cloud
    assert (set(read) <= {"frames/color", "frames/mask"}) != cloud
    orders = {"layout": name, "folder": tmp_path, "budget": 0.1}
    if cloud:
        assert ExportOrder(**orders).budget == 0.1  # type: ignore[arg-type]
        return
    with pytest.raises(
        ConfigError, match=r"add --splats FOLDER or --to LAYOUT, one with a cloud \(colmap, nerfstudio\)"
    ):
        ExportOrder(**orders)  # type: ignore[arg-type]
    assert ExportOrder(**orders, splats=tmp_path).budget == 0.1, "it is one of the splats"  # type: ignore[arg-type]


def test_a_cloud_within_its_budget_is_not_said_to_be_merged(made: Pipeline, tmp_path: Path) -> None:
    said = export_layout(Results(made.context()), "colmap", tmp_path, 1, budget=1e6)
    assert said[0].endswith("points of frame 1, within --budget 1000000, none merged")


def test_what_cannot_be_asked_for_is_refused(made: Pipeline, tmp_path: Path) -> None:
    def order(**more: object) -> ExportOrder:
        return ExportOrder(**more)  # type: ignore[arg-type]

    with pytest.raises(ConfigError, match="--to blender: unknown layout; known are colmap, nerfstudio"):
        order(layout="blender", folder=tmp_path)
    with pytest.raises(ConfigError, match="--frame 2: it chooses the instant of --to LAYOUT"):
        order(frame=2, splats=tmp_path)
    with pytest.raises(ConfigError, match="--frame 7: sequence person has source frames 1 to 2"):
        order(layout="colmap", folder=tmp_path, frame=7).needed(made.context())


def test_a_camera_that_a_layout_cannot_hold_is_refused_before_the_run(tmp_path: Path) -> None:
    film(tmp_path / "capture", views=3, size=32, frames=1, masks=False, joints=False, depth=False)
    cameras, images = tmp_path / "capture/cameras.json", tmp_path / "capture/images"
    cameras.write_text(cameras.read_text().replace("cam01", "left cam"))
    (images / "cam01").rename(images / "left cam")
    pipeline = Pipeline(tmp_path / "archive", tmp_path / "capture", ["depth.method=hull"])
    pipeline.register()
    (tmp_path / "out").mkdir()

    def order(layout: str) -> ExportOrder:
        return ExportOrder(layout=layout, folder=tmp_path / "out")

    with pytest.raises(UserError, match=r"--to easymocap: camera 'left cam' cannot be a key of OpenCV's YAML"):
        order("easymocap").check(pipeline.context())
    order("colmap").check(pipeline.context())


def test_the_command_makes_again_what_was_dropped_and_writes_it(made: Pipeline, tmp_path: Path) -> None:
    dropping = ["run.keep=as_declared", "depth.method=truth", "frames.range=1:3"]
    own = Pipeline(tmp_path / "archive", made.folder, dropping)
    own.register()
    own.run()
    with pytest.raises(ShardMissing, match="was dropped to save space"):
        Results(own.context()).read("frames/color", range(1), 0)
    done = posegaussian(
        "export", NAME, "--to", "nerfstudio", "--frame", "1", "--budget", "60", *own.options, cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    assert "nerfstudio: 4 pictures with masks of 4 cameras" in done.stdout
    assert "60 points of frame 1, merged from" in done.stdout
    assert find_capture("nerfstudio", tmp_path / f"{NAME}-nerfstudio", {}).numbers.tolist() == [1]
    shown = posegaussian("export", NAME, "--to", "blender", *own.options, cwd=tmp_path)
    assert_says(shown, "unknown layout; known are colmap, nerfstudio, easymocap, images")
