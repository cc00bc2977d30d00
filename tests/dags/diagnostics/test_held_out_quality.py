"""Every command that compares held-out pictures measures them alike: what a camera cannot see costs nothing, and where
nobody is seen there is nothing to compare."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from posegaussian.dags.diagnostics.held_out_quality import box_psnr, compared, quality, require_subject
from posegaussian.dags.planning.context import Context
from posegaussian.dags.planning.plan import make_plan
from posegaussian.dags.planning.results import Results
from posegaussian.dags.planning.variants import FOLDER
from posegaussian.dags.regret import regret
from posegaussian.dags.tradeoff.searched import run_search
from posegaussian.dags.tradeoff.tradeoff import run_tradeoff
from posegaussian.stages.metrics.run import LEFT_OUT
from posegaussian.stages.simulator.subjects.capsule_person import PersonCapture, capture_person
from posegaussian.storage.exporters.images_layout import write_capture
from posegaussian.storage.model.errors import UserError
from tests.support.pipeline import Pipeline

HELD_OUT = "mid00"


def registered(folder: Path, person: PersonCapture, *settings: str) -> Pipeline:
    """An archive of the person as filmed."""
    write_capture(folder / "capture", person.rig, person.color, mask=person.mask, joints2d=person.joints2d)
    pipeline = Pipeline(folder / "archive", folder / "capture", list(settings))
    pipeline.register()
    return pipeline


@pytest.fixture(scope="module")
def behind_a_post(tmp_path_factory: pytest.TempPathFactory) -> Context:
    """A finished sequence of one frame, whose held-out camera films the subject behind a post."""
    person = capture_person(views=8, size=128, frames=1, held_out=1)
    view = person.rig.index(HELD_OUT)
    middle = int(np.median(np.nonzero(person.mask[0, view])[1]))
    person.mask[0, view, :, middle - 4 : middle + 4] = 0
    person.color[0, view, :, middle - 4 : middle + 4] = 90
    pipeline = registered(tmp_path_factory.mktemp("post"), person, "run.keep=everything")
    pipeline.run()
    return make_plan(pipeline.context("held_out")).context


def test_what_a_held_out_camera_cannot_see_costs_no_command_anything(behind_a_post: Context) -> None:
    (path,) = behind_a_post.paths
    rows = Results(behind_a_post).table("metrics/{path}", path)
    assert all(LEFT_OUT in r["definition"] for r in rows), "the metrics stage leaves something out"
    found = quality(behind_a_post, behind_a_post)
    for row in rows:
        if row["measure"] in ("psnr", "ssim"):
            assert found[f"{row['measure']} {row['region']}"] == row["value"]
    assert box_psnr(behind_a_post, behind_a_post) == found["psnr box"]
    (picture,) = compared(behind_a_post, behind_a_post, range(1))
    assert picture.visible is not None
    # one gain a channel of least squares inside the mask changes little, a hidden post some ten decibels
    assert regret.box_psnr(behind_a_post, behind_a_post) == pytest.approx(found["psnr box"], abs=1)


@pytest.fixture(scope="module")
def of_nobody(tmp_path_factory: pytest.TempPathFactory) -> Pipeline:
    """Two frames whose held-out camera sees nobody, nothing of them made."""
    person = capture_person(views=6, size=48, frames=2, held_out=1)
    person.mask[:, person.rig.index(HELD_OUT)] = 0
    return registered(tmp_path_factory.mktemp("nobody"), person)


@pytest.mark.parametrize(
    "command",
    [
        lambda p, out: run_tradeoff(p.session, None, ["depth.method"], ["depth.method=hull,sgbm"], 1, out),
        lambda p, out: run_search(p.session, None, ["depth.method"], ["depth.method=hull,sgbm"], 2, 1, out),
        lambda p, out: regret.measured(p.session, "person", pairs=False, repeats=1),
    ],
    ids=["tradeoff", "search", "regret"],
)
def test_where_nobody_is_seen_it_is_said_before_anything_is_compared(
    of_nobody: Pipeline, tmp_path: Path, command: Callable[[Pipeline, Path], object]
) -> None:
    archive = of_nobody.copy(tmp_path / "archive")
    with pytest.raises(
        UserError, match=r"no held-out camera has a picture of the subject in frames 0\.\.[01] of person"
    ):
        command(archive, tmp_path / "out")
    drawn = [p for p in (archive.root / FOLDER).iterdir() if list(p.glob("*/rendering/*/color/c*"))]
    assert len(drawn) == 1, "what comes after the first level is not run"
    assert not (tmp_path / "out").exists()


def test_where_one_picture_of_somebody_is_enough_there_is_something_to_compare(finished: Pipeline) -> None:
    context = make_plan(finished.context("held_out")).context
    require_subject(context)
    assert np.isfinite(box_psnr(context, context))
