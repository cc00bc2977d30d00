"""Whatever is drawn, every number is finite: scenes by hypothesis, which shrinks what fails.
Ten thousand: `make extreme`."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from posegaussian.stages.splatting.definition.scene import Cutoffs
from tests.hard_cases.extreme import scene
from tests.hard_cases.laws import drawn, pictures, to


@settings(max_examples=300)
@given(st.integers(0, 2**32 - 1), st.integers(0, 40))
def test_every_number_of_an_extreme_scene_is_finite(seed: int, count: int) -> None:
    out, _ = drawn(*scene(seed, count))
    assert not bool((out.alpha > 1).any())
    assert not bool((out.alpha < 0).any())


@pytest.mark.parametrize("start", [0, 100])
def test_extreme_scenes_look_like_those_of_the_reference(start: int) -> None:
    """In float64, from the same float32 numbers. Cut-offs flip and needles lie elsewhere, so the share of odd
    pictures is bounded."""
    odd = 0
    for seed in range(start, start + 100):
        g, cam, cut = scene(seed)
        a, (b, _) = drawn(g, cam, cut)[0], drawn(to(g, torch.float64), cam, cut)
        assert a.masked[0] >= b.masked[0]  # what overflows float32 alone
        odd += float((a.alpha - b.alpha).detach().abs().mean()) > 1e-3
    assert odd <= 8


@settings(max_examples=60)
@given(st.integers(0, 2**32 - 1), st.sampled_from([2, 3]))
def test_threads_change_no_bit_of_an_extreme_scene(seed: int, threads: int) -> None:
    one, gradients = drawn(*scene(seed))
    many, others = drawn(*scene(seed), threads=threads)
    assert all(torch.equal(a, b) for a, b in zip(pictures(one), pictures(many), strict=True))
    assert all(torch.equal(gradients[n], others[n]) for n in gradients)


@settings(max_examples=60)
@given(st.floats(1e-9, 0.5), st.floats(0.5, 0.9999), st.floats(0.0, 0.5))
def test_any_cut_offs_are_valid(alpha_min: float, alpha_max: float, stop: float) -> None:
    g, cam, cut = scene(7, 30)
    out, _ = drawn(
        g, cam, Cutoffs(alpha_min=alpha_min, alpha_max=alpha_max, transmittance_stop=stop, low_pass=cut.low_pass)
    )
    assert float(out.alpha.detach().max()) <= 1 - stop + 1e-6
