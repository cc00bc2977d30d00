"""`why` says the first cause first, the rest in short, and task by task of the partition that is named."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest
from typer.testing import CliRunner

from posegaussian.dags.cli.app import app
from posegaussian.dags.planning.explain import why as chain
from posegaussian.dags.planning.selection import Selection
from tests.support.pipeline import NAME, Pipeline


def told(pipeline: Pipeline, *words: str) -> list[str]:
    done = CliRunner().invoke(app, ["why", NAME, *words, *pipeline.options])
    assert done.exit_code == 0, done.output
    return done.output.splitlines()


def test_the_first_cause_is_the_first_line_and_a_line_a_stage_follows(finished: Pipeline) -> None:
    changed = finished.with_settings("depth.pairs=1")
    first, *stages, detail, following = told(changed, "rendering")
    assert first == "rendering is not fresh because of depth: depth.pairs 2 -> 1"
    waits = "if its content comes out equal, nothing is done here (3x)"
    assert stages == [
        "depth, 3 stale: depth.pairs 2 -> 1 (3x)",
        f"gaussians, 3 undecided: waits for depth; {waits}",
        f"rendering, 3 undecided: waits for gaussians and depth; {waits}",
    ]
    assert detail.startswith(f"task by task: posegaussian why {NAME} rendering 0 ")
    assert following.startswith("next: posegaussian run ")


def test_the_command_it_names_tells_one_partition_task_by_task(finished: Pipeline) -> None:
    changed = finished.with_settings("depth.pairs=1")
    (detail,) = [line for line in told(changed, "rendering") if line.startswith("task by task: ")]
    done = CliRunner().invoke(app, shlex.split(detail)[4:])
    assert done.exit_code == 0, done.output
    first, *rest = done.output.splitlines()
    assert first == "rendering is not fresh because of depth: depth.pairs 2 -> 1"
    plan = changed.plan()
    task = next(t for t in plan.verdicts if t.stage == "rendering")
    assert rest[:-1] == chain(plan, task)


def test_a_cause_of_its_own_names_no_other_stage(finished: Pipeline) -> None:
    assert told(finished.with_settings("rendering.sources=1"), "rendering")[:2] == [
        "rendering is not fresh: rendering.sources 2 -> 1",
        "rendering, 3 stale: rendering.sources 2 -> 1 (3x)",
    ]


def test_of_two_causes_the_earlier_one_leads(finished: Pipeline) -> None:
    first, *rest = told(finished.with_settings("rendering.sources=1", "depth.pairs=1"), "rendering")
    assert first == "rendering is not fresh because of depth: depth.pairs 2 -> 1"
    assert "rendering, 3 stale: rendering.sources 2 -> 1 (3x)" in rest


def test_of_many_failures_one_is_told_and_where_the_others_are(
    finished: Pipeline, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import posegaussian.stages.depth.run as depth

    def failing(inputs: object, params: object) -> object:
        raise RuntimeError("a cosmic ray")

    archive = finished.copy(tmp_path / "archive").with_settings("depth.pairs=1")
    monkeypatch.setattr(depth, "run", failing)
    assert archive.session.run_and_report([archive.plan()], Selection()) == 1
    failure, more, first, *_ = told(archive, "depth")
    assert failure.startswith("depth p000")
    assert failure.endswith("a cosmic ray")
    assert more.startswith("and 2 more: posegaussian status --failed ")
    assert first == "depth is not fresh: never made"
    assert "a cosmic ray" in told(archive, "depth", "1")[0]
    assert told(archive, "rendering")[:2] == [failure, more], "what it waits for failed"
    of_one = [line for line in told(archive, "rendering", "1") if "a cosmic ray" in line]
    assert [line.partition(" failed ")[0] for line in of_one] == ["depth p0001"]
