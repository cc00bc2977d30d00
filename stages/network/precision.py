"""What `network.precision: auto` comes to: bf16 where the processor multiplies it faster than float32.

The run that plans decides for all its workers, and the answer is part of fingerprints: results of both precisions are
never mixed in silence, and a plan says which it is.
"""

from __future__ import annotations

from functools import cache
from typing import Literal

from posegaussian.stages.contract.declaration import Choice, Evidence, Picked
from posegaussian.stages.contract.facts import Facts, fact
from posegaussian.stages.network.choice import settled
from posegaussian.stages.network.params import NONE, NetworkParams

Precision = Literal["bf16", "float32"]
PICKED: dict[Precision, str] = {"bf16": fact("bf16_layers"), "float32": fact("float32_layers")}
"""{precision: the fact that `auto` comes to it}."""
MATRICES = ("amx-bf16", "bf16")
"""Features of a processor, as LLVM calls them, with which bf16 is taken to be the faster, unmeasured: Intel's matrix
unit, ARM's bf16."""
VECTORS, TWICE = "avx512bf16", "znver"
"""Vectors of bf16 products, and the processors whose vectors do twice as many of them as of float32 ones, by what is
published of their instructions. Intel's do as many: the network takes 1.2 times as long in bf16 as in float32 on an
Emerald Rapids whose host lends no matrix unit (docs/measurements/network.md)."""


@cache
def faster_in_bf16() -> bool:
    """Whether this machine's processor multiplies bf16 numbers faster than float32 ones."""
    from llvmlite.binding import get_host_cpu_features, get_host_cpu_name

    found = get_host_cpu_features()
    if any(found.get(name, False) for name in MATRICES):
        return True
    return found.get(VECTORS, False) and get_host_cpu_name().startswith(TWICE)


def precision_of(params: NetworkParams, facts: Facts) -> tuple[Precision, str]:
    """The precision of the layers and one sentence that says why."""
    if params.precision != "auto":
        return params.precision, f"network.precision is {params.precision}"
    if PICKED["bf16"] in facts:
        return "bf16", "the processor multiplies it faster than float32"
    return "float32", "the processor multiplies bf16 no faster"


def _pick(evidence: Evidence) -> Picked:
    return (
        Picked(PICKED["bf16"], "the processor multiplies bf16 faster than float32")
        if faster_in_bf16()
        else Picked(PICKED["float32"], "the processor multiplies bf16 no faster than float32")
    )


def _undecided(params: NetworkParams, facts: Facts) -> bool:
    return params.precision == "auto" and settled(params, facts).weights != NONE


PRECISION = Choice("precision", precision_of, _undecided, _pick, facts=tuple(PICKED.values()))
