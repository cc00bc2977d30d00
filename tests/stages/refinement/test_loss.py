"""The loss: its structure is the metrics' SSIM, its slopes are those of its value."""

import numpy as np
import pytest

from posegaussian.stages.metrics.measures.ssim import ssim_map
from posegaussian.stages.refinement.steps.loss import Filmed, Loss, loss, weighed
from posegaussian.stages.refinement.steps.structure import Moments, structure
from posegaussian.stages.splatting.definition.scene import Camera

H, W = 36, 40


def pictures() -> tuple[np.ndarray, np.ndarray]:
    """A patch on black, and the same with noise: outside the window the border's treatment has no say."""
    random = np.random.default_rng(3)
    truth = np.zeros((H, W, 3), np.float32)
    truth[12:24, 12:28] = random.uniform(0.2, 0.8, (12, 16, 3))
    noise = np.zeros_like(truth)
    noise[12:24, 12:28] = random.normal(0, 0.1, (12, 16, 3))
    return truth + noise, truth


def compared(x: np.ndarray, y: np.ndarray, weight: np.ndarray | None = None) -> tuple[float, np.ndarray]:
    return structure(x, y, Moments.of(y), np.ones(x.shape[:2], np.float32) if weight is None else weight, 1.0)


def filmed(color: np.ndarray, cover: np.ndarray) -> Filmed:
    return Filmed(Camera(np.eye(3), np.eye(4), color.shape[1], color.shape[0]), color, cover)


def test_equal_pictures_cost_nothing_and_have_no_gradient() -> None:
    _, truth = pictures()
    value, slope = compared(truth, truth)
    assert abs(value) < 1e-4
    # at the maximum of SSIM the gradient vanishes; what is left is float32 rounding over variances of about C2
    assert float(np.abs(slope).max()) < 1e-3


def test_it_is_the_metrics_ssim() -> None:
    given, truth = pictures()
    expected = (1 - ssim_map(given.astype(np.float64), truth.astype(np.float64), 1.0)) / 2
    np.testing.assert_allclose(compared(given, truth)[0], expected.sum(), rtol=1e-3)


def test_the_gradient_is_the_slope_of_the_value() -> None:
    given, truth = pictures()
    random = np.random.default_rng(5)
    weight = random.uniform(0, 1, (H, W)).astype(np.float32)
    direction = np.zeros((H, W, 3), np.float32)
    direction[12:24, 12:28] = random.normal(0, 1, (12, 16, 3))
    step = np.float32(1e-3)
    up, down = (compared(given + s * step * direction, truth, weight)[0] for s in (1, -1))
    slope = compared(given, truth, weight)[1]
    np.testing.assert_allclose(float((slope * direction).sum()), (up - down) / (2 * step), rtol=0.01)


@pytest.mark.parametrize("of", ["color", "alpha"])
def test_the_whole_losss_slopes_are_those_of_its_value(of: str) -> None:
    given, truth = pictures()
    random = np.random.default_rng(6)
    cover = (truth[..., 0] > 0).astype(np.float32)
    alpha = random.uniform(0.2, 0.8, (H, W)).astype(np.float32)
    weight = np.where(cover > 0, random.uniform(0, 1, (H, W)), 1).astype(np.float32)
    direction = random.normal(0, 1, given.shape if of == "color" else alpha.shape).astype(np.float32)
    # steps so small that no difference changes its sign: the absolute value has a corner there
    off = np.abs(given - truth) if of == "color" else np.abs(alpha - cover)
    direction *= (off > 3e-3) & (np.abs(direction) < 2)
    step = np.float32(1e-3)

    def at(s: float) -> Loss:
        moved = step * np.float32(s) * direction
        c, a = (given + moved, alpha) if of == "color" else (given, alpha + moved)
        return weighed(c, a, filmed(truth, cover), weight, coverage=0.05)

    slope = at(0).by_color if of == "color" else at(0).by_alpha
    np.testing.assert_allclose(float((slope * direction).sum()), (at(1).value - at(-1).value) / (2 * step), rtol=0.01)


def test_a_hole_in_the_person_pulls_at_nothing_and_what_is_drawn_beside_costs_all_of_it() -> None:
    _, truth = pictures()
    cover = (truth[..., 0] > 0).astype(np.float32)
    black, nothing = np.zeros_like(truth), np.zeros((H, W), np.float32)
    hole = loss(black, nothing, filmed(truth, cover))
    assert not hole.by_alpha.any()
    assert not hole.by_color[17:19, 19:21].any(), "where no window reaches beyond the person"
    beside = nothing.copy()
    beside[2:5, 2:5] = 0.5
    more = loss(black, beside, filmed(truth, cover)).value - hole.value
    assert more == pytest.approx(9 * 0.05 * 0.5, rel=1e-4)


def test_what_both_pictures_leave_black_adds_nothing() -> None:
    given, truth = pictures()
    cover = (truth[..., 0] > 0).astype(np.float32)
    narrow = loss(given, cover, filmed(truth, cover))
    padded = [np.pad(a, ((0, 30), (0, 50), (0, 0))[: a.ndim]) for a in (given, cover, truth)]
    wide = loss(padded[0], padded[1], filmed(padded[2], padded[1]))
    assert wide.value == pytest.approx(narrow.value, rel=1e-6)
    # whose noise is not under the mask lies at the far side of the box: windows add up in another order there
    np.testing.assert_allclose(wide.by_color[:H, :W], narrow.by_color, atol=1e-6)
    assert not wide.by_color[H:].any()


def test_empty_pictures_cost_nothing() -> None:
    empty, nothing = np.zeros((H, W, 3), np.float32), np.zeros((H, W), np.float32)
    found = loss(empty, nothing, filmed(empty, nothing))
    assert found.value == 0.0
    assert not found.by_color.any()


def test_what_a_mask_may_lack_costs_nothing_and_the_rest_what_it_did() -> None:
    """Farther from it than half the window of SSIM, nothing else changes by what is drawn there."""
    drawn, truth = pictures()
    cover = (truth.sum(axis=-1) > 0).astype(np.float32)
    lacking = np.zeros((H, W), bool)
    lacking[29:, 30:] = True
    more, alpha = drawn.copy(), np.where(cover > 0, 0.9, 0).astype(np.float32)
    own = Filmed(filmed(truth, cover).camera, truth, cover, lacking)
    before = loss(drawn, alpha, own)
    more[lacking], alpha[lacking] = 0.7, 0.8
    after, counted = loss(more, alpha, own), loss(more, alpha, filmed(truth, cover))
    assert not after.by_alpha[lacking].any()
    assert counted.by_alpha[lacking].all()
    near = np.zeros((H, W), bool)
    near[29 - 5 :, 30 - 5 :] = True  # windows of 11 px
    np.testing.assert_array_equal(after.by_alpha[~near], before.by_alpha[~near])
    assert counted.value - after.value > 0.5 * 0.7 * 0.8 * lacking.sum()
    whole = Filmed(own.camera, truth, cover, np.zeros((H, W), bool))
    for a, b in zip(loss(more, alpha, whole), counted, strict=True):
        np.testing.assert_array_equal(a, b)
