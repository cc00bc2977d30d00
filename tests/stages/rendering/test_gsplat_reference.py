"""Compares pictures with ones that gsplat rendered, under gsplat's own constants."""

import numpy as np
import pytest
import torch

from stages.rendering.rasterizer import rasterize
from tests.stages.rendering.reference_render import CASES, GSPLAT, reference_case


# both differ by the rounding of float32 sums near 1, a few 1e-6
@pytest.mark.parametrize("dtype", [torch.float64, torch.float32], ids=str)
@pytest.mark.parametrize("name", CASES)
def test_same_picture_as_gsplat(name: str, dtype: torch.dtype) -> None:
    case = reference_case(name)
    out = rasterize(case.gaussians(dtype), case.camera, GSPLAT)
    picture = torch.cat([out.color, out.alpha[..., None]], dim=2).numpy()
    assert picture.shape == case.picture.shape
    assert np.abs(picture - case.picture).max() < 5e-6
    assert case.picture[..., 3].max() > 0.5  # something is seen
