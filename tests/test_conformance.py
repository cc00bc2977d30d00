"""A walk over the registry: nobody can add a stage that the plan, the arrays, the docs or the checks cannot read."""

from __future__ import annotations

import inspect
import json
import subprocess
import sys
from itertools import combinations
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
import yaml

from posegaussian.dags.config.settings import PACKAGED, Settings
from posegaussian.stages.contract.declaration import Axis, Params, Read, Resources, Stage, extra, resolve
from posegaussian.stages.contract.facts import Facts
from posegaussian.stages.registry import STAGES, stage
from posegaussian.storage.archive.store import layout
from posegaussian.storage.model.capture import PER_VIEW
from posegaussian.storage.model.spec import ArraySpec, TableSpec

SOURCES = {"pictures", "masks", "joints", "joints3d", "depth", "depth_maps", "estimator", "network", "shipped_networks"}
LEFT_OUT: dict[str, dict[str, object]] = {"network": {"weights": "none"}, "refinement": {"steps": 0}}
"""Settings that leave an optional stage out."""
CAPTURE_FACTS = (
    "joints2d",
    "joints3d",
    "masks",
    "truth_depth",
    "held_out",
    "several_frames",
    "detected",
    "segmented",
    "given_depth",
    "single_source",
    "tracked",
    "quaternions",
    "turned_pairs",
    "twisted",
    "fitted_gaussians",
)
EFFECTS = tuple(dict.fromkeys(e.name for s in STAGES for e in s.effects))
FACTS = (*CAPTURE_FACTS, *EFFECTS)
OPTIONAL = tuple(s for s in STAGES if s.optional)
EFFECT_STATES = sorted(
    {*(s for e in EFFECTS for s in (frozenset({e}), frozenset(EFFECTS) - {e})), frozenset(), frozenset(EFFECTS)},
    key=sorted,
)
"""None, all, every one alone and all but every one: all combinations of a dozen would be too many."""
EXTREMES = (frozenset(), frozenset(EFFECTS))
EVERY_FACTS = [
    Facts(frozenset(c) | on)
    for n in range(len(CAPTURE_FACTS) + 1)
    for c in combinations(CAPTURE_FACTS, n)
    if ("twisted" in c) == (("quaternions" in c) != ("turned_pairs" in c))  # one of them is what twists
    and not {"quaternions", "turned_pairs"} <= set(c)
    if ("joints2d" in c or "detected" not in c) and ({"joints2d", "joints3d"} & set(c) or "segmented" not in c)
    for on in (EFFECT_STATES if n in (0, 1, 2, len(CAPTURE_FACTS)) else EXTREMES)
]
"""Every capture with no effect and with all; captures with two facts at most, and with all, in every state of the
effects."""
SHAPE = {
    "frame": 16,
    "moment": 96,
    "view": 8,
    "one_view": 8,
    "other_view": 8,
    "y": 1080,
    "x": 1920,
    "source_y": 1080,
    "source_x": 1920,
    "camera": 2,
    "camera_y": 1080,
    "camera_x": 1920,
    "joint": 25,
    "found_joint": 33,
    "judged": 16,
    "depth_method": 3,
    "weights": 2,
    "sample": 25,
    "person": 3,
}
HEAVY = {
    "torch",
    "cv2",
    "numba",
    "av",
    "dask",
    "distributed",
    "OpenImageIO",
    "scipy",
    "bokeh",
    "ai_edge_litert",
    "matplotlib",
}

every_stage = pytest.mark.parametrize("s", STAGES, ids=lambda s: s.name)


def writers() -> dict[str, Stage]:
    return {w.name: s for s in STAGES for w in s.writes}


def test_names_are_unique_and_match_the_keys_of_the_settings() -> None:
    names = [s.name for s in STAGES]
    assert len(set(names)) == len(names)
    assert set(names) <= set(Settings.model_fields)
    assert set(names) <= set(yaml.safe_load(PACKAGED.read_text()))
    for s in STAGES:
        assert stage(s.name) is s
        assert Settings.model_fields[s.name].annotation is s.params
    with pytest.raises(KeyError, match="survey, judge, detection"):
        stage("nothing")


