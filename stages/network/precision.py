"""What `network.precision: auto` comes to: bf16 where the processor computes it natively.

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
NATIVE = ("avx512bf16", "amx-bf16", "bf16")
"""Features of a processor, as LLVM calls them, of which each has bf16 products in hardware."""


@cache
def native_bf16() -> bool:
    """Whether this machine's processor multiplies bf16 numbers in hardware."""
    from llvmlite.binding import get_host_cpu_features

    found = get_host_cpu_features()
    return any(found.get(name, False) for name in NATIVE)


def precision_of(params: NetworkParams, facts: Facts) -> tuple[Precision, str]:
    """The precision of the layers and one sentence that says why."""
    if params.precision != "auto":
        return params.precision, f"network.precision is {params.precision}"
    if PICKED["bf16"] in facts:
        return "bf16", "the processor computes it natively"
    return "float32", "the processor has no bf16 products"


def _pick(evidence: Evidence) -> Picked:
    return (
        Picked(PICKED["bf16"], "the processor computes bf16 natively")
        if native_bf16()
        else Picked(PICKED["float32"], "the processor does not compute bf16 natively, and float32 is faster there")
    )


def _undecided(params: NetworkParams, facts: Facts) -> bool:
    return params.precision == "auto" and settled(params, facts).weights != NONE


PRECISION = Choice("precision", precision_of, _undecided, _pick, facts=tuple(PICKED.values()))
