"""What methods came to on sequences, and the means of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from posegaussian.dags.evaluation.measured import Number
from posegaussian.storage.model.capture import Capture

Key = tuple[str, str, str]
"""(measure, region, statistic)."""
DATA_SETS = {
    "zju_mocap": "ZJU-MoCap",
    "humman": "HuMMan",
    "dna_rendering": "DNA-Rendering",
    "people_snapshot": "People-Snapshot",
    "actorshq": "ActorsHQ",
    "mvhumannet": "MVHumanNet",
    "genebody": "GeneBody",
    "panoptic": "Panoptic",
    "dynacap": "DynaCap",
    "gps_gaussian": "THuman2.0",
}
"""{layout of a capture: the data set that is published in it}."""
RATES = ("frames_a_second",)
"""Numbers whose mean over sequences is harmonic: as many frames of each take what its frames take."""
SIMULATED = "simulated people"
"""Captures with true depth."""


def data_set(capture: Capture) -> str:
    """Name of the data set a capture is of; its layout, where that is nobody's."""
    if capture.data_set:
        return capture.data_set
    if capture.has("depth"):
        return SIMULATED
    return DATA_SETS.get(capture.layout, capture.layout)


@dataclass(frozen=True)
class Result:
    """One method on one sequence, or its mean over several."""

    sequence: str
    """Name, or what it is the mean of."""
    data_set: str
    """Of the sequence; "" of a mean over several."""
    method: str
    """Name."""
    numbers: dict[Key, Number] = field(default_factory=dict)
    """Empty where it was not run."""
    why: str = ""
    """Why there are no numbers."""
    hosts: tuple[str, ...] = ()
    """Machines that the seconds were taken on."""
    empty: int = 0
    """Held-out pictures that nobody is in, which are not measured."""
    hidden: int = 0
    """Held-out pictures in which the subject stands behind something: what is hidden is left out of the measures."""

    def value(self, key: Key) -> float | None:
        """None where it has none."""
        number = self.numbers.get(key)
        return number.value if number is not None else None


def keys(results: Sequence[Result]) -> list[Key]:
    """Of all numbers, in the order in which they come first."""
    return list(dict.fromkeys(k for r in results for k in r.numbers))


def with_means(results: Sequence[Result]) -> list[Result]:
    """The results, and after them for every method its mean over each data set of several sequences, then over all."""
    means = []
    sets = list(dict.fromkeys(r.data_set for r in results))
    groups = [(s, [r for r in results if r.data_set == s]) for s in sets] if len(sets) > 1 else []
    for name, of in [*groups, ("", list(results))]:
        sequences = list(dict.fromkeys(r.sequence for r in of))
        if len(sequences) > 1:
            label = f"mean of {len(sequences)}" + (f", {name}" if name else "")
            means += [_mean(label, name, m, of, sequences) for m in dict.fromkeys(r.method for r in of)]
    return [*results, *means]


def overall(results: Sequence[Result]) -> list[Result]:
    """A result a method: its mean over all sequences, or what it came to on the only one."""
    methods = dict.fromkeys(r.method for r in results)
    return with_means(results)[-len(methods) :] if methods else []


def _mean(label: str, name: str, method: str, results: Sequence[Result], sequences: Sequence[str]) -> Result:
    """Over sequences, each as heavy as the others; of a method that has not all of them there is none."""
    own = [r for r in results if r.method == method]
    there = [r for r in own if r.numbers]
    if len(there) < len(sequences):
        why = own[0].why if not there else f"there on {len(there)} of {len(sequences)} sequences"
        return Result(label, name, method, why=why)
    return Result(label, name, method, {k: _over(k, there) for k in keys(there)})


def _over(key: Key, results: Sequence[Result]) -> Number:
    found = [r.numbers[key] for r in results if key in r.numbers]
    values = [n.value for n in found if n.value is not None]
    rate, sequences = key[0] in RATES, len(results)
    first = next((n for n in found if n.value is not None), found[0])
    count = sum(n.count for n in found)
    if len(values) < sequences:
        told = f"there on {len(values)} of {sequences} sequences" if values else first.definition
        return Number(*key, None, first.unit, told, count)
    mean = sequences / sum(1 / v for v in values) if rate else sum(values) / sequences
    told = f"{'harmonic mean' if rate else 'mean'} over {sequences} sequences; {first.definition}"
    why = "; ".join(dict.fromkeys(n.why for n in found if n.why))
    missing, hidden = sum(n.missing for n in found), sum(n.hidden for n in found)
    return Number(*key, mean, first.unit, told, count, missing, why, hidden)
