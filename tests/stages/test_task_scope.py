"""What a task is about is declared once, and whatever stands in for a task's inputs has all of it."""

from __future__ import annotations

import ast
from dataclasses import FrozenInstanceError, fields
from pathlib import Path

import numpy as np
import pytest

from posegaussian.stages.contract.facts import Facts
from posegaussian.stages.contract.io import Inputs, TaskScope, Views
from posegaussian.stages.inspection.footage import scope_of
from posegaussian.storage.model.cameras import Rig

ROOT = Path(__file__).resolve().parents[2]
NAMES = {f.name for f in fields(TaskScope)}
MOST = 4
"""Facts of a task that another class may have beside it: the cameras, which nearly everybody looks at."""


def test_no_other_class_that_a_worker_or_a_kernel_sees_declares_them_again() -> None:
    again = []
    for folder in ("stages", "dags/runtime", "tests"):
        for file in (ROOT / folder).rglob("*.py"):
            for node in ast.walk(ast.parse(file.read_bytes())):
                if isinstance(node, ast.ClassDef) and node.name != "TaskScope":
                    own = {s.target.id for s in node.body if isinstance(s, ast.AnnAssign) and _named(s.target)}
                    own |= {s.name for s in node.body if isinstance(s, ast.FunctionDef)}
                    if len(own & NAMES) > MOST:
                        again.append(f"{file.relative_to(ROOT)}:{node.lineno} {sorted(own & NAMES)}")
    assert not again


def _named(target: ast.expr) -> bool:
    return isinstance(target, ast.Name)


def made() -> TaskScope:
    rig = Rig(
        ("a", "b"), np.tile(np.eye(3), (2, 1, 1)), np.zeros((2, 8)), np.tile(np.eye(4), (2, 1, 1)), np.ones((2, 2), int)
    )
    return scope_of(rig, rig, np.tile([1.0, 0.0, 0.0], (2, 1)), Facts())


def test_inputs_have_their_scope_and_must_say_how_they_read() -> None:
    class Reading(Inputs):
        def span(self, array: str) -> range:
            return range(0)

        def read(
            self, array: str, view: int | None = None, frames: range | None = None, first: int | None = None
        ) -> np.ndarray:
            return np.zeros(0)

        def footage(self, array: str) -> tuple[np.ndarray, np.ndarray]:
            return np.zeros(0), np.zeros(0)

        def source(self, kind: str) -> object:
            return None

    scope = made()
    inputs = Reading(scope)
    assert all(getattr(inputs, name) is getattr(scope, name) for name in NAMES)
    assert inputs.views == Views(("a", "b"), (0, 1), ())
    with pytest.raises(FrozenInstanceError):
        inputs.facts = Facts()  # type: ignore[misc]
    with pytest.raises(TypeError, match="abstract"):
        Inputs(scope)  # type: ignore[abstract]