@every_stage
def test_the_summary_is_one_sentence(s: Stage) -> None:
    assert s.summary[0].isupper()
    assert s.summary.endswith(".")
    assert ". " not in s.summary
    assert "\n" not in s.summary
    assert len(s.summary) <= 100
    assert s.version >= 1


@every_stage
def test_every_read_is_a_known_source_or_written_by_an_earlier_stage(s: Stage) -> None:
    earlier = {w.name: w for t in STAGES[: STAGES.index(s)] for w in t.writes}
    assert len({(r.array, r.is_source) for r in s.reads}) == len(s.reads)
    for r in s.reads:
        if r.is_source:
            assert r.array in SOURCES
            continue
        assert r.array in earlier, f"{s.name} reads {r.array}, which no earlier stage writes"
        assert isinstance(earlier[r.array], ArraySpec), f"{s.name} reads {r.array}, which is a table"
        assert "{path}" not in r.array or "path" in s.over


@every_stage
def test_a_read_of_its_own_view_belongs_to_a_stage_over_views(s: Stage) -> None:
    arrays = {w.name: w for t in STAGES for w in t.writes}
    for r in s.reads:
        per_view = r.array in PER_VIEW if r.is_source else arrays[r.array].per_view
        assert r.views != "own" or "view" in s.over or not per_view, r.array


@every_stage
def test_what_a_stage_reads_exists_for_every_capture_that_needs_the_stage(s: Stage) -> None:
    """With the default params and any facts:
    whoever is read is not `unneeded`, and its output is not left out by `when`."""
    by_array = writers()
    for facts in EVERY_FACTS:
        params = s.params()
        if s.unneeded(params, facts) is not None or s.refusal(params, facts) is not None:
            continue
        for r in s.reads_for(params, facts):
            if not r.is_source:
                writer = by_array[r.array]
                assert writer.unneeded(writer.params(), facts) is None, (
                    f"{s.name} reads {r.array} with {sorted(facts)}, but {writer.name} is not needed"
                )
                asked = {r.array} if writer.sequence_wide else set()
                assert r.array in {w.name for w in writer.writes_for(facts | asked)}, (
                    f"{r.array} is not written with {sorted(facts)}"
                )


def test_every_output_is_written_once() -> None:
    names = [w.name for s in STAGES for w in s.writes]
    assert len(set(names)) == len(names)


@every_stage
def test_outputs_are_declared_so_that_they_can_be_made(s: Stage) -> None:
    assert s.writes
    for w in s.writes:
        assert w.meaning.endswith(".")
        assert w.when is None or w.when in FACTS or (s.sequence_wide and w.when in {other.name for other in s.writes})
        assert ("{path}" in w.name) == ("path" in s.over)
        if isinstance(w, TableSpec):
            assert len({c for c, _ in w.columns}) == len(w.columns)
            continue
        assert w.unit
        np.dtype(w.dtype)
        assert len(set(w.dims)) == len(w.dims)
        assert w.per_frame == ("time" in s.over)
        assert w.per_view or "view" not in s.over
        assert all(n > 0 for n in w.lengths(SHAPE))
        _, chunk, shard = layout(w, SHAPE, 16)
        assert all(a % b == 0 for a, b in zip(shard, chunk, strict=True))


@every_stage
def test_axes_of_work_are_known_and_begin_with_the_sequence(s: Stage) -> None:
    assert s.over[0] == "sequence"
    assert set(s.over) <= set(get_args(Axis))
    assert not s.sequence_wide or "time" not in s.over


