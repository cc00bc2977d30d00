"""A search for the front of seconds against quality, where trying every combination of levels would take days.

Successive halving over frames (Jamieson and Talwalkar, "Non-stochastic Best Arm Identification", 2016): many settings
are tried on very few frames, those nearest to the front again on more, and so on. What is tried first changes one knob
at a time; from then on it is what promises most beyond the front of what was tried (surrogate.py). Written here because
the libraries for it (Optuna, SMAC) know nothing of stages: that seconds add up over them is what makes few runs enough.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NamedTuple, TypeAlias

import numpy as np

from posegaussian.dags.tradeoff.pareto import pareto
from posegaussian.dags.tradeoff.surrogate import Setting, predicted, predicted_seconds

WORTH = 0.002
"""dB by which a setting must promise to lift the front, on the mean of all budgets, to be tried."""
HOPE = 0.3
"""Standard deviations above what is expected that a setting is taken for. On seconds and decibels made up
(tests/dags/tradeoff/test_search.py: 6912 settings, 0.2 to 52 s) 60 runs leave 0.20 dB to the true front on the mean of
all budgets, the 8 settings of the last rung 0.41; twice as much hope leaves 0.25 and 0.45, 36 settings at random
1.4."""
BUDGETS = 48
"""Seconds at which the front is looked at."""
MANY = 20_000
"""Settings that are looked at before the next one is tried; of a larger space so many at random."""
FIRST = 0.6
"""Share of all runs that the first rung has."""
SCREENED = 0.6
"""Share of the first rung's runs that changes one knob at a time, at most."""


class Tried(NamedTuple):
    """What came of one setting."""

    seconds: Mapping[str, float]
    """{stage: seconds a frame}."""
    quality: float
    """dB, higher is better."""

    @property
    def total(self) -> float:
        """Seconds a frame."""
        return sum(self.seconds.values())


Found: TypeAlias = dict[Setting, Tried]
Trial: TypeAlias = Callable[[Setting, int], Tried | None]
"""Runs a setting on the frames of a rung, 0 the fewest; None where it cannot be run."""


def rung_sizes(rungs: int, runs: int) -> list[int]:
    """How many settings are tried on each rung, `runs` in all: FIRST of them on the first, because the front is found
    there, then on each half as many as on the one before."""
    last = max(1, int((1 - FIRST) * runs / (2 ** (rungs - 1) - 1))) if rungs > 1 else 0
    later = [last * 2 ** (rungs - 1 - r) for r in range(1, rungs)]
    return [max(1, runs - sum(later)), *later]


def search(levels: Sequence[int], own: Setting, rungs: int, runs: int, trial: Trial) -> Found:
    """What was tried on the last rung, the setting `own` that is set today among it.

    levels: how many each knob has, cheap to dear.
    """
    first, *later = rung_sizes(rungs, runs)
    found = _explored(levels, own, first, trial)
    for rung, size in enumerate(later, 1):
        if not found:
            break
        kept = nearest_to_front(found, size, own)
        tried = ((setting, trial(setting, rung)) for setting in kept)
        found = {setting: result for setting, result in tried if result is not None}
    return found


def _explored(levels: Sequence[int], own: Setting, runs: int, trial: Trial) -> Found:
    """The first rung: one knob at a time, then what promises most, until nothing does; all where that is no more."""
    found: Found = {}
    failed: set[Setting] = set()

    def attempt(setting: Setting) -> None:
        result = trial(setting, 0)
        if result is None:
            failed.add(setting)
        else:
            found[setting] = result

    whole = int(np.prod(levels, dtype=np.int64)) <= runs
    screened = max(1, int(SCREENED * runs))
    for setting in _space(levels) if whole else itertools.islice(to_screen(levels, own), screened):
        attempt(setting)
    while found and len(found) + len(failed) < runs:
        chosen = most_promising(found, failed, levels)
        if chosen is None:
            break
        attempt(chosen)
    return found


def to_screen(levels: Sequence[int], own: Setting) -> Iterator[Setting]:
    """The setting itself and the cheapest of all, then the setting with one knob changed: every knob's cheapest and
    dearest level before all others."""
    yield own
    cheapest = tuple(0 for _ in levels)
    if sum(a != b for a, b in zip(own, cheapest, strict=True)) > 1:
        yield cheapest
    ends = {k: [0, n - 1] for k, n in enumerate(levels)}
    inner = {k: list(range(1, n - 1)) for k, n in enumerate(levels)}
    for chosen in (ends, inner):
        for k, places in chosen.items():
            for place in dict.fromkeys(places):
                if place != own[k]:
                    yield (*own[:k], place, *own[k + 1 :])


