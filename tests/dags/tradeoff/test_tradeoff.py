"""Knobs are measured beside the user's results: shared where equal, timed where they differ, compared at one size."""

from __future__ import annotations

import errno
import os
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posegaussian.dags.budget.front_table import front_points
from posegaussian.dags.config.settings import load_configuration
from posegaussian.dags.diagnostics.held_out_quality import quality
from posegaussian.dags.planning.plan import make_plan
from posegaussian.dags.planning.results import Results
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.planning.tasks import Task
from posegaussian.dags.planning.variants import FOLDER, others, share, variant
from posegaussian.dags.runtime.executors import inline_run
from posegaussian.dags.runtime.executors.serial import SerialBackend
from posegaussian.dags.runtime.scheduler import Run
from posegaussian.dags.tradeoff import tradeoff
from posegaussian.dags.tradeoff.pareto import Level, pareto
from posegaussian.dags.tradeoff.tradeoff import chosen_levels, declared_knobs, run_tradeoff
from posegaussian.storage.archive.receipts import scan_receipts
from posegaussian.storage.model.errors import ConfigError, UserError
from posegaussian.storage.readers.images import read_picture
from tests.support.pipeline import NAME, Pipeline

KNOBS = ["depth.method", "frames.size"]


def files(folder: Path) -> dict[str, tuple[bytes, int]]:
    """{path: content and time of change} of every file of the user's sequence."""
    return {
        p.relative_to(folder).as_posix(): (p.read_bytes(), p.stat().st_mtime_ns)
        for p in sorted(folder.rglob("*"))
        if p.is_file()
    }


@pytest.fixture(scope="module")
def tried(finished: Pipeline, tmp_path_factory: pytest.TempPathFactory) -> tuple[Pipeline, list[Level], Path, dict]:
    """Hull and matching at half and full size, on two frames of a finished archive:
    (archive, levels, output, files before)."""
    folder = tmp_path_factory.mktemp("tradeoff")
    archive = finished.copy(folder / "archive").with_settings("frames.range=0:2")
    before = files(archive.root / NAME)
    levels = run_tradeoff(
        archive.session, None, KNOBS, ["depth.method=hull,sgbm", "frames.size=0.5,1.0,48"], 2, folder / "out"
    )
    return archive, levels, folder / "out", before


def level(tried: tuple, method: str, size: int | None) -> Level:
    return next(found for found in tried[1] if found.values == {"depth.method": method, "frames.size": size})


def test_the_levels_are_the_cross_product_and_equal_sizes_count_once(tried: tuple) -> None:
    assert sorted(str(found.values) for found in tried[1]) == sorted(
        str({"depth.method": m, "frames.size": s}) for m in ("hull", "sgbm") for s in (24, None)
    )


def test_no_byte_of_the_users_sequence_changes(tried: tuple) -> None:
    archive, _, _, before = tried
    assert files(archive.root / NAME) == before
    assert archive.session.archive.names() == [NAME], "variants are no sequences of the archive"


@pytest.mark.parametrize("links", [True, False])
def test_a_variant_under_equal_settings_takes_over_everything(
    finished: Pipeline, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, links: bool
) -> None:
    """By hard links, or by copies where the file system has none; a rerun there leaves the user's shards alone."""
    archive = finished.copy(tmp_path / "archive")
    mine = archive.context().sequence
    before = files(mine.root)
    if not links:
        monkeypatch.setattr(os, "link", lambda a, b: (_ for _ in ()).throw(OSError(errno.EPERM, "no links here")))
    context = variant(mine, archive.context().settings, {"nothing": "differs"}, ("held_out",))
    assert share(context, others(mine)) == len(archive.plan().verdicts)
    assert make_plan(context).all_fresh
    shards = [f.key for r in scan_receipts(mine) for o in r.outputs for f in o.files]
    assert all(os.path.samefile(mine.root / k, context.sequence.root / k) is links for k in shards)
    selection = Selection(start="depth")
    Run([make_plan(context, selection)], selection, SerialBackend(), []).go()
    again = [k for k in shards if k.startswith(("depth/", "rendering/"))]
    assert not any(os.path.samefile(mine.root / k, context.sequence.root / k) for k in again)
    assert files(mine.root) == before
    assert share(context, others(mine)) == 0


