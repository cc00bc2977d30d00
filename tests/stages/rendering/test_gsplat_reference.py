"""Compares pictures with ones that gsplat rendered, under gsplat's own constants: eps2d 0.3, alpha cap 0.999, no early stop."""

import json
import os
from pathlib import Path

import numpy as np
import pytest
import torch

from stages.rendering.params import Backend
from stages.rendering.scene import Camera, Cutoffs, Gaussians
from tests.stages.rendering.scenes import draw

FOLDER = Path(os.environ.get("POSEGAUSSIAN_CAPTURES", "../shared")) / "reference" / "gsplat_render"
GSPLAT = Cutoffs(low_pass=0.3, alpha_max=0.999, transmittance_stop=0.0)


def read_safetensors(path: Path) -> dict[str, np.ndarray]:
    raw = path.read_bytes()
    size = int.from_bytes(raw[:8], "little")
    header = json.loads(raw[8 : 8 + size])
    header.pop("__metadata__", None)
    return {k: np.frombuffer(raw[8 + size :], np.float32, int(np.prod(v["shape"])), v["data_offsets"][0]).reshape(v["shape"]) for k, v in header.items()}


def rotations(quats: np.ndarray) -> np.ndarray:
    w, x, y, z = (quats / np.linalg.norm(quats, axis=1, keepdims=True)).T
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, axis=1) for row in rows], axis=1)


def harmonics(d: np.ndarray) -> np.ndarray:
    """[N, 16] real spherical harmonics to degree 3 in the order and with the signs of 3DGS."""
    x, y, z = d.T
    xx, yy, zz = x * x, y * y, z * z
    bands = (
        (np.full_like(x, 0.28209479177387814), -0.4886025119029199 * y, 0.4886025119029199 * z, -0.4886025119029199 * x),
        (1.0925484305920792 * x * y, -1.0925484305920792 * y * z, 0.31539156525252005 * (2 * zz - xx - yy), -1.0925484305920792 * x * z),
        (0.5462742152960396 * (xx - yy), -0.5900435899266435 * y * (3 * xx - yy), 2.890611442640554 * x * y * z),
        (-0.4570457994644658 * y * (4 * zz - xx - yy), 0.3731763325901154 * z * (2 * zz - 3 * xx - 3 * yy), -0.4570457994644658 * x * (4 * zz - xx - yy)),
        (1.445305721320277 * z * (xx - yy), -0.5900435899266435 * x * (xx - 3 * yy)),
    )
    return np.concatenate([np.stack(band, axis=1) for band in bands], axis=1)


@pytest.mark.parametrize(("backend", "dtype", "bound"), [("reference", torch.float64, 5e-6), ("cpu", torch.float32, 1e-5)])
@pytest.mark.parametrize("case", ["tiny_case", "basic_case"])
def test_same_picture_as_gsplat(case: str, backend: Backend, dtype: torch.dtype, bound: float) -> None:
    path = FOLDER / f"{case}.safetensors"
    if not path.exists():
        pytest.skip(f"{path} is not here; set POSEGAUSSIAN_CAPTURES to the folder that holds reference/")
    data = {k: v.astype(np.float64) for k, v in read_safetensors(path).items()}
    h, w = data["out_img"].shape[:2]
    eye = np.array([0.123, 0.456, -8.0])
    pose = np.eye(4)
    pose[:3, 3] = -eye
    camera = Camera(np.array([[61.5, 0, w / 2], [0, 61.5, h / 2], [0, 0, 1]]), pose, w, h)
    toward = data["means"] - eye
    basis = harmonics(toward / np.linalg.norm(toward, axis=1, keepdims=True))
    color = np.maximum(np.einsum("nk,nkc->nc", basis, data["coeffs"]) + 0.5, 0)
    opacity = 1 / (1 + np.exp(-data["opacities"]))
    parts = (data["means"], rotations(data["quats"]), np.exp(data["scales"]), opacity, color)
    out = draw(Gaussians(*(torch.from_numpy(p).to(dtype) for p in parts)), camera, GSPLAT, backend)
    picture = torch.cat([out.color, out.alpha[..., None]], dim=2).numpy()
    # gsplat's float32 sums differ from float64 by up to a few 1e-6 on values near 1, and ours by as much again
    assert np.abs(picture - data["out_img"]).max() < bound
