"""SPZ as another library reads it: every value within the rounding that the format states."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from posegaussian.storage.formats.spz import write_spz
from posegaussian.storage.model.errors import UserError
from posegaussian.storage.model.splats import Splats


def splats(n: int = 500) -> Splats:
    rng = np.random.default_rng(6)
    quaternion = rng.normal(size=(n, 4))
    return Splats(
        rng.uniform(-3, 3, (n, 3)).astype(np.float32),
        rng.uniform(-8, -3, (n, 3)).astype(np.float32),
        (quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)).astype(np.float32),
        rng.uniform(-3, 5, n).astype(np.float32),
        rng.uniform(-1.7, 1.7, (n, 1, 3)).astype(np.float32),
    )


def test_gsply_reads_the_same_gaussians(tmp_path: Path) -> None:
    gsply = pytest.importorskip("gsply", reason="gsply (extra dev) is not installed")
    ours = splats()
    write_spz(tmp_path / "a.spz", ours)
    theirs = gsply.read_spz(tmp_path / "a.spz")
    np.testing.assert_allclose(theirs.means, ours.mean, atol=0.5 * 2.0**-12 + 1e-6)
    np.testing.assert_allclose(theirs.scales, ours.log_scale, atol=1 / 32 + 1e-6)
    np.testing.assert_allclose(theirs.sh0, ours.harmonics[:, 0], atol=0.5 / (0.15 * 255) + 1e-6)
    alpha, read = (1 / (1 + np.exp(-x)) for x in (ours.opacity_logit, np.asarray(theirs.opacities).reshape(-1)))
    np.testing.assert_allclose(read, alpha, atol=0.5 / 255 + 1e-6)
    # half a step of 1/127.5 in each of x, y and z turns by under a degree, but for w near 0, which is their rest to 1
    cosine = np.abs((np.asarray(theirs.quats) * ours.quaternion).sum(axis=1))
    degrees = 2 * np.degrees(np.arccos(np.clip(cosine.astype(np.float64), 0, 1)))
    assert np.median(degrees) < 1
    assert degrees.max() < 15


def test_equal_splats_give_equal_bytes(tmp_path: Path) -> None:
    for name in ("a.spz", "b.spz"):
        write_spz(tmp_path / name, splats())
    assert (tmp_path / "a.spz").read_bytes() == (tmp_path / "b.spz").read_bytes()


@pytest.mark.parametrize("place", [3000.0, np.nan])
def test_what_the_format_cannot_hold_is_refused(tmp_path: Path, place: float) -> None:
    far = splats()
    far.mean[7, 1] = place
    with pytest.raises(UserError, match=r"Gaussian 7 lies at .* an SPZ holds up to 2048 units"):
        write_spz(tmp_path / "a.spz", far)
    assert not (tmp_path / "a.spz").exists()
