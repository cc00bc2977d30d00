"""Two pictures of one frame become one: what holds whatever the pictures are."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from posegaussian.stages.rendering.frame import Picture, mixed
from posegaussian.stages.rendering.sources import CLOSE, NEAR, faded_in, outlines_refined


def picture(seed: int) -> Picture:
    made = torch.Generator().manual_seed(seed)
    alpha = torch.rand((5, 7), generator=made)
    return torch.rand((5, 7, 3), generator=made) * alpha[..., None], alpha


def between(far: float) -> np.ndarray:
    """Angles from four views a quarter turn apart, `far` of the way from the first to the second."""
    at = far * np.pi / 2
    return np.array([at, np.pi / 2 - at, np.pi - at, np.pi / 2 + at])


def test_it_fades_in_from_a_source_camera_on_and_moves_without_a_jump() -> None:
    assert faded_in(between(0.0)) == 0
    assert faded_in(between(1.0)) == pytest.approx(0)
    assert faded_in(between(NEAR / 2)) == pytest.approx(0.5)
    assert faded_in(between(NEAR)) == faded_in(between(0.5)) == 1
    steps = np.array([faded_in(between(f)) for f in np.linspace(0, 1, 1001)])
    assert np.abs(np.diff(steps)).max() <= 1.01 * 0.001 / NEAR, "no faster than its slope"


def test_one_view_or_views_in_one_place_leave_nothing_to_fade() -> None:
    assert faded_in(np.array([0.3])) == faded_in(np.array([0.0, 0.0, 1.0])) == 1


def test_where_it_has_faded_in_it_is_the_mean_by_shares() -> None:
    (a, alpha), (b, behind) = picture(0), picture(1)
    color, cover = mixed((a, alpha), (b, behind), 0.3, 1.0, 0.0)
    torch.testing.assert_close(color, 0.3 * b + 0.7 * a)
    torch.testing.assert_close(cover, 0.3 * behind + 0.7 * alpha)


def test_where_it_has_not_it_lies_behind_the_other() -> None:
    (a, alpha), (b, behind) = picture(0), picture(1)
    color, cover = mixed((a, alpha), (b, behind), 0.6, 0.0, 0.0)
    torch.testing.assert_close(color, a + (1 - alpha)[..., None] * b)
    torch.testing.assert_close(cover, 1 - (1 - alpha) * (1 - behind))
    opaque = torch.ones_like(alpha)
    torch.testing.assert_close(mixed((a, opaque), (b, behind), 0.6, 0.0, 0.0), (a, opaque))


def test_outlines_are_the_refined_pictures_and_what_is_opaque_in_both_is_the_mean() -> None:
    (a, alpha), (b, behind) = picture(0), picture(1)
    for see_through in (0, 1):  # in either of the two
        alphas = [alpha.clone(), behind.clone()]
        alphas[see_through][0, 0] = 0
        colors = [c * (w > 0)[..., None] for c, w in zip((a, b), alphas, strict=True)]
        color, cover = mixed((colors[0], alphas[0]), (colors[1], alphas[1]), 0.3, 1.0, 1.0)
        torch.testing.assert_close((color[0, 0], cover[0, 0]), (colors[1][0, 0], alphas[1][0, 0]))
    opaque = torch.ones_like(alpha)
    torch.testing.assert_close(mixed((a, opaque), (b, opaque), 0.3, 1.0, 1.0)[0], 0.3 * b + 0.7 * a)


def test_outlines_are_refined_between_close_cameras_that_the_judge_trusts_alone() -> None:
    def ring(count: int, far: float) -> np.ndarray:
        at = (far + np.arange(count)) * 2 * np.pi / count
        return np.minimum(at, 2 * np.pi - at)

    assert outlines_refined(ring(16, 0.5), 0.8) == 1
    assert outlines_refined(ring(16, 0.2), 0.8) == 1, "the same all the way between them"
    assert outlines_refined(ring(16, 0.0), 0.8) == 0, "a source camera has an outline of its own"
    assert outlines_refined(ring(16, NEAR / 2), 0.8) == pytest.approx(0.5)
    assert outlines_refined(ring(8, 0.5), 0.8) == 0
    assert outlines_refined(ring(16, 0.5), 0.5) == 0
    assert outlines_refined(np.array([0.1]), 0.8) == 0, "one camera tells of no other"
    steps = [outlines_refined(np.radians([g / 2, g / 2]), s) for g in np.linspace(20, 50, 601) for s in (0.6, 0.9)]
    assert np.abs(np.diff(steps[::2])).max() <= 0.51 * 0.05 / np.ptp(CLOSE)
    assert np.all(np.diff(steps[1::2]) <= 0)


@pytest.mark.parametrize("outlines", [0.0, 1.0])
@pytest.mark.parametrize("fade", [0.0, 0.4, 1.0])
def test_it_stays_a_picture_and_mixing_one_with_itself_where_it_is_opaque_changes_nothing(
    fade: float, outlines: float
) -> None:
    color, alpha = mixed(picture(0), picture(1), 0.6, fade, outlines)
    assert (alpha <= 1 + 1e-6).all()
    assert (color <= alpha[..., None] + 1e-6).all()
    assert (color >= 0).all()
    one = picture(2)[0], torch.ones((5, 7))
    torch.testing.assert_close(mixed(one, one, 0.6, fade, outlines), one)
