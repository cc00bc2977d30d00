"""The catalogue of hard cases: one record a case, which the tests hold to its bound and `make stability` writes as a
page.

A record runs twice: the formula as a textbook states it, and ours. Both give their worst error in the same unit; the
naive one may give NaN or infinity, or raise.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache

import numpy as np
import torch


@dataclass(frozen=True)
class Case:
    """One hard case."""

    name: str
    """S1."""
    title: str
    """What the input is."""
    wrong: str
    """What a naive version does with it."""
    unit: str
    """Of both errors and the bound."""
    naive: Callable[[], float]
    """Runs the naive version, returns its worst error."""
    ours: Callable[[], float]
    """Runs ours, returns its worst error."""
    bound: float
    """Promised of ours; 0: exactly equal."""
    reason: str
    """Why the bound is what it is."""


@dataclass(frozen=True)
class Outcome:
    """What one run of a case gave."""

    naive: float
    """Worst error; NaN or infinite where the naive version was, NaN where it raised."""
    raised: str | None
    """Name of what the naive version raised."""
    ours: float
    """Worst error."""


def worst(values: Iterable[float]) -> float:
    """The largest of some errors; NaN where one is no number."""
    return float(np.max(list(values)))


def apart(a: object, b: object) -> float:
    """The largest difference of two arrays or tensors; NaN where one holds what is not finite, 0 of empty ones."""
    x, y = (np.asarray(v.detach() if isinstance(v, torch.Tensor) else v, np.float64) for v in (a, b))
    with np.errstate(invalid="ignore"):
        difference = np.abs(x - y)
    return float(np.max(difference)) if difference.size else 0.0


@cache
def run(case: Case) -> Outcome:
    """Both versions, once a process."""
    raised, naive = None, math.nan
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            naive = float(case.naive())
        except (ValueError, RuntimeError, IndexError, ArithmeticError) as e:
            raised = type(e).__name__
    return Outcome(naive, raised, float(case.ours()))


def holds(case: Case) -> bool:
    """Whether ours stays within its bound and the naive version does not."""
    found = run(case)
    return found.ours <= case.bound and not found.naive <= case.bound


@cache
def catalogue() -> tuple[Case, ...]:
    """Every case that concerns code which is there, in the order of the page."""
    from tests.hard_cases import (
        cases_cameras,
        cases_depth,
        cases_metrics,
        cases_network,
        cases_pose,
        cases_splatting,
        cases_training,
    )

    return (
        *cases_splatting.CASES,
        *cases_cameras.CASES,
        *cases_depth.CASES,
        *cases_pose.CASES,
        *cases_metrics.CASES,
        *cases_training.CASES,
        *cases_network.CASES,
    )


def named(name: str) -> Case:
    """A case by its name."""
    return next(c for c in catalogue() if c.name == name)