@every_stage
def test_run_and_check_resolve_to_documented_callables(s: Stage) -> None:
    run = resolve(s.run)
    assert inspect.isgeneratorfunction(run)
    assert list(inspect.signature(run).parameters) == ["inputs", "params"]
    assert run.__doc__
    if s.check is not None:
        check = resolve(s.check)
        assert list(inspect.signature(check).parameters) == ["block", "params"]
        assert check.__doc__


@every_stage
def test_every_setting_has_a_description_a_unit_and_a_default_within_its_bounds(s: Stage) -> None:
    assert issubclass(s.params, Params)
    s.params()
    for name, field in s.params.model_fields.items():
        assert field.description, f"{s.name}.{name}"
        assert field.description.strip().endswith("."), f"{s.name}.{name}: {field.description!r}"
        assert extra(field).get("unit"), f"{s.name}.{name} has no unit"


@every_stage
def test_quality_levels_are_valid_settings_and_hold_the_default(s: Stage) -> None:
    for name, field in s.params.model_fields.items():
        levels = extra(field).get("quality_levels")
        if levels is not None:
            assert len(levels) > 1
            assert field.default in (
                *levels,
                "auto",
            ), f"{s.name}.{name}"  # `auto` is one of them, or what this capture alone can serve
            for level in levels:
                assert getattr(s.params(**{name: level}), name) == level


@every_stage
def test_a_volatile_setting_stays_out_of_what_is_hashed_and_every_other_is_in(s: Stage) -> None:
    volatile = {n for n, f in s.params.model_fields.items() if extra(f).get("volatile")}
    assert set(s.params().hashed()) == set(s.params.model_fields) - volatile
    assert json.loads(json.dumps(s.params().hashed())) == s.params().hashed(), (
        "a receipt must give back what was hashed"
    )


@every_stage
def test_a_task_needs_memory_that_grows_with_the_picture(s: Stage) -> None:
    def ram(**changes: int) -> Resources:
        need = s.needs({**SHAPE, **changes}, s.params())
        for value in (need.ram, need.vram, need.cpu, need.gpu):
            assert isinstance(value, int)
            assert value >= 0
        return need

    one = ram()
    assert one.cpu >= 1
    assert 2**20 <= one.ram <= 2**38, f"{s.name} says it needs {one.ram} bytes"
    assert (one.vram > 0) == (one.gpu > 0)
    arrays = {w.name: w for t in STAGES for w in t.writes}
    seen = [*s.writes, *(arrays[r.array] for r in s.reads if not r.is_source)]
    if (
        s.reads
        and not any(r.is_source for r in s.reads)
        and not any(dim.startswith(("x", "y")) for w in seen if isinstance(w, ArraySpec) for dim in w.dims)
    ):
        return  # it sees no picture
    larger = {k: 2 * v for k, v in SHAPE.items() if k.endswith(("y", "x"))}
    assert ram(**larger).ram > one.ram


@every_stage
def test_a_task_needs_at_least_the_memory_of_its_largest_block(s: Stage) -> None:
    """One block of one view is in memory when it is written."""
    blocks = [
        int(np.prod(w.lengths({**SHAPE, "view": 1}))) * np.dtype(w.dtype).itemsize
        for w in s.writes
        if isinstance(w, ArraySpec)
    ]
    assert s.needs(SHAPE, s.params()).ram >= max(blocks, default=0)


@every_stage
def test_halos_are_not_negative(s: Stage) -> None:
    for on in EFFECT_STATES:
        for r in s.reads:
            assert min(r.halo_for(s.params(), Facts(on))) >= 0


@every_stage
def test_answers_about_a_capture_are_sentences_that_name_the_matter(s: Stage) -> None:
    for facts in EVERY_FACTS:
        for answer in (s.unneeded(s.params(), facts), s.refusal(s.params(), facts)):
            assert answer is None or len(answer.split()) > 3


@every_stage
def test_with_default_settings_no_capture_is_refused(s: Stage) -> None:
    for facts in EVERY_FACTS:
        if s.unneeded(s.params(), facts) is None:
            assert s.refusal(s.params(), facts) is None, sorted(facts)


