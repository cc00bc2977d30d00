"""Accepting keeps bytes and re-keys receipts: only after changes that may be harmless, and never silently."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from posegaussian.dags.maintenance.accept import accept, accept_every
from posegaussian.dags.planning import fingerprint
from posegaussian.dags.planning.explain import why
from posegaussian.dags.planning.plan import State
from posegaussian.dags.runtime.entering import enter
from posegaussian.dags.runtime.work_order import RunTerms
from posegaussian.stages.registry import STAGES
from posegaussian.storage.archive.lease import Lease
from posegaussian.storage.archive.receipts import (
    Receipt,
    ReceiptKey,
    lease_file,
    read_receipt,
    scan_receipts,
    write_receipt,
)
from posegaussian.storage.archive.store import SequenceGroup
from posegaussian.storage.model.errors import LeaseHeld, UserError
from posegaussian.storage.model.spec import digest
from tests.support.pipeline import NAME, Pipeline, assert_same_content, content


@pytest.fixture
def archive(finished: Pipeline, tmp_path: Path) -> Pipeline:
    return finished.copy(tmp_path / "archive")


@pytest.fixture
def edited(archive: Pipeline, monkeypatch: pytest.MonkeyPatch) -> Pipeline:
    """The code of depth is another one."""
    real = fingerprint.code_digest
    monkeypatch.setattr(
        fingerprint, "code_digest", lambda run: "e" * 32 if run.startswith("posegaussian.stages.depth.") else real(run)
    )
    return archive


def depth(pipeline: Pipeline, partition: int = 0) -> Receipt:
    found = read_receipt(pipeline.context().sequence, ReceiptKey("depth", partition, None, None))
    assert found is not None
    return found


def test_after_acceptance_all_is_fresh_and_no_byte_changed(edited: Pipeline, finished: Pipeline) -> None:
    before = depth(edited)
    said = accept(edited.plan(), "depth", "a renamed variable")
    assert "accepted 3 of 3 stale outputs of depth: code of depth changed" in said[0]
    assert edited.plan().all_fresh
    assert edited.ran() == {}
    assert_same_content(content(edited), content(finished))
    after = depth(edited)
    assert after.outputs == before.outputs
    assert after.fingerprint != before.fingerprint
    (note,) = after.facts["accepted"]
    assert note["from"] == before.fingerprint
    assert note["reason"] == "a renamed variable"
    assert note["by"]
    assert note["when"]
    assert any("code of depth changed" in c for c in note["changed"])


def test_settings_may_be_accepted_and_each_acceptance_is_kept(archive: Pipeline) -> None:
    first, second = archive.with_settings("depth.max_angle=64"), archive.with_settings("depth.max_angle=63")
    accept(first.plan(), "depth", "no pair is that wide")
    accept(second.plan(), "depth", "nor that wide")
    assert second.plan().all_fresh
    assert [n["reason"] for n in depth(archive).facts["accepted"]] == ["no pair is that wide", "nor that wide"]
    assert [n["changed"] for n in depth(archive).facts["accepted"]] == [
        ["depth.max_angle 105.0 -> 64.0"],
        ["depth.max_angle 64.0 -> 63.0"],
    ]


def test_why_shows_the_acceptance(archive: Pipeline) -> None:
    changed = archive.with_settings("depth.max_angle=64")
    accept(changed.plan(), "depth", "no pair is that wide")
    plan = changed.plan()
    text = "\n".join(why(plan, next(t for t in plan.verdicts if t.stage == "depth")))
    assert "no pair is that wide (depth.max_angle 105.0 -> 64.0; fingerprint was" in text


def test_why_tells_what_differs_at_every_stale_step(archive: Pipeline) -> None:
    plan = archive.with_settings("depth.pairs=1", "gaussians.footprint=0.6").plan()
    lines = why(plan, next(t for t in plan.verdicts if t.stage == "rendering"))
    text = "\n".join(lines)
    assert "params: pairs: 2 -> 1" in text
    assert "params: footprint: 0.5 -> 0.6" in text
    assert text.count("last made") == 3, "rendering, gaussians and depth"


def test_a_missing_shard_is_refused(edited: Pipeline) -> None:
    next(p for p in (edited.root / NAME / "depth/depth").glob("c.*")).unlink()
    before = edited.plan().book.receipts
    with pytest.raises(UserError, match=r"shard depth/depth/\S+ is missing .* cannot be accepted, run again"):
        accept(edited.plan(), "depth", "why not")
    assert edited.plan().book.receipts == before, "nothing is written when one is refused"


def test_changed_inputs_are_refused(archive: Pipeline) -> None:
    sequence = archive.context().sequence
    for receipt in [r for r in scan_receipts(sequence) if r.stage == "frames"]:
        outputs = tuple(replace(output, digest="0" * 32) for output in receipt.outputs)
        write_receipt(sequence, replace(receipt, outputs=outputs))
    with pytest.raises(
        UserError, match=r"depth p0000: inputs changed, not only version, code, params .*run it instead"
    ):
        accept(archive.plan(), "depth", "looks alike")


def test_changed_frames_and_cameras_are_refused(archive: Pipeline) -> None:
    with pytest.raises(UserError, match="cameras"):
        accept(archive.with_settings("views.sources=[cam00, cam01, cam02, cam03]").plan(), "pose", "looks alike")


def test_behind_a_stale_stage_nothing_can_be_accepted(archive: Pipeline) -> None:
    changed = archive.with_settings("depth.pairs=1", "gaussians.footprint=0.6")
    with pytest.raises(UserError, match="what it reads of depth is not fresh; accept or run that first"):
        accept(changed.plan(), "gaussians", "looks alike")
    accept(changed.plan(), "depth", "looks alike")
    accept(changed.plan(), "gaussians", "looks alike")
    assert changed.plan().all_fresh


def test_what_was_never_made_stays_to_be_made(edited: Pipeline) -> None:
    (edited.root / NAME / "_receipts/depth/p000001.json").unlink()
    said = accept(edited.plan(), "depth", "a renamed variable")
    assert "accepted 2 of 3" in said[0]
    assert "1 outputs of depth were never made" in said[1]
    states = {t.partition: v.state for t, v in edited.plan().verdicts.items() if t.stage == "depth"}
    assert states == {0: State.FRESH, 1: State.STALE, 2: State.FRESH}


def test_dropped_inputs_do_not_stand_in_the_way(archive: Pipeline) -> None:
    """Their contents are known by their digests; making them again would be what acceptance is to save."""
    from posegaussian.dags.runtime.eviction import Keeper

    kept = archive.with_settings("run.keep=as_declared")
    Keeper([kept.plan()]).sweep()
    changed = kept.with_settings("depth.max_angle=64")
    assert changed.plan().counts("frames")[State.FRESH] < 21, "the plan would make pictures again"
    accept(changed.plan(), "depth", "no pair is that wide")
    assert changed.plan().all_fresh


def test_a_reason_is_asked_for_and_fresh_or_unneeded_stages_are_left_alone(archive: Pipeline) -> None:
    with pytest.raises(UserError, match="--reason must say why"):
        accept(archive.plan(), "depth", "  ")
    with pytest.raises(UserError, match="does not need survey"):
        accept(archive.plan(), "survey", "x")
    assert "nothing to accept" in accept(archive.plan(), "depth", "x")[0]


def test_another_version_is_accepted_at_once_in_the_order_of_flow(
    archive: Pipeline, finished: Pipeline, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The code of every stage is another one: each plan sees what was accepted before, and no byte is made anew."""
    monkeypatch.setattr(fingerprint, "code_digest", lambda run: "e" * 32)
    said = accept_every(archive.plan, "the modules moved")
    stages = [line.split(" outputs of ")[1].partition(":")[0] for line in said]
    assert stages == [s.name for s in STAGES if s.name in stages]
    assert "depth" in stages
    assert archive.plan().all_fresh
    assert_same_content(content(archive), content(finished))


