"""`import posegaussian`: what a notebook reads is what the archive holds, what it draws is what rendering drew."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import posegaussian
from posegaussian.dags.notebook.archive import NoSuchFrames
from posegaussian.dags.planning.plan import State
from posegaussian.dags.planning.results import Results
from posegaussian.dags.planning.selection import Selection
from posegaussian.storage.model.errors import ArchiveError, ShardMissing, UserError
from tests.support.pipeline import NAME, Pipeline


@pytest.fixture(scope="module")
def opened(finished: Pipeline) -> posegaussian.OpenSequence:
    settings = finished.assignments
    return posegaussian.open_archive(finished.root, settings)[NAME]


def test_importing_costs_nothing() -> None:
    code = "import sys, posegaussian; print([m for m in ('torch', 'numpy', 'zarr', 'dask') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_every_public_name_is_there_and_no_other() -> None:
    assert all(getattr(posegaussian, name) for name in posegaussian.__all__)
    with pytest.raises(AttributeError, match="open_archive"):
        _ = posegaussian.nothing


def test_arrays_are_read_as_results_are(opened: posegaussian.OpenSequence, finished: Pipeline) -> None:
    results = Results(finished.context())
    frames = range(results.context.grid.frames)
    for name in ("frames/color", "depth/depth"):
        info = opened.arrays()[name]
        view = results.context.views.sources[1]
        expected = results.read(name, frames, view)
        assert info.dims[:2] == ("frame", "view")
        assert info.meaning
        assert np.array_equal(opened.read(name, view=opened.views[view]), expected)
        assert np.array_equal(opened.read(name, 1, view), expected[1])
        every = opened.read(name, slice(1, 3))
        assert np.array_equal(every[:, results.views_of(name).index(view)], expected[1:3])
    assert np.array_equal(opened.read("frames/intrinsics"), results.context.rig.intrinsics)


def test_what_is_not_there_is_named(opened: posegaussian.OpenSequence) -> None:
    with pytest.raises(ArchiveError, match="no camera 'nobody'"):
        opened.read("depth/depth", view="nobody")
    with pytest.raises((ArchiveError, ShardMissing), match="rendering/none/color"):
        opened.read("rendering/none/color")
    with pytest.raises(ValueError, match="frames must be consecutive"):
        opened.read("depth/depth", range(99))
    with pytest.raises(ArchiveError, match="no group nothing"):
        opened.dataset("nothing")
    for read in (lambda: opened.read("depth/depth", 6), lambda: opened.gaussians(99), lambda: opened.gaussians(-7)):
        with pytest.raises(UserError, match=r"a frame must be within 0\.\.5, got -?\d+; these are all"):
            read()


@pytest.fixture(scope="module")
def short(finished: Pipeline, tmp_path_factory: pytest.TempPathFactory) -> Pipeline:
    """The archive after a run of its first three frames alone: the second partition holds one of two."""
    copy = finished.copy(tmp_path_factory.mktemp("short") / "archive")
    copy.with_settings("frames.range=0:3").run(selection=Selection(only=frozenset({"frames"})))
    return copy


@pytest.mark.parametrize("asked", ["0:6", "0:3", "0:2", "1:6", "2:4", "0:6:2", "2:3"])
def test_every_frame_that_is_asked_for_is_read_or_refused(
    short: Pipeline, opened: posegaussian.OpenSequence, asked: str
) -> None:
    """Whatever range the archive was made with and is opened with: never fewer frames, never another moment."""
    person = posegaussian.open_archive(short.root, [*short.assignments, f"frames.range={asked}"])[NAME]
    numbers, view = person.context.source_frames.tolist(), 0
    for first in range(len(numbers)):
        for last in range(first + 1, len(numbers) + 1):
            wanted = numbers[first:last]
            at_their_place = all(n == i for i, n in enumerate(wanted, start=first))
            if at_their_place and max(wanted) < 3:
                got = person.read("frames/color", range(first, last), view)
                np.testing.assert_array_equal(got, opened.read("frames/color", slice(first, last), view))
                continue
            with pytest.raises(ShardMissing, match=r"of sequence person.* run again"):
                person.read("frames/color", range(first, last), view)
    with pytest.raises(NoSuchFrames, match=rf"within 0\.\.{len(numbers) - 1}, got 50; ") as beyond:
        person.read("frames/color", 50, view)
    assert ("settings=['frames.range=" in str(beyond.value)) == (len(numbers) < 6)


def test_no_dimension_has_two_lengths_and_every_group_opens_in_xarray(opened: posegaussian.OpenSequence) -> None:
    pytest.importorskip("xarray")
    lengths: dict[tuple[str, str], set[int]] = {}
    for info in opened.arrays().values():
        group = info.name.rpartition("/")[0]
        for dim, length in zip(info.dims, info.shape, strict=True):
            lengths.setdefault((group, dim), set()).add(length)
    assert not {key: found for key, found in lengths.items() if len(found) > 1}
    for group in {group for group, _ in lengths}:
        dataset = opened.dataset(group)
        assert dataset.sizes, group
    color = opened.dataset("frames")["color"]
    assert np.array_equal(color[1, 0].values, opened.read("frames/color", 1, 0))


def test_gaussians_are_drawn_into_a_source_camera(opened: posegaussian.OpenSequence) -> None:
    """The Gaussians of one view, drawn where they were seen from, give back that view's picture within the mask."""
    view = opened.context.views.sources[0]
    gaussians = opened.gaussians(0, [view])
    picture = posegaussian.draw(gaussians, posegaussian.camera_of(opened.rig, view), background=(0, 0, 0))
    color, mask = opened.read("frames/color", 0, view), opened.read("frames/mask", 0, view) > 250
    assert picture.shape == color.shape
    # splatting blurs edges; over the inside of a flat-coloured person the mean error is a few grey levels
    assert np.abs(picture[mask].astype(int) - color[mask]).mean() < 16
    half = posegaussian.camera_of(opened.rig, view, height=int(opened.rig.size[view, 1]) // 2)
    assert posegaussian.draw(gaussians, half).shape[0] == int(opened.rig.size[view, 1]) // 2


def test_plan_and_run_are_those_of_the_command_line(finished: Pipeline, tmp_path: Path) -> None:
    copy = finished.copy(tmp_path / "archive")
    opened = posegaussian.open_archive(copy.root, [*copy.assignments, "run.scheduler=serial"])[NAME]
    plan = opened.plan(paths=["still cam00"])
    assert {v.task.stage for v in plan.verdicts.values() if v.state is not State.FRESH} == {"rendering"}
    opened.run(paths=["still cam00"])
    assert opened.plan(paths=["still cam00"]).all_fresh


def test_cameras_and_frames_that_are_not_there_are_told_with_those_there_are(
    opened: posegaussian.OpenSequence,
) -> None:
    cameras = ", ".join(opened.views)
    for view in ("cam99", 99, -99, 1.5):
        for asked in (
            lambda v=view: posegaussian.camera_of(opened.rig, v),
            lambda v=view: opened.read("frames/color", 0, v),
            lambda v=view: opened.gaussians(0, [v]),
        ):
            with pytest.raises(ArchiveError, match=f"no camera {view!r}; it has {cameras}: give one of these names"):
                asked()
    for frames in ("0", [0, 1], 0.5):
        with pytest.raises(NoSuchFrames, match="frames must be an index, a range or a slice"):
            opened.read("frames/color", frames)  # type: ignore[arg-type]
    last, index = opened.views[-1], np.int64(len(opened.views) - 1)
    for view in (-1, index):
        assert np.array_equal(
            posegaussian.camera_of(opened.rig, view).intrinsics, posegaussian.camera_of(opened.rig, last).intrinsics
        )
    assert np.array_equal(opened.read("frames/color", np.int64(1), index), opened.read("frames/color", 1, last))


def test_what_is_in_an_archive_is_what_it_gives(opened: posegaussian.OpenSequence, finished: Pipeline) -> None:
    archive = posegaussian.open_archive(finished.root, finished.assignments)
    assert NAME in archive
    assert "nobody" not in archive
    assert all(sequence in archive for sequence in archive)
    assert 0 not in archive


def test_a_view_is_refused_where_no_axis_has_views(opened: posegaussian.OpenSequence) -> None:
    for array in ("pose/joints3d", next(name for name in opened.arrays("rendering/*/color"))):
        assert len(opened.read(array, 0))
        for view in (opened.views[0], 0, "nobody"):
            with pytest.raises(ArchiveError, match=rf"{array} has no view axis \(its axes: frame, .*got view={view!r}"):
                opened.read(array, 0, view)


def test_gaussians_are_those_of_one_frame_and_of_source_views(opened: posegaussian.OpenSequence) -> None:
    for frame in (slice(1, 3), None, range(1), [0], "0", 0.0):
        with pytest.raises(NoSuchFrames, match=r"Gaussians are those of one frame, by its index within 0\.\.5, got"):
            opened.gaussians(frame)  # type: ignore[arg-type]
    sources = [opened.views[v] for v in opened.context.views.sources]
    held_out = next(name for name in opened.views if name not in sources)
    for views, told in (([], "no view"), (held_out, held_out), ([sources[0], held_out], held_out)):
        with pytest.raises(ArchiveError, match=f"source views {', '.join(sources)}, got {told}; leave views out"):
            opened.gaussians(0, views)
    twice = opened.gaussians(0, [sources[0], sources[0]])
    assert len(twice) == len(opened.gaussians(0, sources[0])), "a camera that is named twice has its Gaussians once"


def test_a_table_is_found_by_its_path_or_told(opened: posegaussian.OpenSequence) -> None:
    name = next(n for n, path in opened.context.paths.items() if path.kind == "held_out")
    rows = opened.table("metrics/{path}", name)
    assert rows
    assert opened.table("metrics/{path}", "held_out") == rows
    assert opened.table("metrics/{path}", opened.context.paths[name].text) == rows
    for wrong in ("../..", "held-out", ""):
        with pytest.raises(ArchiveError, match=rf"has no metrics/{{path}} of camera path '{wrong}'.*{name}"):
            opened.table("metrics/{path}", wrong)
    for wrong in ("metric", "metrics", "depth/depth"):
        with pytest.raises(ArchiveError, match=rf"no stage writes a table '{wrong}'; there is metrics/{{path}}"):
            opened.table(wrong, name)


def test_a_background_is_a_colour_or_refused(opened: posegaussian.OpenSequence) -> None:
    camera = posegaussian.camera_of(opened.rig, 0, height=8)
    for background in ((128, 128, 128), (-0.1, 0, 0), (0, 0, float("nan")), (0.5, 0.5), 1.0):
        with pytest.raises(ValueError, match=r"three numbers within 0\.\.1.*divide bytes by 255"):
            posegaussian.draw(opened.gaussians(0), camera, background)  # type: ignore[arg-type]
    corner = posegaussian.draw(opened.gaussians(0), camera, (0.5, 0.0, 1.0))[0, 0]
    assert corner.tolist() == [128, 0, 255]


def test_one_word_stands_for_a_list_of_one(opened: posegaussian.OpenSequence, finished: Pipeline) -> None:
    source = opened.context.views.sources[0]
    alone = opened.gaussians(0, [source])
    for one in (source, np.int64(source), opened.views[source]):
        assert len(opened.gaussians(0, one)) == len(alone)
    assert "still cam00" in opened.plan(paths="still cam00").context.path_texts
    assert opened.plan(only="depth", force="depth").to_make == opened.plan(only=["depth"], force=["depth"]).to_make
    assert posegaussian.open_archive(finished.root, "depth.method=hull").session.options[-1] == "depth.method=hull"


def test_what_a_cell_shows_fits_a_screen(opened: posegaussian.OpenSequence, finished: Pipeline) -> None:
    archive = posegaussian.open_archive(finished.root, "depth.method=hull")
    assert repr(archive) == f"<archive {finished.root} --set depth.method=hull>"
    assert repr(archive[NAME]) == f"<sequence {NAME} of {finished.root} --set depth.method=hull>"
    assert len(repr(opened)) < 200 + len(str(finished.root)), "of many settings the first"
    plan = opened.plan(force="depth")
    first, *stages = repr(plan).splitlines()
    assert first == f"plan of {NAME}: {len(plan.to_make)} of {len(plan.verdicts)} tasks to do"
    assert [line.partition(":")[0] for line in stages] == list(dict.fromkeys(t.stage for t in plan.verdicts))
    assert all(len(line) <= 160 for line in stages)
    (depth,) = (line for line in stages if line.startswith("depth: "))
    assert "stale; forced by --force depth (" in depth
    assert all(line.endswith(" fresh") for line in repr(opened.plan()).splitlines()[1:])


def test_the_example_of_the_package_is_true(opened: posegaussian.OpenSequence) -> None:
    """Every name that the package's docstring uses exists."""
    text = posegaussian.__doc__ or ""
    for name in ("open_archive", "draw", "camera_of"):
        assert f"posegaussian.{name}(" in text
    for method in ("arrays", "read", "dataset", "gaussians", "plan", "run"):
        assert f"person.{method}(" in text
        assert callable(getattr(opened, method))
    json.dumps(text)
