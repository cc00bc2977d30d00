"""A sequence beside itself in partitions of another length: nothing of the one is taken for the other's."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from posegaussian.dags.planning import variants
from posegaussian.dags.planning.context import Context
from posegaussian.dags.planning.plan import make_plan
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.planning.variants import settled_variant
from posegaussian.dags.runtime.executors.inline_run import run_here
from posegaussian.storage.archive.receipts import Receipt, scan_receipts
from posegaussian.storage.archive.store import SequenceGroup
from tests.support.pipeline import NAME, Pipeline, assert_same_content, content, film

DEPTH = Selection(only=frozenset({"frames", "depth"}))
SURVEY = Selection(only=frozenset({"survey"}))


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Pipeline:
    """Four frames in partitions of two."""
    folder = tmp_path_factory.mktemp("variants")
    film(folder / "capture", views=4, size=32, frames=4, held_out=0)
    pipeline = Pipeline(folder / "archive", folder / "capture", partition=2, held_out="[]")
    pipeline.register()
    run_here(pipeline.plan(selection=DEPTH), DEPTH)
    return pipeline


def beside(pipeline: Pipeline, length: int | None, name: str) -> Context:
    context = pipeline.context()
    return settled_variant(context.sequence, context.settings, {"of": name}, context.path_texts, length)


def test_of_the_same_length_all_is_taken_over(made: Pipeline) -> None:
    for length in (None, 2):
        assert not run_here(make_plan(beside(made, length, "same"), DEPTH), DEPTH)


def test_of_another_length_everything_is_made_as_a_sequence_registered_so_makes_it(
    made: Pipeline, tmp_path: Path
) -> None:
    other = beside(made, 1, "frame by frame")
    assert other.sequence.partition_frames == 1
    done = run_here(make_plan(other, DEPTH), DEPTH)
    assert {t.partition for t in done} == {0, 1, 2, 3}
    assert made.context().sequence.partition_frames == 2, "the user's sequence stays as it is"
    registered = Pipeline(tmp_path / "archive", made.folder, partition=1, held_out="[]")
    registered.register()
    run_here(registered.plan(selection=DEPTH), DEPTH)
    root = other.sequence.root.parent
    assert_same_content(content(Pipeline(root, made.folder, partition=1, held_out="[]")), content(registered))
    again = beside(made, 1, "once more")
    assert not run_here(make_plan(again, DEPTH), DEPTH), "of its own length it takes over what another one made"
    assert again.sequence.name == NAME


@pytest.fixture
def surveyed(tmp_path: Path) -> Pipeline:
    """Two frames with plates from the survey, and a variant that took these over."""
    film(tmp_path / "capture", views=3, size=32, frames=2, held_out=0, masks=False, depth=False)
    pipeline = Pipeline(tmp_path / "archive", tmp_path / "capture", ["frames.matte=plate"], held_out="[]")
    pipeline.register()
    pipeline.run(selection=SURVEY)
    assert constants(beside(pipeline, None, "before")) == constants(pipeline.context())
    return pipeline


def film_again(pipeline: Pipeline) -> None:
    """Other pictures in the old ones' place."""
    film(pipeline.folder, views=3, size=32, frames=2, held_out=0, motion="wave", masks=False, depth=False)
    pipeline.register()


def constants(context: Context) -> dict[int | None, dict]:
    """{view: digests} of what was surveyed."""
    found = {r.view: r.contents for r in scan_receipts(context.sequence) if r.stage == "survey"}
    return dict(sorted(found.items(), key=str))


def test_a_survey_that_is_taken_anew_is_the_variants_too(surveyed: Pipeline) -> None:
    old = constants(surveyed.context())
    film_again(surveyed)
    assert any("taken before the pictures" in note for note in surveyed.plan().notes)
    surveyed.run(selection=Selection(only=frozenset({"survey"}), start="survey"))
    assert constants(surveyed.context()) != old
    variant = beside(surveyed, None, "before")
    assert constants(variant) == constants(surveyed.context())
    assert not [note for note in make_plan(variant).notes if "taken before the pictures" in note]


def test_a_variant_has_no_survey_of_other_pictures_while_the_sequence_keeps_its_own(surveyed: Pipeline) -> None:
    old = constants(surveyed.context())
    film_again(surveyed)
    assert not constants(beside(surveyed, None, "before")), "as if it were made now"
    assert constants(surveyed.context()) == old, "the user's own stays until told otherwise"


@pytest.mark.parametrize("where", ["others", "missing_files"])
def test_of_a_variant_that_another_process_deletes_meanwhile_nothing_is_taken(
    where: str, made: Pipeline, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before its record is read, and between looking at its files and linking them."""
    pipeline = made.copy(tmp_path / "archive")
    shutil.rmtree(pipeline.root / "_variants", ignore_errors=True)
    going = beside(pipeline, 1, "going")
    run_here(make_plan(going, DEPTH), DEPTH)
    real = getattr(variants, where)

    def deleted(sequence: SequenceGroup, *args: Receipt) -> object:
        found = real(sequence, *args)
        shutil.rmtree(going.sequence.root.parent, ignore_errors=True)
        return found

    monkeypatch.setattr(variants, where, deleted)
    other = beside(pipeline, 1, "other")
    assert not list(scan_receipts(other.sequence))
