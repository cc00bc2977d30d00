"""Laws of declared arrays and of canonical hashing: equal values hash equally, different ones differently, anywhere."""

from __future__ import annotations

import os
import subprocess
import sys
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from posegaussian.storage.model.spec import FIXED_DIMS, ArraySpec, array_digest, canonical, digest, dim_length

QUICK = settings(max_examples=50)
leaves = (
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.text(st.characters(exclude_categories=["Cs"]), max_size=5)
)
values = st.recursive(
    leaves,
    lambda v: (
        st.lists(v, max_size=3)
        | st.dictionaries(st.text(st.characters(exclude_categories=["Cs"]), max_size=3), v, max_size=3)
    ),
    max_leaves=8,
)


@QUICK
@given(
    st.dictionaries(st.text(st.characters(exclude_categories=["Cs"]), max_size=4), values, max_size=6),
    st.randoms(use_true_random=False),
)
def test_the_order_of_a_mapping_does_not_matter(value: dict, random) -> None:
    items = list(value.items())
    random.shuffle(items)
    assert digest(dict(items)) == digest(value)


@QUICK
@given(st.lists(values, min_size=2, max_size=4))
def test_the_order_of_a_list_matters(value: list) -> None:
    assert (digest(value) == digest(value[::-1])) == (canonical(value) == canonical(value[::-1]))


DISTINCT = [
    None, False, True, 0, 1, -1, 0.0, -0.0, 1.0, np.nextafter(1.0, 2.0), float("inf"), float("-inf"), float("nan"), "",
    "1", "1.0", "True", "null", [], [[]], {}, [1], [1, 2], [2, 1], [12], {"a": 1}, {"b": 1}, {"a": {"b": 1}},
    np.zeros(2, np.float32), np.zeros(2, np.float64), np.zeros(2, np.int32), np.zeros((2, 1), np.float32),
    np.zeros((1, 2), np.float32), np.full(2, -0.0, np.float32), np.zeros(0, np.float32), np.zeros((0, 3), np.float32),
    np.array(0.0), np.zeros(2, bool), np.zeros(2, np.uint8),
]  # fmt: skip


def test_values_of_different_kind_sign_shape_or_type_hash_differently() -> None:
    for a, b in combinations(DISTINCT, 2):
        assert digest(a) != digest(b), f"{a!r} and {b!r} share a digest"


def test_what_means_the_same_hashes_equally() -> None:
    assert digest((1, 2)) == digest([1, 2]) == digest(range(1, 3))
    assert digest(np.int64(3)) == digest(3)
    assert digest(np.float32(0.5)) == digest(0.5)
    assert digest(float("nan")) == digest(np.float64("nan"))


def test_a_digest_is_the_same_in_another_process_with_another_hash_seed() -> None:
    code = (
        "import numpy as np; from posegaussian.storage.model.spec import digest; print(digest({'b': [1.5, -0.0, 'x'],"
        " 'a': np.arange(6.0).reshape(2, 3)}))"
    )
    env = {**os.environ, "PYTHONHASHSEED": "12345"}
    other = subprocess.run(
        [sys.executable, "-c", code], env=env, capture_output=True, text=True, check=True
    ).stdout.strip()
    assert other == digest({"a": np.arange(6.0).reshape(2, 3), "b": [1.5, -0.0, "x"]})
    assert len(other) == 32
    assert set(other) <= set("0123456789abcdef")


@pytest.mark.parametrize(
    "value", [{1, 2}, object(), b"bytes", lambda: 0, [1, {2}], {"a": object()}, np.array([object()])]
)
def test_what_has_no_canonical_form_is_refused_rather_than_hashed_by_address(value: object) -> None:
    with pytest.raises(TypeError, match="canonical form"):
        digest(value)


@QUICK
@given(
    st.sampled_from(["uint8", "int64", "float16", "float32", "float64", "bool"]),
    st.lists(st.integers(0, 4), min_size=1, max_size=4),
    st.integers(0, 99),
)
def test_an_array_digest_ignores_the_memory_layout_only(dtype: str, shape: list[int], seed: int) -> None:
    a = np.random.default_rng(seed).integers(0, 2, shape).astype(dtype)
    padded = np.zeros([2 * n for n in shape], dtype)
    strided = padded[tuple(slice(None, None, 2) for _ in shape)]
    strided[...] = a
    assert array_digest(a) == array_digest(np.asfortranarray(a)) == array_digest(strided)
    assert array_digest(a) != array_digest(a[None])
    assert array_digest(a) != array_digest(a.astype("complex64"))
    if a.size:
        other = a.copy()
        other.flat[seed % a.size] = 1 - other.flat[seed % a.size]
        assert array_digest(other) != array_digest(a)


def test_an_array_digest_sees_the_sign_of_zero() -> None:
    assert array_digest(np.array([0.0])) != array_digest(np.array([-0.0]))


@QUICK
@given(st.integers(1, 5000), st.integers(1, 9))
def test_a_divided_dimension_is_rounded_up(length: int, divisor: int) -> None:
    n = dim_length(f"y/{divisor}", {"y": length})
    assert (n - 1) * divisor < length <= n * divisor
    assert dim_length("y", {"y": length}) == length


def test_fixed_dimensions_need_no_capture_and_cannot_be_overruled() -> None:
    assert {d: dim_length(d, {}) for d in FIXED_DIMS} == FIXED_DIMS
    assert dim_length("rgb", {"rgb": 7}) == 3


def test_an_unknown_dimension_is_named_with_the_known_ones() -> None:
    with pytest.raises(KeyError, match="unknown dimension 'z'") as error:
        ArraySpec("a", ("frame", "z"), "uint8", "1", "x").lengths({"frame": 3, "y": 5})
    assert "frame" in str(error.value)
    assert "rgb" in str(error.value)


def test_a_spec_knows_its_batch_axes() -> None:
    spec = ArraySpec("a", ("frame", "view", "y/4", "x/4", "rgb"), "uint8", "1", "x")
    assert spec.lengths({"frame": 2, "view": 3, "y": 9, "x": 8}) == (2, 3, 3, 2, 3)
    assert (spec.per_frame, spec.per_view) == (True, True)
    plain = ArraySpec("a", ("joint", "uvs"), "uint8", "1", "x")
    assert (plain.per_frame, plain.per_view) == (False, False)