def test_constants_taken_together_with_others_are_taken_over(finished: Pipeline, tmp_path: Path) -> None:
    """A survey that took more than a variant asks for will do, as it does in the sequence itself; one of other pictures
    will not."""
    archive = finished.copy(tmp_path / "archive").with_settings(
        "effects.exposure_matching=auto", "effects.noise_averaging=auto"
    )
    archive.run(selection=Selection(only=frozenset({"survey"})))
    mine = archive.context().sequence
    taken = {r.view: r for r in scan_receipts(mine) if r.stage == "survey"}
    fewer = archive.with_settings("effects.exposure_matching=off")
    context = variant(mine, fewer.context().settings, {"fewer": "measures"}, ("held_out",))
    wanted = [t for t in make_plan(context).verdicts if t.stage == "survey"]
    assert wanted
    share(context, [mine])
    shared = {r.view: r for r in scan_receipts(context.sequence) if r.stage == "survey"}
    for task in wanted:
        assert shared[task.view].fingerprint == taken[task.view].fingerprint


def test_levels_share_what_they_have_in_common(tried: tuple) -> None:
    for stage in ("frames", "pose"):
        of_size = {s: {level(tried, m, s).identities[stage] for m in ("hull", "sgbm")} for s in (24, None)}
        assert all(len(found) == 1 for found in of_size.values())
        assert of_size[24] != of_size[None]


def test_levels_that_share_a_stage_share_its_seconds(tried: tuple) -> None:
    for size in (24, None):
        a, b = level(tried, "hull", size), level(tried, "sgbm", size)
        assert a.seconds["frames"] == b.seconds["frames"] > 0
        assert a.identities["depth"] != b.identities["depth"]
        assert a.total == pytest.approx(sum(a.seconds.values()))


def test_at_the_largest_size_quality_is_what_the_metrics_stage_says(tried: tuple, finished: Pipeline) -> None:
    rows = Results(finished.context()).table("metrics/{path}", next(iter(finished.context().paths)))
    for name, value in level(tried, "sgbm", None).quality.items():
        if name != "epe":
            measure, region = name.split()
            assert value == pytest.approx(
                np.mean(
                    [r["value"] for r in rows if (r["measure"], r["region"]) == (measure, region) and r["frame"] < 2]
                ),
                abs=1e-12,
            )


def test_small_pictures_are_compared_at_full_size(tried: tuple) -> None:
    """Against small truth the small level would look better than the full one."""
    small = level(tried, "sgbm", 24)
    assert small.quality["psnr box"] < level(tried, "sgbm", None).quality["psnr box"]
    assert quality(small.context, small.context)["psnr box"] > small.quality["psnr box"]


def test_the_table_is_kept_with_the_machine_and_the_picture_is_drawn(tried: tuple) -> None:
    archive, levels, out, _ = tried
    table = pq.read_table(out / "tradeoff.parquet")
    assert table.num_rows == 4
    assert {
        "depth.method",
        "frames.size",
        "depth s/frame",
        "total s/frame",
        "psnr box dB",
        "ssim full",
        "epe px",
        "front",
    } <= set(table.column_names)
    about = {k.decode(): v.decode() for k, v in table.schema.metadata.items()}
    assert "cores" in about["machine"]
    assert (about["repeats"], about["measured_at_px"]) == ("2", "48")
    reached = [p.reached for p in front_points(out / "tradeoff.parquet", [archive.context()])]
    assert reached == [r["psnr box dB"] for r in table.to_pylist() if r["front"]], "known with the settings it had"
    other = archive.with_settings("rendering.sources=1").context()
    assert {p.reached for p in front_points(out / "tradeoff.parquet", [other])} == {None}
    assert table["total s/frame"].to_pylist() == sorted(found.total for found in levels)
    assert table["front"].to_pylist()[0], "the cheapest is always on the front"
    picture = np.asarray(read_picture(out / "tradeoff.png"))
    assert min(picture.shape[:2]) > 400
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 10


def test_a_second_trade_off_makes_nothing_but_the_repeats(tried: tuple) -> None:
    archive, _, out, _ = tried
    variants = {p.name for p in (archive.root / FOLDER).iterdir()}
    again = run_tradeoff(archive.session, NAME, ["depth.method"], ["depth.method=hull,sgbm"], 1, out)
    assert len(again) == 2
    new = {p.name for p in (archive.root / FOLDER).iterdir()} - variants
    for name in new:
        shards = list((archive.root / FOLDER / name / NAME / "frames/color").glob("c.*"))
        assert shards
        assert all(os.stat(s).st_nlink > 1 for s in shards), "pictures are links to the ones that exist"