def test_settings_are_not_accepted_of_all_stages_at_once(archive: Pipeline) -> None:
    with pytest.raises(UserError, match=r"params changed, not only version, code"):
        accept_every(archive.with_settings("depth.pairs=1").plan, "whatever")


@pytest.mark.parametrize(
    ("source", "accepted"), [("estimator", True), ("pictures of cam00", False), ("network", False)]
)
def test_of_sources_only_the_code_of_an_asset_may_be_another(archive: Pipeline, source: str, accepted: bool) -> None:
    """The digest of the pose estimator holds code of ours; for files and trained weights nobody vouches."""
    sequence = archive.context().sequence
    for receipt in [r for r in scan_receipts(sequence) if r.stage == "depth"]:
        parts = {**receipt.parts, "sources": {**receipt.parts["sources"], source: "0" * 32}}
        write_receipt(sequence, replace(receipt, parts=parts, fingerprint=digest(parts)))
    assert not archive.plan().all_fresh
    if accepted:
        assert f"source {source} is no longer read" in "".join(accept(archive.plan(), "depth", "the modules moved"))
        assert archive.plan().all_fresh
    else:
        with pytest.raises(UserError, match="sources changed, not only version, code, params"):
            accept(archive.plan(), "depth", "the modules moved")


def test_what_a_run_works_on_is_left_alone(edited: Pipeline) -> None:
    with enter(edited.plan(), RunTerms("someone")), pytest.raises(LeaseHeld, match="is worked on by run someone"):
        accept(edited.plan(), "depth", "a renamed variable")
    plan, before = edited.plan(), depth(edited)
    key = ReceiptKey("depth", 0, None, None)
    with Lease.take(lease_file(plan.context.sequence, key), "someone"), pytest.raises(LeaseHeld):
        accept(plan, "depth", "a renamed variable")
    assert depth(edited) == before
    assert "accepted 3 of 3" in accept(plan, "depth", "a renamed variable")[0]


def test_of_two_at_once_the_second_is_refused(edited: Pipeline, monkeypatch: pytest.MonkeyPatch) -> None:
    plan, other = edited.plan(), edited.plan()

    def meanwhile(sequence: SequenceGroup, receipt: Receipt) -> None:
        with pytest.raises(UserError, match=r"is held by run accept-|was made anew by a run in the meantime"):
            accept(other, "depth", "a second reason")
        write_receipt(sequence, receipt)

    monkeypatch.setattr("posegaussian.dags.maintenance.accept.write_receipt", meanwhile)
    accept(plan, "depth", "a renamed variable")
    assert [n["reason"] for n in depth(edited).facts["accepted"]] == ["a renamed variable"]