def most_promising(found: Found, failed: set[Setting], levels: Sequence[int]) -> Setting | None:
    """The setting that would lift the front most, were its quality HOPE standard deviations above the expected: in
    dB, over all budgets alike, which are spread by their logarithm from the cheapest expected to the dearest found.
    What is cheaper than all that was found has no front to beat but what is expected at worst. None where none promises
    anything."""
    asked = [s for s in _space(levels) if s not in found and s not in failed]
    if not asked:
        return None
    tried = list(found)
    mean, deviation = predicted(tried, np.array([found[s].quality for s in tried]), asked, levels)
    seconds = predicted_seconds(tried, [found[s].seconds for s in tried], asked, levels)
    totals = np.array([t.total for t in found.values()])
    budgets = np.geomspace(max(min(totals.min(), seconds.min()), 1e-9), max(totals.max(), 1e-9), BUDGETS)
    hoped, lifted = mean + HOPE * deviation, np.zeros(len(asked))
    worst = min(float(hoped.min()), min(t.quality for t in found.values()))
    reached = np.where(budgets < totals.min(), worst, front_at(found, budgets))
    for budget, there in zip(budgets, reached, strict=True):
        lifted += np.maximum(hoped - there, 0) * (seconds <= budget)
    best = int(np.argmax(lifted))
    return asked[best] if lifted[best] / BUDGETS > WORTH else None


def front_at(found: Found, seconds: np.ndarray) -> np.ndarray:
    """[m] the best quality found within so many seconds; the worst found where nothing is as cheap."""
    reached = sorted((t.total, t.quality) for t in found.values())
    best = np.maximum.accumulate([quality for _, quality in reached])
    place = np.searchsorted([total for total, _ in reached], seconds, side="right") - 1
    return np.where(place >= 0, best[np.maximum(place, 0)], min(quality for _, quality in reached))


def nearest_to_front(found: Found, count: int, own: Setting) -> list[Setting]:
    """`count` settings, cheapest first: the one that is set today, then the front, of which what spans least goes first
    where there is too much of it, then what lies nearest below it."""
    settings = list(found)
    best = pareto([(found[s].total, -found[s].quality) for s in settings])
    front = [s for s, on in zip(settings, best, strict=True) if on]
    others = [s for s in settings if s not in front and s != own]
    gap = dict(zip(others, front_at(found, np.array([found[s].total for s in others])), strict=True))
    others.sort(key=lambda s: gap[s] - found[s].quality)
    room = count - (own in found and own not in front)
    while len(front) > max(1, room):
        front.remove(_spanning_least(front, found, own))
    kept = dict.fromkeys([*([own] if own in found else []), *front, *others])
    return sorted(list(kept)[:count], key=lambda s: found[s].total)


def _spanning_least(front: Sequence[Setting], found: Found, own: Setting) -> Setting:
    """The member of a front without which least is lost: dB above the next cheaper one times the logarithm of seconds
    to the next dearer one. The cheapest and the best stay as long as others can go, and `own` always."""
    ordered = sorted(front, key=lambda s: found[s].total)
    lost = {}
    for before, here, after in zip(ordered, ordered[1:], ordered[2:], strict=False):
        gained = found[here].quality - found[before].quality
        lost[here] = gained * np.log(found[after].total / max(found[here].total, 1e-9))
    inner = {s: loss for s, loss in lost.items() if s != own}
    return min(inner, key=lambda s: inner[s]) if inner else next(s for s in reversed(ordered) if s != own)


def _space(levels: Sequence[int]) -> Iterator[Setting]:
    """Every setting, or MANY of them, the same ones each time."""
    size = int(np.prod(levels, dtype=np.int64))
    if size <= MANY:
        yield from itertools.product(*(range(n) for n in levels))
        return
    chosen = np.random.default_rng(0).integers(0, np.asarray(levels), (MANY, len(levels)))
    yield from dict.fromkeys(tuple(int(i) for i in row) for row in chosen)
