"""LPIPS: our stacks with made weights against a plain numpy implementation; files, hashes and what is wrong with them.

Official weights are not shipped. Where POSEGAUSSIAN_LPIPS names a folder with vgg16-397923af.pth and vgg.pth, the
published value of a pair of pictures is compared, too.
"""

import hashlib
import os
from pathlib import Path

import numpy as np
import pytest
import torch

from posegaussian.stages.metrics.measures.lpips_network import ALEX, STACKS, VGG, Stack
from posegaussian.stages.metrics.measures.lpips_weights import load_network
from posegaussian.storage.model.errors import SourceError

FOLDER = Path(os.environ.get("POSEGAUSSIAN_CAPTURES", "../shared")) / "reference" / "lpips"


def made_weights(stack: Stack, seed: int = 0) -> tuple[dict[str, torch.Tensor], dict[str, torch.Tensor]]:
    """State dicts of the official layout; the kernels keep the size of what goes through."""
    rng = np.random.default_rng(seed)
    trunk = {"classifier.6.bias": torch.zeros(1000)}
    for c in stack.layers:
        kernel = rng.normal(0, np.sqrt(2 / (c.channels[0] * c.size**2)), (c.channels[1], c.channels[0], c.size, c.size))
        trunk[f"{c.key}.weight"], trunk[f"{c.key}.bias"] = (
            torch.tensor(a, dtype=torch.float32) for a in (kernel, rng.normal(0, 0.1, c.channels[1]))
        )
    heads = {
        f"lin{i}.model.1.weight": torch.tensor(rng.uniform(0, 1, (1, n, 1, 1)), dtype=torch.float32)
        for i, n in enumerate(stack.widths)
    }
    return trunk, heads


def saved(folder: Path, trunk: object, heads: object) -> tuple[str, str, str, str]:
    """Arguments of `load_network` after the measure."""
    found: list[str] = []
    for name, state in (("trunk.pth", trunk), ("heads.pth", heads)):
        torch.save(state, folder / name)
        found += [str(folder / name), hashlib.sha256((folder / name).read_bytes()).hexdigest()]
    return tuple(found)  # type: ignore[return-value]


def convolved(x: np.ndarray, kernel: np.ndarray, bias: np.ndarray, stride: int, padding: int) -> np.ndarray:
    """[O, h, w] cross-correlation of [C, h, w], zeros around it."""
    k = kernel.shape[2]
    windows = np.lib.stride_tricks.sliding_window_view(
        np.pad(x, ((0, 0), (padding, padding), (padding, padding))), (k, k), axis=(1, 2)
    )[:, ::stride, ::stride]
    return np.tensordot(kernel, windows, axes=([1, 2, 3], [0, 3, 4])) + bias[:, None, None]


def pooled(x: np.ndarray, size: int) -> np.ndarray:
    return np.lib.stride_tricks.sliding_window_view(x, (size, size), axis=(1, 2))[:, ::2, ::2].max(axis=(3, 4))


PLANS = {
    "lpips_alex": [
        ("c", 0, 4, 2, True),
        ("p", 3),
        ("c", 3, 1, 2, True),
        ("p", 3),
        ("c", 6, 1, 1, True),
        ("c", 8, 1, 1, True),
        ("c", 10, 1, 1, True),
    ],
    "lpips_vgg": [
        *(("c", 0, 1, 1, False), ("c", 2, 1, 1, True), ("p", 2), ("c", 5, 1, 1, False), ("c", 7, 1, 1, True), ("p", 2)),
        *(
            ("c", 10, 1, 1, False),
            ("c", 12, 1, 1, False),
            ("c", 14, 1, 1, True),
            ("p", 2),
            ("c", 17, 1, 1, False),
            ("c", 19, 1, 1, False),
            ("c", 21, 1, 1, True),
        ),
        *(("p", 2), ("c", 24, 1, 1, False), ("c", 26, 1, 1, False), ("c", 28, 1, 1, True)),
    ],
}
"""The two networks once more, written from torchvision's:
convolutions (number, stride, padding, compared) and maxima (size)."""


def by_hand(
    measure: str, a: np.ndarray, b: np.ndarray, trunk: dict[str, torch.Tensor], heads: dict[str, torch.Tensor]
) -> float:
    """LPIPS in float64 with numpy alone."""
    x, y = (
        ((p / 255 * 2 - 1 - np.array([-0.030, -0.088, -0.188])) / np.array([0.458, 0.448, 0.450])).transpose(2, 0, 1)
        for p in (a, b)
    )
    total, head = 0.0, 0
    for kind, *rest in PLANS[measure]:
        if kind == "p":
            x, y = pooled(x, rest[0]), pooled(y, rest[0])
            continue
        number, stride, padding, compared = rest
        kernel, bias = (trunk[f"features.{number}.{n}"].numpy().astype(np.float64) for n in ("weight", "bias"))
        x, y = (np.maximum(convolved(p, kernel, bias, stride, padding), 0) for p in (x, y))
        if compared:
            unit = [p / (np.sqrt((p**2).sum(axis=0)) + 1e-10) for p in (x, y)]
            total += (
                (heads[f"lin{head}.model.1.weight"].numpy().reshape(-1, 1, 1) * (unit[0] - unit[1]) ** 2)
                .sum(axis=0)
                .mean()
            )
            head += 1
    assert head == 5
    return float(total)