def test_without_held_out_cameras_it_is_refused_in_a_sentence(finished: Pipeline) -> None:
    session = Pipeline(finished.root, finished.folder, held_out="[]").session
    with pytest.raises(
        UserError,
        match=r"no held-out truth to measure against; name cameras to keep aside, .*views\.held_out=\[mid00\]",
    ):
        run_tradeoff(session, None, KNOBS, [], 1, None)


@pytest.mark.parametrize(
    ("knobs", "levels", "words"),
    [
        (
            ["depth.max_angle"],
            [],
            r"no such setting has quality levels; these have: .*depth\.method \['hull', 'sgbm', 'sweep'\]",
        ),
        (["depth.metod"], [], r'no such setting has quality levels; did you mean "depth\.method"\?'),
        (["depth.method=hull,sweep"], [], r"write --knob depth\.method --levels depth\.method=hull,sweep"),
        (
            ["depth.method"],
            ["frames.size=1,2"],
            r"write it as KNOB=LEVEL,LEVEL for a knob named by --knob \(depth\.method\)",
        ),
        (["depth.method"], ["depth.method=hull"], "is a single level on this capture"),
        (["depth.method"], ["depth.method=hull,magic"], r"depth\.method.*'magic'"),
        (["frames.size"], ["frames.size=1.5,0.5"], "a size in px, or a share"),
    ],
)
def test_wrong_knobs_and_levels_are_refused_in_a_sentence(
    finished: Pipeline, tmp_path: Path, knobs: list[str], levels: list[str], words: str
) -> None:
    with pytest.raises(ConfigError, match=words):
        tradeoff.measured(finished.copy(tmp_path / "archive").session, NAME, knobs, levels, 1)


def test_declared_sizes_beyond_the_capture_fall_together(finished: Pipeline) -> None:
    context = finished.context()
    assert chosen_levels(context, ["frames.size"], []) == {"frames.size": [None]}
    assert chosen_levels(context, ["frames.size"], ["frames.size=0.5,24,null,1000"]) == {"frames.size": [24, None]}
    own = finished.with_settings("frames.size=24").context()
    assert chosen_levels(own, ["frames.size"], ["frames.size=0.5,1.0"]) == {"frames.size": [24, None]}
    assert {"frames.size", "depth.method", "rendering.sources"} <= set(declared_knobs())


@given(st.lists(st.tuples(st.integers(0, 6), st.integers(0, 6)), min_size=1, max_size=12))
def test_the_front_is_what_no_other_point_beats(points: list[tuple[int, int]]) -> None:
    kept = [p for p, on in zip(points, pareto(points), strict=True) if on]
    assert kept
    for x, y in points:
        assert any(a <= x and b <= y for a, b in kept), "every point is matched by one of the front"
    for x, y in kept:
        assert not any((a <= x and b < y) or (a < x and b <= y) for a, b in kept), "no point of the front beats another"


def test_a_stage_is_timed_once_it_ran_in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its first task loads libraries, weights and kernels, under a setting of its own others; what another changes is
    the same."""
    took = iter([9.0, 1.0, 2.0, 8.0, 3.0])
    depth = Task("person", "depth", 0, None, None)
    receipt = SimpleNamespace(facts={})

    def run(*_: object, **__: object) -> dict[Task, object]:
        receipt.facts["seconds"] = next(took)
        return {depth: receipt}

    context = SimpleNamespace(unneeded=dict)
    monkeypatch.setattr(tradeoff, "make_plan", lambda *_: SimpleNamespace(verdicts={depth: None}))
    monkeypatch.setattr(tradeoff, "identities", lambda _: {"depth": "made"})
    monkeypatch.setattr(inline_run, "run_here", run)
    session = SimpleNamespace(configuration=load_configuration(None, []), say_line=print)
    clock = tradeoff.Clock(session)  # type: ignore[arg-type]
    for method, sources, times in (("hull", 1, [1.0]), ("hull", 2, [1.0, 2.0]), ("sgbm", 2, [1.0, 2.0, 3.0])):
        clock.run(Level({"depth.method": method, "rendering.sources": sources}, context))  # type: ignore[arg-type]
        assert clock.times["depth", "made"] == times
