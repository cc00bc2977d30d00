"""Two pictures of one frame become one: what holds whatever the pictures are."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from posegaussian.stages.rendering.frame import Picture, mixed
from posegaussian.stages.rendering.sources import NEAR, faded_in


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
    color, cover = mixed((a, alpha), (b, behind), 0.3, 1.0)
    torch.testing.assert_close(color, 0.3 * b + 0.7 * a)
    torch.testing.assert_close(cover, 0.3 * behind + 0.7 * alpha)


def test_where_it_has_not_it_lies_behind_the_other() -> None:
    (a, alpha), (b, behind) = picture(0), picture(1)
    color, cover = mixed((a, alpha), (b, behind), 0.6, 0.0)
    torch.testing.assert_close(color, a + (1 - alpha)[..., None] * b)
    torch.testing.assert_close(cover, 1 - (1 - alpha) * (1 - behind))
    opaque = torch.ones_like(alpha)
    torch.testing.assert_close(mixed((a, opaque), (b, behind), 0.6, 0.0), (a, opaque))


@pytest.mark.parametrize("fade", [0.0, 0.4, 1.0])
def test_it_stays_a_picture_and_mixing_one_with_itself_where_it_is_opaque_changes_nothing(fade: float) -> None:
    color, alpha = mixed(picture(0), picture(1), 0.6, fade)
    assert (alpha <= 1 + 1e-6).all()
    assert (color <= alpha[..., None] + 1e-6).all()
    assert (color >= 0).all()
    one = picture(2)[0], torch.ones((5, 7))
    torch.testing.assert_close(mixed(one, one, 0.6, fade), one)
