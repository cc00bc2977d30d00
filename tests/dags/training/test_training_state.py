"""A state as bytes: there and back bit by bit, equal states equal bytes, nothing else accepted."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from posegaussian.dags.training.state import packed, unpacked

STATE = {
    "step": 3,
    "big": 2**80,
    "rate": 0.1 + 0.2,
    "not finite": [math.inf, -math.inf],
    "optimizer": {
        "state": {0: {"exp_avg": torch.tensor([1.0, float("nan"), -0.0])}, 1: {}},
        "groups": [{"betas": (0.9, 0.999), "foreach": None, "fused": True}],
    },
    "random": torch.arange(6, dtype=torch.uint8),
    "half": torch.tensor([[1.5, 2.5]], dtype=torch.bfloat16).t(),
    "empty": torch.zeros(0, 3, dtype=torch.int64),
}


def same(a: object, b: object) -> bool:
    if isinstance(a, torch.Tensor):
        return (
            isinstance(b, torch.Tensor)
            and a.dtype == b.dtype
            and a.shape == b.shape
            and a.flatten().contiguous().view(torch.uint8).equal(b.flatten().contiguous().view(torch.uint8))
        )
    if isinstance(a, dict):
        return isinstance(b, dict) and list(a) == list(b) and all(same(a[k], b[k]) for k in a)
    if isinstance(a, list | tuple):
        return type(a) is type(b) and len(a) == len(b) and all(map(same, a, b))  # type: ignore[arg-type]
    return type(a) is type(b) and a == b


def test_there_and_back_is_the_same_to_the_bit() -> None:
    assert same(STATE, unpacked(packed(STATE)))
    assert packed(unpacked(packed(STATE))) == packed(STATE)


def test_tensors_that_share_memory_are_kept_each() -> None:
    whole = torch.arange(4.0)
    found = unpacked(packed({"whole": whole, "same": whole, "part": whole[::2]}))
    assert torch.equal(found["part"], torch.tensor([0.0, 2.0]))
    assert torch.equal(found["same"], whole)


@pytest.mark.parametrize(
    ("state", "said"),
    [
        ({"a": [np.float32(1)]}, r"state\.a\.0 is a float32"),
        ({"a": {(1, 2): 1}}, "keys of a state"),
        ({"a": b"x"}, "is a bytes"),
    ],
)
def test_what_would_not_come_back_is_refused_by_name(state: object, said: str) -> None:
    with pytest.raises(TypeError, match=said):
        packed(state)
