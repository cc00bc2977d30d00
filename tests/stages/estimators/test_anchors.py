"""The detector's anchors against the values its public graph documents."""

from __future__ import annotations

import numpy as np

from posegaussian.stages.estimators.anchors import anchors


def test_there_are_2254_within_the_picture() -> None:
    a = anchors()
    assert a.shape == (2254, 2)
    assert a.dtype == np.float32
    assert ((a > 0) & (a < 1)).all()


def test_layers_stand_one_after_the_other_row_by_row() -> None:
    a = anchors()
    # stride 8: 28 x 28 cells, 2 anchors each; stride 16: 14 x 14, 2; the three layers of stride 32 share 7 x 7 cells, 6
    for first, cells, each in ((0, 28, 2), (1568, 14, 2), (1960, 7, 6)):
        layer = a[first : first + cells * cells * each].reshape(cells, cells, each, 2)
        centres = (np.arange(cells) + 0.5) / cells
        assert np.allclose(layer[..., 0], centres[None, :, None])
        assert np.allclose(layer[..., 1], centres[:, None, None])