@every_stage
def test_every_effect_has_a_measure_and_a_unit(s: Stage) -> None:
    arrays = writers()
    for e in s.effects:
        assert e.measure
        assert e.unit
        assert e.summary.endswith(".")
        assert np.isfinite(e.threshold)
        for array in e.asks:
            assert arrays[array].sequence_wide, f"{e.name} asks for {array}, which is no constant of the sequence"
            assert next(w for w in arrays[array].writes if w.name == array).noted, (
                f"{e.name} asks for {array}, which no receipt notes"
            )


def test_an_effect_is_one_object_wherever_it_is_declared_and_no_fact_of_the_capture_has_its_name() -> None:
    for name in EFFECTS:
        assert len({id(e) for s in STAGES for e in s.effects if e.name == name}) == 1
    assert not set(EFFECTS) & set(CAPTURE_FACTS)


@every_stage
def test_a_stage_depends_on_the_effects_that_it_declares_and_on_no_other(s: Stage) -> None:
    """Else a changed decision would not make it stale. Effects ask nothing of the survey's declaration."""
    own, params = {e.name for e in s.effects}, s.params()
    for facts in EVERY_FACTS:
        plain = facts - set(EFFECTS) | facts & own

        def answers(f: Facts) -> tuple[object, ...]:
            return s.reads_for(params, f), s.writes_for(f), s.unneeded(params, f), s.refusal(params, f)

        assert answers(facts) == answers(plain), sorted(facts - plain)


@pytest.mark.parametrize("s", OPTIONAL, ids=lambda s: s.name)
def test_outputs_of_an_optional_stage_are_read_only_while_its_name_is_a_fact(s: Stage) -> None:
    """With the settings that leave it out."""
    assert s.name not in FACTS
    made, without = {w.name for w in s.writes}, s.params(**LEFT_OUT[s.name])
    for facts in EVERY_FACTS:
        assert s.unneeded(without, facts) is not None
        for other in STAGES[STAGES.index(s) + 1 :]:
            assert not made & {r.array for r in other.reads_for(other.params(), facts)}
    assert any(
        made & {r.array for r in other.reads_for(other.params(), Facts(frozenset({s.name})))} for other in STAGES
    )


@every_stage
def test_choices_have_a_setting_and_a_reason(s: Stage) -> None:
    for c in s.choices:
        for facts in EVERY_FACTS:
            answer, why = c.resolve(s.params(), facts)
            assert answer != "auto"
            assert len(why.split()) > 3
        assert c.setting in s.params.model_fields


def test_frames_depends_on_no_setting_of_a_later_stage() -> None:
    """Flow runs forward: the first stage that reads an array comes after the one that writes it."""
    order = {s.name: n for n, s in enumerate(STAGES)}
    for s in STAGES:
        for r in s.reads:
            if not r.is_source:
                assert order[writers()[r.array].name] < order[s.name]


def test_declarations_and_plan_import_nothing_heavy() -> None:
    code = (
        "import sys, json, posegaussian.stages.registry, posegaussian.dags.config.settings,"
        " posegaussian.dags.planning.plan, posegaussian.dags.diagnostics.tables;"
        " print(json.dumps(sorted({m.partition('.')[0] for m in sys.modules})))"
    )
    loaded = set(
        json.loads(
            subprocess.run(
                [sys.executable, "-c", code],
                capture_output=True,
                text=True,
                check=True,
                cwd=Path(__file__).parent.parent,
            ).stdout
        )
    )
    assert not loaded & HEAVY


def test_settings_of_the_stages_are_plain_data() -> None:
    """They travel to workers and into receipts."""
    values: dict[str, Any] = Settings().model_dump(mode="json")
    assert Settings.model_validate(json.loads(json.dumps(values))) == Settings()


def test_reading_a_source_is_declared_as_such() -> None:
    r = Read.source("pictures")
    assert (r.is_source, r.views) == (True, "own")
