"""Compares pictures with ones that gsplat rendered, under gsplat's own constants."""

import numpy as np
import pytest
import torch

from posegaussian.stages.splatting.definition.scene import Backend
from tests.support.gaussian_scenes import draw
from tests.support.gsplat_reference import CASES, GSPLAT, reference_case


# gsplat's float32 sums differ from float64 by up to a few 1e-6 on values near 1, and ours by as much again
@pytest.mark.parametrize(
    ("backend", "dtype", "bound"), [("reference", torch.float64, 5e-6), ("cpu", torch.float32, 1e-5)]
)
@pytest.mark.parametrize("name", CASES)
def test_same_picture_as_gsplat(name: str, backend: Backend, dtype: torch.dtype, bound: float) -> None:
    case = reference_case(name)
    out = draw(case.gaussians(dtype), case.camera, GSPLAT, backend)
    picture = torch.cat([out.color, out.alpha[..., None]], dim=2).numpy()
    assert picture.shape == case.picture.shape
    assert np.abs(picture - case.picture).max() < bound
    assert case.picture[..., 3].max() > 0.5  # something is seen
