"""Pictures that gsplat rendered, with all that is needed to render them again: `reference/gsplat_render` of the shared
folder.

Each case is a safetensors file of float32 arrays: `means` [N, 3] in the world, `scales` [N, 3] natural logarithms of
standard deviations, `quats` [N, 4] (w, x, y, z) not normalised, `coeffs` [N, 16, 3] spherical harmonics of degree 3,
`opacities` [N] logits, and `out_img` [82, 123, 4]: RGB premultiplied on black, and coverage. Colour is max(sum Y_k c_k
+ 0.5, 0) for the direction from the camera to the mean. The camera sees 90 degrees across without rotation, principal
point in the middle.
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import torch

from posegaussian.stages.splatting.definition.scene import Camera, Cutoffs, Gaussians

FOLDER = Path(os.environ.get("POSEGAUSSIAN_CAPTURES", "../shared")) / "reference" / "gsplat_render"
CASES = ("tiny_case", "basic_case")
GSPLAT = Cutoffs(
    near=0.01,
    frustum_margin=0.3,
    low_pass=0.3,
    variance_min=0.0,
    alpha_min=1 / 255,
    alpha_max=0.999,
    transmittance_stop=0.0,
)
"""gsplat's own constants: eps2d 0.3, alpha cap 0.999, and nothing left out behind what is opaque."""
EYE = np.array([0.123, 0.456, -8.0])
"""Centre of the camera, in the world."""


@dataclass(frozen=True, eq=False)
class RenderedCase:
    """One scene, its camera and the picture gsplat made of it. float64 throughout."""

    mean: np.ndarray  # [N, 3]
    rotation: np.ndarray  # [N, 3, 3]
    scale: np.ndarray  # [N, 3]
    opacity: np.ndarray  # [N]
    color: np.ndarray  # [N, 3]
    camera: Camera
    picture: np.ndarray  # [h, w, 4]

    def gaussians(self, dtype: torch.dtype = torch.float64) -> Gaussians:
        """The scene as `rasterize` takes it."""
        return Gaussians(
            *(torch.from_numpy(p).to(dtype) for p in (self.mean, self.rotation, self.scale, self.opacity, self.color))
        )


def reference_case(name: str) -> RenderedCase:
    """Read one of `CASES`; skips the test that asks where the folder is missing."""
    path = FOLDER / f"{name}.safetensors"
    if not path.exists():
        pytest.skip(f"{path} is not here; set POSEGAUSSIAN_CAPTURES to the folder that holds reference/")
    data = {k: v.astype(np.float64) for k, v in read_safetensors(path).items()}
    h, w = data["out_img"].shape[:2]
    pose = np.eye(4)
    pose[:3, 3] = -EYE
    camera = Camera(np.array([[w / 2, 0, w / 2], [0, w / 2, h / 2], [0, 0, 1]]), pose, w, h)
    toward = data["means"] - EYE
    basis = harmonics(toward / np.linalg.norm(toward, axis=1, keepdims=True))
    color = np.maximum(np.einsum("nk,nkc->nc", basis, data["coeffs"]) + 0.5, 0)
    return RenderedCase(
        data["means"],
        rotations(data["quats"]),
        np.exp(data["scales"]),
        1 / (1 + np.exp(-data["opacities"])),
        color,
        camera,
        data["out_img"],
    )


def read_safetensors(path: Path) -> dict[str, np.ndarray]:
    """{name: float32 array}: eight bytes of length, a JSON header of shapes and offsets, the bytes."""
    raw = path.read_bytes()
    size = int.from_bytes(raw[:8], "little")
    header = json.loads(raw[8 : 8 + size])
    header.pop("__metadata__", None)
    assert {v["dtype"] for v in header.values()} == {"F32"}
    return {
        k: (
            np.frombuffer(raw[8 + size :], np.float32, int(np.prod(v["shape"])), v["data_offsets"][0]).reshape(
                v["shape"]
            )
        )
        for k, v in header.items()
    }


def rotations(quats: np.ndarray) -> np.ndarray:
    """[N, 3, 3] of quaternions (w, x, y, z) of any length."""
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
        (
            np.full_like(x, 0.28209479177387814),
            -0.4886025119029199 * y,
            0.4886025119029199 * z,
            -0.4886025119029199 * x,
        ),
        (
            1.0925484305920792 * x * y,
            -1.0925484305920792 * y * z,
            0.31539156525252005 * (2 * zz - xx - yy),
            -1.0925484305920792 * x * z,
        ),
        (0.5462742152960396 * (xx - yy), -0.5900435899266435 * y * (3 * xx - yy), 2.890611442640554 * x * y * z),
        (
            -0.4570457994644658 * y * (4 * zz - xx - yy),
            0.3731763325901154 * z * (2 * zz - 3 * xx - 3 * yy),
            -0.4570457994644658 * x * (4 * zz - xx - yy),
        ),
        (1.445305721320277 * z * (xx - yy), -0.5900435899266435 * x * (xx - 3 * yy)),
    )
    return np.concatenate([np.stack(band, axis=1) for band in bands], axis=1)
