"""The declaration language by itself: settings, reads, resolving."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from pydantic import ValidationError

from posegaussian.stages.contract.declaration import Params, Read, Resources, Stage, Typical, extra, resolve, setting
from posegaussian.stages.contract.facts import Facts
from posegaussian.storage.model.spec import ArraySpec, TableSpec


class Example(Params):
    weight: float = setting(0.5, "A weight.", ge=0, le=1)
    length: int = setting(3, "A length.", unit="frames", quality_levels=[1, 3, 9], ge=1)
    shown: bool = setting(False, "Whether it is shown.", volatile=True)


STAGE = Stage(
    name="example",
    summary="Do nothing.",
    version=1,
    run="math:sqrt",
    reads=(
        Read("a/x", when=lambda p, f: p.length > 1),
        Read("a/y", halo=lambda p, f: (p.length, 0)),
        Read.source("masks", when=lambda p, f: "masks" in f),
    ),
    writes=(ArraySpec("b/x", ("frame",), "uint8", "1", "X."), TableSpec("b/t", (("a", "int64"),), "T.", when="masks")),
    over=("sequence", "time"),
    params=Example,
    needs=lambda shape, params: Resources(ram=1),
    typical=Typical(seconds=1e-6),
)


def test_unknown_and_impossible_settings_are_errors() -> None:
    for wrong in ({"wieght": 1}, {"weight": 1.5}, {"weight": -0.1}, {"length": 0}, {"length": "long"}):
        with pytest.raises(ValidationError):
            Example(**wrong)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_no_setting_is_nan_or_infinite(value: float) -> None:
    class Open(Params):
        free: float = setting(0.0, "Without bounds.")
        span: tuple[float, float] | None = setting(None, "A pair.")

    with pytest.raises(ValidationError):
        Open(free=value)
    with pytest.raises(ValidationError):
        Open(span=(value, 1.0))


def test_settings_are_frozen() -> None:
    with pytest.raises(ValidationError, match="frozen"):
        Example().weight = 0.1


def test_a_default_outside_its_bounds_is_an_error() -> None:
    class Wrong(Params):
        weight: float = setting(2.0, "A weight.", le=1)

    with pytest.raises(ValidationError):
        Wrong()


def test_volatile_settings_are_not_hashed() -> None:
    assert Example().hashed() == {"weight": 0.5, "length": 3}
    assert Example(shown=True).hashed() == Example().hashed()
    assert Example(weight=0.25).hashed() != Example().hashed()


def test_a_setting_carries_its_documentation() -> None:
    field = Example.model_fields["length"]
    assert field.description == "A length."
    assert extra(field) == {"unit": "frames", "volatile": False, "quality_levels": [1, 3, 9]}
    assert extra(Example.model_fields["weight"])["unit"] == "1"


def test_reads_and_writes_follow_params_and_facts() -> None:
    none: frozenset[str] = frozenset()
    assert [r.array for r in STAGE.reads_for(Example(), none)] == ["a/x", "a/y"]
    assert [r.array for r in STAGE.reads_for(Example(length=1), frozenset({"masks"}))] == ["a/y", "masks"]
    assert [w.name for w in STAGE.writes_for(none)] == ["b/x"]
    assert [w.name for w in STAGE.writes_for(frozenset({"masks"}))] == ["b/x", "b/t"]


def test_a_halo_is_fixed_or_follows_from_the_params() -> None:
    x, y, _ = STAGE.reads
    assert x.halo_for(Example(), Facts()) == (0, 0)
    assert y.halo_for(Example(length=7), Facts()) == (7, 0)
    assert replace(x, halo=(2, 1)).halo_for(Example(), Facts()) == (2, 1)


def test_by_default_a_stage_is_needed_served_exact_and_of_one_partition() -> None:
    assert STAGE.unneeded(Example(), frozenset()) is None
    assert STAGE.refusal(Example(), frozenset()) is None
    assert STAGE.tolerance is None
    assert not STAGE.sequence_wide


def test_a_dotted_name_resolves_to_the_function() -> None:
    assert resolve("math:sqrt") is math.sqrt
    with pytest.raises(ModuleNotFoundError):
        resolve("posegaussian.stages.nowhere:run")
    with pytest.raises(AttributeError):
        resolve("math:nothing")
