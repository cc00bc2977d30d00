"""Things that are no person are seen alike by all cameras, and teach nothing but doubt."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from posegaussian.stages.geometry.projection import project, unproject
from posegaussian.stages.training.examples import crop, crop_of_thing, exchanged
from posegaussian.stages.training.loss import beats, together
from posegaussian.stages.training.things import thing
from tests.support.network_views import network
from tests.support.training_examples import ball, tiny

FRAME = ball()


@pytest.mark.parametrize("seed", range(6))
def test_the_surface_of_a_thing_seen_by_one_camera_is_seen_by_the_other(seed: int) -> None:
    """Boxes, balls and walls are convex: what faces both cameras lies at the same place for both."""
    found = thing(FRAME, (0, 1, 2), np.zeros(3), np.random.default_rng(seed))
    assert {k: v.shape for k, v in found.items()} == {
        "color": (3, 64, 64, 3),
        "mask": (3, 64, 64),
        "truth": (2, 64, 64),
        "depth": (2, 64, 64),
        "hull": (2, 64, 64),
        "confidence": (2, 64, 64),
        "joints": (3, 2, 17, 3),
        "intrinsics": (3, 3, 3),
        "world_to_camera": (3, 4, 4),
        "pairs": (1, 3),
    }
    truth = found["truth"]
    assert (truth[0] > 0).any()
    np.testing.assert_array_equal(found["depth"] > 0, truth > 0)
    np.testing.assert_array_equal(found["mask"][:2] > 0, truth > 0)
    points = unproject(truth[0], found["intrinsics"][0], found["world_to_camera"][0])[truth[0] > 0]
    pixels, depth = project(points, found["intrinsics"][1], found["world_to_camera"][1])
    columns, rows = np.floor(pixels).astype(int).T
    inside = (columns >= 0) & (columns < 64) & (rows >= 0) & (rows < 64)
    other = truth[1][np.clip(rows, 0, 63), np.clip(columns, 0, 63)]
    # nothing of it lies before what the other camera sees, by more than a pixel of a steep face
    assert np.quantile((other - depth)[inside & (other > 0)], 0.98) < 0.1


def test_nothing_is_asked_of_a_thing_but_doubt() -> None:
    config = tiny(strange=1.0)
    found = [crop(FRAME, config, np.random.default_rng(seed)) for seed in range(12)]
    assert {e.strange for e in found} == {True, False}, "somebody else's pictures come later"
    shown = crop_of_thing(FRAME, 0, config)
    assert shown.strange
    batch = together([shown], torch.device("cpu"))
    with torch.no_grad():
        assert not beats(network()(batch.views, 1), batch).any()


def test_somebody_elses_picture_fills_ones_own_outline() -> None:
    config = tiny(batch=3)
    own = [crop(FRAME, config, np.random.default_rng(seed)) for seed in range(3)]
    found = exchanged(own, 1.0, np.random.default_rng(0))
    assert all(e.strange for e in found)
    for before, after in zip(own, found, strict=True):
        assert torch.equal(before.views.start.nan_to_num(), after.views.start.nan_to_num())
        assert not torch.equal(before.views.color[1], after.views.color[1])
        assert not (after.views.color[1] * (after.views.cover[1] == 0)).any()
    kept = [
        torch.equal(e.views.color[0], own[0].views.color[0])
        for e in (exchanged(own, 1.0, np.random.default_rng(seed))[0] for seed in range(12))
    ]
    assert 0 < sum(kept) < 12, "the first picture is one's own or somebody else's"
    assert exchanged(own, 0.0, np.random.default_rng(0)) == own
    assert exchanged(own[:1], 1.0, np.random.default_rng(0)) == own[:1], "there is nobody else"
