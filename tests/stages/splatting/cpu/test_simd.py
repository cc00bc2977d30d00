"""Vectors inside kernels: each operation against numpy."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numba import njit

from posegaussian.stages.splatting.cpu import simd
from posegaussian.stages.splatting.cpu.simd import load, splat, store, store_rows, sums

A = np.array([0.3, -1.5, 2.25, 7.0, -0.0, 120.0, 1e-3, 3.5], np.float32)
B = np.array([1.0, -2.5, 2.25, 0.5, 4.0, 1e-6, -3.0, 3.0], np.float32)


def applied(kernel: Callable[..., Any], *arrays: np.ndarray) -> np.ndarray:
    out = np.zeros(8, np.float32)
    kernel(*arrays, out)
    return out


@njit
def _exp2(a: np.ndarray, out: np.ndarray) -> None:
    store(out, 0, simd.exp2_minus(load(a, 0)))


@njit
def _log2(a: np.ndarray, out: np.ndarray) -> None:
    store(out, 0, simd.log2(load(a, 0)))


@pytest.mark.parametrize("high", [0.01, 8.0, 100.0])
def test_exp2_is_within_two_units_of_the_last_place(high: float) -> None:
    for a in np.linspace(0, high, 8000).astype(np.float32).reshape(-1, 8):
        np.testing.assert_allclose(applied(_exp2, a), 2.0 ** -a.astype(np.float64), rtol=2 * 2.0**-23)


def test_exp2_of_zero_is_one_and_log2_of_one_is_zero() -> None:
    assert (applied(_exp2, np.zeros(8, np.float32)) == 1).all()
    assert (applied(_log2, np.ones(8, np.float32)) == 0).all()


def test_log2_is_within_rounding() -> None:
    for a in (10.0 ** np.linspace(-30, 6, 8000)).astype(np.float32).reshape(-1, 8):
        exact = np.log2(a.astype(np.float64))
        assert (np.abs(applied(_log2, a) - exact) <= 2 * 2.0**-23 * np.maximum(1, np.abs(exact))).all()


@njit
def _both_sides(a: np.ndarray, b: np.ndarray, out: np.ndarray) -> None:
    x, y = load(a, 0), load(b, 0)
    value = simd.choose(simd.both(x > y, y >= splat(-2.5)), x / y, x * y)
    store(out, 0, simd.fma(value, simd.least(x, y), simd.greatest(x, y) - simd.floor(x)))


def test_arithmetic() -> None:
    with np.errstate(all="ignore"):
        value = np.where((A > B) & (B >= -2.5), A / B, A * B)
    np.testing.assert_allclose(
        applied(_both_sides, A, B), value * np.minimum(A, B) + (np.maximum(A, B) - np.floor(A)), rtol=1e-6
    )


@njit
def _sums(a: np.ndarray, out: np.ndarray) -> None:
    v = load(a, 0)
    one = splat(1.0)
    store(out, 0, sums(v, v + v, one, v * v, v - one, one + one, v, v * one))


def test_sums_along_the_lanes() -> None:
    a = np.arange(1, 9, dtype=np.float32)
    assert applied(_sums, a).tolist() == [36, 72, 8, 204, 28, 16, 36, 36]


@njit
def _rows(a: np.ndarray, out: np.ndarray) -> None:
    v = load(a, 0)
    store_rows(
        out,
        0,
        10,
        v,
        v + splat(10),
        v + splat(20),
        v + splat(30),
        v + splat(40),
        v + splat(50),
        v + splat(60),
        v + splat(70),
    )


def test_rows_are_columns_transposed() -> None:
    out = np.zeros(80, np.float32)
    _rows(np.arange(8, dtype=np.float32), out)
    np.testing.assert_array_equal(out.reshape(8, 10)[:, :8], np.arange(8)[:, None] + 10 * np.arange(8))
    assert not out.reshape(8, 10)[:, 8:].any()
