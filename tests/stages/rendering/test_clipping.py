import numpy as np
import pytest

from posegaussian.stages.rendering.clipping import Fillable, clipped, filled


def test_clipping_takes_color_and_alpha_in_proportion() -> None:
    random = np.random.default_rng(0)
    alpha, covered = random.random((2, 9, 9)).astype(np.float32)
    color = (alpha[..., None] * np.float32([0.2, 0.5, 0.8])).astype(np.float32)
    shown, less = clipped(color, alpha, covered)
    np.testing.assert_array_equal(less, np.minimum(alpha, covered))
    np.testing.assert_allclose(shown, less[..., None] * np.float32([0.2, 0.5, 0.8]), rtol=1e-5)
    same = clipped(color, alpha, np.ones_like(alpha))
    np.testing.assert_allclose(same[0], color, rtol=1e-6)
    np.testing.assert_array_equal(same[1], alpha)


@pytest.mark.parametrize(("hole", "closed"), [((50, 53), True), ((50, 70), False)])
def test_small_holes_take_the_colour_around_and_large_ones_stay(hole: tuple[int, int], closed: bool) -> None:
    alpha = np.zeros((512, 512), np.float32)
    alpha[20:100, 20:100] = 0.98
    alpha[slice(*hole), slice(*hole)] = 0
    # A notch is open to the background.
    alpha[20:26, 40:42] = 0
    color = alpha[..., None] * np.float32([0.9, 0.4, 0.1])
    shown, more = filled(color, alpha, Fillable.of(alpha, 512), np.ones_like(alpha), 512, 1.0)
    assert (more >= alpha).all()
    assert (more[slice(*hole), slice(*hole)] > 0.99).all() == closed
    assert not more[20:25, 40:42].any()
    assert not more[alpha == 0][:1000].any()
    np.testing.assert_allclose(shown, more[..., None] * np.float32([0.9, 0.4, 0.1]), atol=1e-3)
    bounded = filled(color, alpha, Fillable.of(alpha, 512), np.zeros_like(alpha), 512, 1.0)
    np.testing.assert_array_equal(bounded[1], alpha)


@pytest.mark.parametrize("lit", [0.0, 0.4, 1.0])
def test_what_is_solid_all_around_becomes_opaque_and_as_bright_as_is_told(lit: float) -> None:
    alpha = np.zeros((512, 512), np.float32)
    alpha[20:100, 20:100] = 0.9
    alpha[50:53, 50:53] = 0
    own = np.float32([0.9, 0.4, 0.1])
    shown, more = filled(alpha[..., None] * own, alpha, Fillable.of(alpha, 512), np.ones_like(alpha), 512, lit)
    np.testing.assert_allclose(more[21:99, 21:99], 1, atol=1e-6)
    np.testing.assert_array_equal(more[20, 20:100], alpha[20, 20:100])
    np.testing.assert_allclose(shown[50:53, 50:53], np.broadcast_to(own, (3, 3, 3)), atol=1e-3)
    np.testing.assert_allclose(shown[25, 25], (0.9 + lit * 0.1) * own, rtol=1e-5)


@pytest.mark.parametrize(("width", "closed"), [(3, True), (8, False)])
def test_a_thin_crack_is_closed_however_long_unless_it_opens_to_the_background(width: int, closed: bool) -> None:
    alpha = np.zeros((512, 512), np.float32)
    alpha[50:450, 50:450] = 1
    within, open_to_one_side = (slice(100, 400), slice(200, 200 + width)), (slice(50, 300), slice(300, 300 + width))
    alpha[within] = alpha[open_to_one_side] = 0
    color = alpha[..., None] * np.float32([0.9, 0.4, 0.1])
    more = filled(color, alpha, Fillable.of(alpha, 512), np.ones_like(alpha), 512, 1.0)[1]
    assert (more[within] > 0.99).all() == closed
    assert not more[within].any() or closed
    assert not more[open_to_one_side].any()


def test_what_the_border_cuts_is_solid_up_to_it() -> None:
    alpha = np.zeros((64, 48), np.float32)
    alpha[20:, :] = 0.8
    own = np.float32([0.9, 0.4, 0.1])
    more = filled(alpha[..., None] * own, alpha, Fillable.of(alpha, 64), np.ones_like(alpha), 64, 1.0)[1]
    np.testing.assert_allclose(more[21:], 1, atol=1e-6)
    np.testing.assert_array_equal(more[20], alpha[20])
