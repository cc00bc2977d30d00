"""Facts: a frozen set of declared names, in which a typing error is an error."""

from __future__ import annotations

import ast
import pickle
from collections.abc import Callable
from pathlib import Path

import pytest

from posegaussian.stages.contract.declaration import Effect
from posegaussian.stages.contract.facts import JOINTS2D, MASKS, SEVERAL_FRAMES, Facts
from posegaussian.stages.registry import STAGES

ROOT = Path(__file__).resolve().parents[2]
HELD = Facts(frozenset({MASKS, JOINTS2D}))


@pytest.mark.parametrize(
    "asked",
    [
        lambda: "maks" in HELD,
        lambda: HELD & {"maks"},
        lambda: {"maks"} & HELD,
        lambda: HELD | {"maks"},
        lambda: {MASKS, "maks"} <= HELD,
        lambda: Facts(frozenset({"maks"})),
    ],
)
def test_a_name_that_nobody_declared_is_an_error(asked: Callable[[], object]) -> None:
    with pytest.raises(KeyError, match=r"no fact is called 'maks'; did you mean 'masks'\?"):
        asked()


def test_declared_names_make_a_set() -> None:
    assert MASKS in HELD
    assert SEVERAL_FRAMES not in HELD
    assert HELD & {MASKS, SEVERAL_FRAMES} == {MASKS}
    assert {SEVERAL_FRAMES} | HELD == {MASKS, JOINTS2D, SEVERAL_FRAMES}
    assert not HELD & {SEVERAL_FRAMES}
    assert isinstance(HELD - {MASKS}, Facts)
    assert sorted(HELD) == [JOINTS2D, MASKS]
    assert {HELD: 1}[Facts(frozenset({JOINTS2D, MASKS}))] == 1
    assert pickle.loads(pickle.dumps(HELD)) == HELD


def test_effects_optional_stages_and_constants_are_known_when_declared() -> None:
    declared = [e.name for s in STAGES for e in s.effects] + [s.name for s in STAGES if s.optional]
    declared += [w.name for s in STAGES if s.sequence_wide for w in s.writes]
    assert len(Facts(frozenset(declared))) == len(set(declared)) > 10
    with pytest.raises(KeyError):
        "made_up_effect" in HELD  # noqa: B015
    Effect("made_up_effect", "Nothing.", "nothing", 0.0, "1", lambda evidence, bound: None)
    assert "made_up_effect" not in HELD


def test_facts_are_asked_for_by_constants() -> None:
    """A literal is found by nobody who looks for where a fact counts; names of arrays are literals everywhere."""
    found = []
    for file in (f for folder in ("stages", "dags") for f in (ROOT / folder).rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_bytes())):
            if isinstance(node, ast.Compare) and isinstance(node.ops[0], ast.In | ast.NotIn | ast.LtE):
                parts = [node.left, *node.comparators]
            elif isinstance(node, ast.BinOp) and isinstance(node.op, ast.BitAnd | ast.BitOr):
                parts = [node.left, node.right]
            else:
                continue
            if any(_is_facts(p) for p in parts):
                asked = [e for p in parts for e in (p.elts if isinstance(p, ast.Set) else [p])]
                texts = [e.value for e in asked if isinstance(e, ast.Constant) and isinstance(e.value, str)]
                found += [f"{file.relative_to(ROOT)}:{node.lineno} {t!r}" for t in texts if "/" not in t]
    assert not found


def _is_facts(node: ast.expr) -> bool:
    """Whether an expression is a task's or a capture's facts, by its name; a receipt's are something else."""
    if isinstance(node, ast.Attribute):
        owner = node.value
        return node.attr in ("facts", "capture_facts") and not (isinstance(owner, ast.Name) and owner.id == "r")
    return isinstance(node, ast.Name) and node.id in ("facts", "f", "known")