@pytest.fixture(scope="module", params=["lpips_alex", "lpips_vgg"])
def network(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory):
    trunk, heads = made_weights(STACKS[request.param])
    files = saved(tmp_path_factory.mktemp(request.param), trunk, heads)
    return request.param, load_network(request.param, *files), trunk, heads


def pictures(h: int, w: int) -> np.ndarray:
    return np.random.default_rng(1).uniform(0, 255, (2, h, w, 3))


@pytest.mark.parametrize("shape", [(31, 31), (37, 50)])
def test_the_arithmetic_is_that_of_plain_numpy(network, shape: tuple[int, int]) -> None:
    measure, net, trunk, heads = network
    a, b = pictures(*shape)
    expected = by_hand(measure, a, b, trunk, heads)
    assert expected > 0.1
    assert net.distance(a, b, 255.0) == pytest.approx(expected, rel=2e-5)  # float32 through up to 13 layers


def test_equal_pictures_are_at_no_distance_and_order_does_not_matter(network) -> None:
    _, net, _, _ = network
    a, b = pictures(40, 33)
    assert net.distance(a, a, 255.0) == 0
    assert net.distance(a, b, 255.0) == pytest.approx(net.distance(b, a, 255.0), rel=1e-6)
    assert net.distance(a / 255, b / 255, 1.0) == pytest.approx(net.distance(a, b, 255.0), rel=1e-6)
    assert 0 < net.distance(a, 0.9 * a + 0.1 * b, 255.0) < net.distance(a, b, 255.0)


def test_black_pictures_and_dead_features_give_no_nan(network) -> None:
    _, net, _, _ = network
    black = np.zeros((32, 32, 3))
    assert net.distance(black, black, 255.0) == 0
    assert np.isfinite(net.distance(black, pictures(32, 32)[0], 255.0))


def test_the_smallest_picture_has_a_pixel_in_every_layer(network) -> None:
    _, net, _, _ = network
    n = net.stack.smallest
    a, b = pictures(n, n)
    assert np.isfinite(net.distance(a, b, 255.0))
    with pytest.raises(ValueError, match=f"{n} px or more"):
        net.distance(a[1:], b[1:], 255.0)
    with pytest.raises(ValueError, match="equal shape"):
        net.distance(pictures(40, 40)[0], pictures(41, 40)[1], 255.0)
    with pytest.raises(ValueError, match="NaN"):
        net.distance(a + np.nan, b, 255.0)


def test_threads_change_nothing(network) -> None:
    _, net, _, _ = network
    a, b = pictures(96, 80)
    before = torch.get_num_threads()
    try:
        found = []
        for threads in (1, 2):
            torch.set_num_threads(threads)
            found.append(net.distance(a, b, 255.0))
    finally:
        torch.set_num_threads(before)
    assert found[0] == found[1]


def test_the_published_parameter_counts() -> None:
    """Of the convolutions: 2,469,696 in AlexNet and 14,714,688 in VGG16."""
    for stack, count in ((ALEX, 2_469_696), (VGG, 14_714_688)):
        assert sum(c.channels[0] * c.channels[1] * c.size**2 + c.channels[1] for c in stack.layers) == count
    assert ALEX.widths == (64, 192, 384, 256, 256)
    assert VGG.widths == (64, 128, 256, 512, 512)


def test_files_that_are_not_what_was_meant_are_named(tmp_path: Path) -> None:
    trunk, heads = made_weights(ALEX)
    path, sha, other, other_sha = saved(tmp_path, trunk, heads)
    for arguments, words in (
        ((path + "x", sha, other, other_sha), "no file"),
        ((path, "0" * 64, other, other_sha), f"has sha256 {sha}"),
        ((other, other_sha, other, other_sha), "features.0.weight is not there; the file has lin0"),
    ):
        with pytest.raises(SourceError, match=words):
            load_network("lpips_alex", *arguments)
    with pytest.raises(SourceError, match="shape"):
        load_network("lpips_vgg", path, sha, other, other_sha)
    junk = tmp_path / "junk.pth"
    junk.write_bytes(b"no weights at all")
    with pytest.raises(SourceError, match="cannot be read as PyTorch weights"):
        load_network("lpips_alex", str(junk), hashlib.sha256(junk.read_bytes()).hexdigest(), other, other_sha)
    with pytest.raises(SourceError, match="holds a list"):
        load_network("lpips_alex", *saved(tmp_path, [1], heads))
    trunk["features.3.bias"][0] = torch.nan
    with pytest.raises(SourceError, match=r"features\.3\.bias holds values that are not finite"):
        load_network("lpips_alex", *saved(tmp_path, trunk, heads))


def test_official_weights_give_the_published_value() -> None:
    folder = os.environ.get("POSEGAUSSIAN_LPIPS")
    if folder is None or not (FOLDER / "apple.png").exists():
        pytest.skip(
            "POSEGAUSSIAN_LPIPS names no folder with vgg16-397923af.pth and vgg.pth,"
            " or the pair of pictures is not here"
        )
    import cv2

    files = [
        part
        for name in ("vgg16-397923af.pth", "vgg.pth")
        for part in (str(Path(folder) / name), hashlib.sha256((Path(folder) / name).read_bytes()).hexdigest())
    ]
    a, b = (cv2.imread(str(FOLDER / n))[..., ::-1].astype(np.float64) for n in ("apple.png", "pear.png"))
    assert load_network("lpips_vgg", *files).distance(a, b, 255.0) == pytest.approx(0.6571019887924194, abs=1e-4)
