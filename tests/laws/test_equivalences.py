"""The laws of the contract, over every stage of the registry at once: a whole run is compared array by array.

Compared are dtype, shape and bytes of every array and the rows of every table. Not compared are times, hosts and the
cutting into shards, which the laws are about.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from posegaussian.dags.planning.plan import State
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.runtime import threads
from posegaussian.dags.runtime.ordering import prepare
from posegaussian.stages.registry import STAGES
from posegaussian.storage.archive import ledger
from posegaussian.storage.archive.receipts import scan_receipts
from posegaussian.storage.archive.store import Archive
from tests.support.pipeline import NAME, Pipeline, assert_same_content, content, film, receipts


@pytest.mark.parametrize("length", [1, 4, 6])
def test_partitions_with_halo_equal_the_whole_sequence(length: int, finished: Pipeline, tmp_path: Path) -> None:
    other = Pipeline(tmp_path / "archive", finished.folder, partition=length)
    other.register()
    other.run()
    assert_same_content(content(other), content(finished))


@pytest.mark.parametrize(
    "settings",
    [
        ("smoothing.method=recurrent", "depth.method=hull", "rendering.precision=float64"),
        ("smoothing.method=adaptive", "depth.method=sweep", "effects.noise_averaging=on"),
        ("frames.matte=plate", "depth.method=truth"),
        ("frames.matte=person",),
        ("frames.matte=none",),
        ("effects.pose_blending=on", "depth.method=hull", "rendering.paths=[orbit]"),
    ],
    ids=", ".join,
)
def test_partition_law_holds_for_the_other_methods(
    settings: tuple[str, ...], person_folder: Path, tmp_path: Path
) -> None:
    found = []
    for length in (2, 6):
        pipeline = Pipeline(
            tmp_path / f"archive{length}",
            person_folder,
            [*settings, "frames.range=0:4", "smoothing.truncation=2", "views.sources=[cam00, cam01, cam02]"],
            partition=length,
        )
        pipeline.register()
        pipeline.run()
        found.append(content(pipeline))
    assert_same_content(*found)


def test_one_thread_equals_two(finished: Pipeline, tmp_path: Path) -> None:
    other = Pipeline(tmp_path / "archive", finished.folder)
    other.register()
    threads.limit(2)
    try:
        from posegaussian.dags.runtime.executors.serial import SerialBackend
        from posegaussian.dags.runtime.scheduler import Run

        Run([other.plan()], Selection(), SerialBackend(), [], threads=2).go()
    finally:
        threads.limit(1)
    assert_same_content(content(other), content(finished))


def ledger_rows(pipeline: Pipeline) -> list[dict]:
    archive = Archive.open(str(pipeline.root))
    return [ledger.row(NAME, r) for r in scan_receipts(archive.sequence(NAME))]


def test_serial_equals_dask(finished: Pipeline, tmp_path: Path) -> None:
    from posegaussian.dags.config.settings import RunSettings
    from posegaussian.dags.runtime.executors.dask import DaskBackend

    assert all(s.tolerance is None for s in STAGES), "a stage declares a tolerance: compare it here with that tolerance"
    other = Pipeline(tmp_path / "archive", finished.folder)
    other.register()
    other.run(backend=DaskBackend(RunSettings(workers=2)))
    assert_same_content(content(other), content(finished))
    assert receipts(other) == receipts(finished)
    circumstances = {"seconds", "modules", "started", "host", "worker", "peak_rss"}
    mine, theirs = (
        {
            tuple(r[k] for k in ledger.KEY): {k: v for k, v in r.items() if k not in circumstances}
            for r in ledger_rows(p)
        }
        for p in (other, finished)
    )
    assert mine == theirs


def test_append_then_run_equals_run_whole(person_folder: Path, tmp_path: Path) -> None:
    grown = Pipeline(tmp_path / "grown", person_folder, ["frames.range=0:3"])
    grown.register()
    grown.run("held_out")
    grown = Pipeline(grown.root, person_folder)
    counts = grown.ran("held_out")
    # Partition 0 (frames 0, 1) is untouched by the three frames that came; a view's partition 1 and 2 are new.
    assert counts["frames"] == 2 * 7
    assert counts["depth"] == 2
    whole = Pipeline(tmp_path / "whole", person_folder)
    whole.register()
    whole.run("held_out")
    assert_same_content(content(grown), content(whole))


@pytest.mark.parametrize("frames", [5, 3])
@pytest.mark.parametrize("stopped", [True, False], ids=["stopped at once", "of one stage alone"])
def test_a_run_of_fewer_frames_that_made_nothing_leaves_what_is_fresh_usable(
    finished: Pipeline, tmp_path: Path, stopped: bool, frames: int
) -> None:
    pipeline = finished.copy(tmp_path / "archive")
    shorter, alone = pipeline.with_settings(f"frames.range=0:{frames}"), frozenset({"metrics"})
    if stopped:
        prepare(shorter.plan())
        plan = pipeline.plan()
        assert plan.all_fresh == (frames == 5), "of the partition that was cut whole nothing is left"
        if plan.all_fresh:
            assert pipeline.session.run_and_report([plan], Selection()) == 0
            assert_same_content(content(pipeline), content(finished))
            prepare(shorter.plan())
    else:  # what it reads is stale for so few frames and may not be made, so nothing is
        shorter.run(selection=Selection(only=alone), expect_failure=True)
        assert_same_content(content(pipeline), content(finished))
        assert not pipeline.ran()
    pipeline.run(selection=Selection(force=frozenset({"frames", "depth"})))
    assert_same_content(content(pipeline), content(finished))
    assert receipts(pipeline) == receipts(finished)


def test_a_run_of_named_stages_decides_as_one_of_all_does(finished: Pipeline, tmp_path: Path) -> None:
    """Stages that are named are made though nobody reads them; that smoothing is off leaves open again whether anybody
    reads heatmaps, which the judge of the network settles while pose is ready to begin."""
    auto = ["effects.temporal_smoothing=auto", "network.weights=auto", "views.trust=auto", "keep={}"]
    auto += ["frames.range=0:2", "judge.views=1"]
    found = []
    for selection in (Selection(), Selection(only=frozenset({s.name for s in STAGES} - {"metrics"}))):
        pipeline = Pipeline(tmp_path / f"archive{len(found)}", finished.folder, auto, held_out="[]")
        pipeline.register()
        pipeline.run(selection=selection, expect_failure=bool(selection.only))
        found.append(content(pipeline, but=("metrics",)))
    # what nobody reads is made where it is named
    whole, named = found
    assert whole.keys() <= named.keys()
    assert_same_content(whole, {name: named[name] for name in whole})


def test_what_waits_for_a_stage_that_may_not_run_is_not_run(finished: Pipeline, tmp_path: Path) -> None:
    """Not even where it began to wait when that stage had been left out already."""
    auto = ["effects.temporal_smoothing=auto", "network.weights=auto", "views.trust=auto", "keep={}"]
    pipeline = Pipeline(tmp_path / "archive", finished.folder, [*auto, "frames.range=0:2"], held_out="[]")
    pipeline.register()
    pipeline.run(selection=Selection(only=frozenset({"survey", "pose", "smoothing"})), expect_failure=True)
    assert {stage for stage, *_ in receipts(pipeline)} == {"survey"}


@pytest.mark.parametrize("settings", [[], ["frames.matte=person"]], ids=["given", "person"])
def test_nothing_of_a_held_out_view_but_its_camera_reaches_a_stage_before_metrics(
    tmp_path: Path, settings: list[str]
) -> None:
    honest, noisy = tmp_path / "honest", tmp_path / "noisy"
    film(honest, views=4, frames=2)
    film(noisy, views=4, frames=2)
    _replace_by_noise(noisy, "mid00")
    found = []
    for folder in (honest, noisy):
        pipeline = Pipeline(tmp_path / f"archive_{folder.name}", folder, settings)
        pipeline.register()
        pipeline.run()
        # A view's plate is read by the task of that view's own mask alone, as its pictures are.
        found.append(
            content(pipeline, but=("survey/plate", "survey/spread", "frames/color", "frames/mask", "truth/", "metrics"))
        )
        color = content(pipeline)["frames/color"]
        found.append({"color": color})
    assert_same_content(found[0], found[2])
    assert found[1] != found[3], "the noise did not arrive: the test would prove nothing"


def _replace_by_noise(folder: Path, camera: str) -> None:
    """Pictures and masks of one camera become noise, its joints are moved, its true depth becomes a wall."""
    import json

    from posegaussian.storage.readers import images

    random = np.random.default_rng(0)
    for kind in ("images", "masks"):
        for file in (folder / kind / camera).iterdir():
            old = images.read_picture(file) if kind == "images" else images.read_mask(file)
            images.write_png(file, random.integers(0, 256, old.shape, dtype=np.uint8))
    for file in (folder / "depth" / camera).iterdir():
        images.write_exr(file, np.full_like(images.read_depth(file), 1.0))
    joints = folder / "joints" / f"{camera}.json"
    data = json.loads(joints.read_text())
    for annotation in data["annotations"]:
        annotation["keypoints"] = [v + 7 if i % 3 < 2 else v for i, v in enumerate(annotation["keypoints"])]
    joints.write_text(json.dumps(data))


def test_every_stage_is_deterministic(finished: Pipeline, tmp_path: Path) -> None:
    copy = finished.copy(tmp_path / "copy")
    before = content(copy)
    copy.run(selection=Selection(start=STAGES[0].name))
    assert_same_content(content(copy), before)
    assert all(v.state is State.FRESH for v in copy.plan().verdicts.values())
