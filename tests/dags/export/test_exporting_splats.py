"""Gaussians as splat files: what is read back is what rendering lifts, of the views asked for, frame by frame."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from posegaussian.dags.export.request import ExportOrder
from posegaussian.dags.export.splats import chosen_views, export_splats, needed
from posegaussian.dags.planning.results import Results
from posegaussian.stages.rendering.lift import GaussianMaps, lift
from posegaussian.stages.rendering.sources import unrefined_arrays
from posegaussian.stages.splatting.splat_scene import scene_of
from posegaussian.storage.formats.splat_ply import read_splats
from posegaussian.storage.model.errors import ConfigError, UserError
from tests.dags.cli.test_cli import assert_says, posegaussian
from tests.support.pipeline import NAME, Pipeline, film


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Pipeline:
    folder = tmp_path_factory.mktemp("splats")
    film(folder / "capture", views=3, frames=3)
    pipeline = Pipeline(
        folder / "archive", folder / "capture", ["depth.method=truth", "frames.range=1:3", "rendering.paths=[]"]
    )
    pipeline.register()
    pipeline.run()
    return pipeline


def test_reading_back_gives_the_gaussians_that_rendering_lifts(made: Pipeline, tmp_path: Path) -> None:
    results = Results(made.context())
    said = export_splats(results, (), tmp_path / "out")
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["000001.ply", "000002.ply"]
    context = results.context
    assert "2 files" in said[0]
    assert all(context.views.names[v] in said[0] for v in context.views.sources)
    for frame, number in enumerate(context.source_frames):
        read = read_splats(tmp_path / "out" / f"{number:06d}.ply")
        assert read.splats.degree == 0
        back = scene_of(read.splats, torch.float64)
        start = 0
        for view in context.views.sources:
            maps = GaussianMaps(
                *(results.read(a, range(frame, frame + 1), view)[0] for a in unrefined_arrays(frozenset()))
            )
            g = lift(
                maps,
                context.rig.intrinsics[view],
                context.rig.world_to_camera[view],
                torch.float64,
                torch.device("cpu"),
            )
            n = len(g.mean)
            assert n > 100
            rows = slice(start, start + n)
            start += n
            # float32 of metres up to 4, of logarithms up to 10, of unit quaternions, of logits up to 5
            torch.testing.assert_close(back.mean[rows], g.mean, rtol=0, atol=3e-7)
            torch.testing.assert_close(back.scale[rows], g.scale, rtol=1e-6, atol=0)
            torch.testing.assert_close(back.rotation[rows], g.rotation, rtol=0, atol=1e-6)
            torch.testing.assert_close(back.opacity[rows], g.faces[:, 0], rtol=0, atol=1e-6)
            torch.testing.assert_close(0.5 + back.harmonics[rows, 0] * 0.28209479177387814, g.color, rtol=0, atol=1e-7)
        assert start == len(read.splats)


def test_names_and_kinds_of_files(made: Pipeline, tmp_path: Path) -> None:
    results = Results(made.context())
    for kind, names in (("sequence", ["frame0001.ply", "frame0002.ply"]), ("spz", ["000001.spz", "000002.spz"])):
        export_splats(results, (), tmp_path / kind, kind)
        assert sorted(p.name for p in (tmp_path / kind).iterdir()) == names
    with pytest.raises(UserError, match=r"splat files of something else, for example 000001.spz"):
        export_splats(results, (), tmp_path / "spz", "sequence")
    with pytest.raises(ConfigError, match="--splats-as splat: unknown; known are ply, spz, sequence"):
        export_splats(results, (), tmp_path / "other", "splat")


def test_a_budget_leaves_no_more_and_says_of_how_many(made: Pipeline, tmp_path: Path) -> None:
    results = Results(made.context())
    export_splats(results, (), tmp_path / "all")
    said = export_splats(results, (), tmp_path / "tenth", budget=0.1)
    export_splats(results, (), tmp_path / "count", budget=150)
    whole = export_splats(results, (), tmp_path / "whole", budget=1)
    lifted = []
    for name in ("000001.ply", "000002.ply"):
        full, tenth, count = (read_splats(tmp_path / f / name).splats for f in ("all", "tenth", "count"))
        assert 0.05 * len(full) < len(tenth) <= 0.1 * len(full)
        assert len(count) == 150
        assert np.abs(tenth.mean.mean(axis=0) - full.mean.mean(axis=0)).max() < 0.1
        assert (tmp_path / "whole" / name).read_bytes() == (tmp_path / "all" / name).read_bytes()
        lifted.append(len(full))
    assert f"merged from {min(lifted)} to {max(lifted)} (--budget 0.1)" in said[0]
    assert whole[0].endswith("; within --budget 1, none merged")


def test_budgets_that_cannot_be_are_refused(tmp_path: Path) -> None:
    def order(budget: float, splats: Path | None) -> ExportOrder:
        return ExportOrder(video=tmp_path / "a.mp4", splats=splats, budget=budget)

    assert order(0.1, tmp_path / "out").budget == 0.1
    with pytest.raises(ConfigError, match=r"--budget 1\.5: .* a share above 0 and up to 1, or a whole number"):
        order(1.5, tmp_path / "out")
    with pytest.raises(ConfigError, match=r"--budget 0\.1: .* add --splats FOLDER or --to LAYOUT"):
        order(0.1, None)


def test_gsply_reads_both_kinds(made: Pipeline, tmp_path: Path) -> None:
    gsply = pytest.importorskip("gsply", reason="gsply (extra dev) is not installed")
    results = Results(made.context())
    for kind in ("ply", "spz"):
        export_splats(results, (), tmp_path / kind, kind)
    whole, small = gsply.plyread(tmp_path / "ply" / "000001.ply"), gsply.read_spz(tmp_path / "spz" / "000001.spz")
    ours = read_splats(tmp_path / "ply" / "000001.ply").splats
    np.testing.assert_array_equal(whole.means, ours.mean)
    np.testing.assert_array_equal(whole.quats, ours.quaternion)
    np.testing.assert_allclose(small.means, ours.mean, atol=0.5 * 2.0**-12 + 1e-6)  # fixed point of 12 bits


def test_spz_takes_a_quarter_to_a_sixth_of_the_bytes(made: Pipeline, tmp_path: Path) -> None:
    results, whole, small = Results(made.context()), tmp_path / "ply", tmp_path / "spz"
    export_splats(results, (), whole, "ply")
    export_splats(results, (), small, "spz")
    for file in small.iterdir():
        assert 4 <= (whole / f"{file.stem}.ply").stat().st_size / file.stat().st_size <= 6


def test_the_surface_is_where_the_person_stands(made: Pipeline, tmp_path: Path) -> None:
    """Means projected into a view that they were not lifted from fall on its mask."""
    results = Results(made.context())
    context = results.context
    first, other = context.views.sources[:2]
    export_splats(results, [context.views.names[first]], tmp_path)
    mean = read_splats(tmp_path / "000001.ply").splats.mean.astype(np.float64)
    pose, k = context.rig.world_to_camera[other], context.rig.intrinsics[other]
    seen = (mean @ pose[:3, :3].T + pose[:3, 3]) @ k.T
    column, row = np.floor(seen[:, :2] / seen[:, 2:]).astype(int).T
    mask = results.read("frames/mask", range(1), other)[0]
    assert (mask[row, column] > 0).mean() > 0.9


def test_views_that_have_no_gaussians_are_refused(made: Pipeline) -> None:
    context = made.context()
    assert chosen_views(context, ()) == context.views.sources
    name = context.views.names[context.views.sources[1]]
    assert chosen_views(context, [name, name]) == (context.views.sources[1],)
    with pytest.raises(ConfigError, match="mid00: no source view"):
        chosen_views(context, ["mid00"])


def test_files_of_another_export_are_not_mixed_in(made: Pipeline, tmp_path: Path) -> None:
    (tmp_path / "000000.ply").write_bytes(b"")
    with pytest.raises(UserError, match=r"000000\.ply; empty it"):
        export_splats(Results(made.context()), (), tmp_path)


def test_what_was_dropped_is_made_again_for_it(made: Pipeline, tmp_path: Path) -> None:
    """With `run.keep: as_declared` Gaussians are gone after a run; the command has them made, and renders nothing."""
    archive = made.copy(tmp_path / "archive").with_settings("run.keep=as_declared")
    archive.run()
    context = archive.context()
    assert {p.array for p in needed(context, context.views.sources)} == set(unrefined_arrays(frozenset()))
    view = context.views.names[context.views.sources[0]]
    done = posegaussian("export", NAME, "--splats", "out", "--view", view, *archive.options, cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"of {view}" in done.stdout
    assert len(read_splats(tmp_path / "out" / "000002.ply").splats) > 100
    assert not (archive.root / NAME / "rendering").exists()
    assert_says(
        posegaussian("export", NAME, "--splats", "out", "--view", "nobody", *archive.options, cwd=tmp_path),
        "--view nobody",
        view,
    )
    assert_says(posegaussian("export", NAME, *archive.options, cwd=tmp_path), "--splats FOLDER")
