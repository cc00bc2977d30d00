"""The kernel: rows, regions, backgrounds, the previous frame, missing pictures, partitions."""

import dataclasses

import numpy as np
import pytest

from posegaussian.stages.camera_paths.paths import make_path
from posegaussian.stages.contract.declaration import resolve
from posegaussian.stages.contract.io import Block, Views
from posegaussian.stages.metrics.measures.ssim import ssim_map
from posegaussian.stages.metrics.params import MetricsParams
from posegaussian.stages.metrics.run import check, measure
from posegaussian.stages.registry import stage
from posegaussian.storage.model.cameras import CameraPath, Rig
from tests.support.memory_inputs import run_stage

F, H, W = 4, 20, 24
Row = tuple[str, int, str, str]


def world() -> tuple[Rig, Views, CameraPath, dict[str, np.ndarray]]:
    """One source and two held-out views, the second of which is smaller than the arrays."""
    k = np.repeat(np.array([[30.0, 0, 12], [0, 30, 10], [0, 0, 1]])[None], 3, axis=0)
    rig = Rig(
        ("src", "mid0", "mid1"),
        k,
        np.zeros((3, 8)),
        np.repeat(np.eye(4)[None], 3, axis=0),
        np.array([[W, H], [W, H], [W - 5, H - 3]]),
    )
    views = Views(rig.names, (0,), (1, 2))
    rng = np.random.default_rng(0)
    mask = np.zeros((F, 3, H, W), np.uint8)
    mask[:, :, 4:12, 5:15] = 255
    mask[:, :, 3, 5:15] = 100
    color = rng.integers(0, 256, (F, 3, H, W, 3), np.uint8)
    truth = color[:, 1:] * (mask[:, 1:, ..., None] / 255)
    rendered = np.clip(np.rint(truth + rng.normal(0, 6, truth.shape)), 0, 255).astype(np.uint8)
    return (
        rig,
        views,
        make_path("held_out", rig, views, np.arange(F)),
        {"frames/color": color, "frames/mask": mask, "rendering/{path}/color": rendered},
    )


def table(
    length: int = F, path: CameraPath | None = None, arrays: dict[str, np.ndarray] | None = None, **more: object
) -> dict[Row, float]:
    """Rows by key, over partitions."""
    rig, views, whole, given = world()
    path, given = path or whole, given | (arrays or {})
    rows: dict[Row, float] = {}
    from tests.support.memory_inputs import MemoryInputs

    for start in range(0, F, length):
        part = range(start, min(start + length, F))
        own = (stage("metrics"), MetricsParams(), given, rig, views, part, F)
        inputs = MemoryInputs(*own, path=path, **more)  # type: ignore[arg-type]
        for block in resolve(stage("metrics").run)(inputs, MetricsParams()):
            columns = ("camera", "frame", "region", "measure", "value")
            for *key, value in zip(*(block.data[c] for c in columns), strict=True):
                rows[tuple(key)] = value  # type: ignore[index]
    return rows


def test_every_camera_frame_region_and_measure_has_a_row() -> None:
    rows = table()
    for camera in ("mid0", "mid1"):
        for region in ("full", "box", "mask"):
            for frame in range(F):
                assert {m for c, f, r, m in rows if (c, f, r) == (camera, frame, region)} == {"psnr", "ssim"} | (
                    {"delta_ssim"} if frame else set()
                )
                if frame:
                    expected = abs(rows[camera, frame, region, "ssim"] - rows[camera, frame - 1, region, "ssim"])
                    assert rows[camera, frame, region, "delta_ssim"] == expected
    assert len(rows) == 2 * 3 * (2 * F + F - 1)


def test_columns_are_the_declared_ones() -> None:
    rig, views, path, arrays = world()
    (data,) = run_stage(stage("metrics"), MetricsParams(psnr_cap=80.0), arrays, rig, views, F, path=path)[
        "metrics/{path}"
    ]
    assert tuple(data) == tuple(name for name, _ in stage("metrics").writes[0].columns)  # type: ignore[union-attr]
    assert set(data["background"]) == {"black"}
    assert any("at most 80 dB" in d for d in data["definition"])
    assert check(Block("metrics/{path}", data), MetricsParams()) == []
    with pytest.raises(ValueError, match="psnr of camera"):
        check(
            Block("metrics/{path}", {k: v[:1] for k, v in data.items()} | {"value": [np.nan], "measure": ["psnr"]}),
            MetricsParams(),
        )


@pytest.mark.parametrize("length", [1, 2, 3])
def test_partitions_change_nothing(length: int) -> None:
    valid = np.ones((F, 3), bool)
    valid[2, 1] = False
    mask, color = world()[3]["frames/mask"], world()[3]["frames/color"]
    mask[2, 1], color[2, 1] = 0, 0  # what the frames stage writes for a missing picture
    arrays = {"frames/mask": mask, "frames/color": color}
    assert table(length) == table()
    missing = table(length, arrays=arrays, valid_all=valid)
    assert missing == table(arrays=arrays, valid_all=valid)
    assert not any(c == "mid0" and f == 2 for c, f, _, _ in missing)
    assert not any(c == "mid0" and f == 3 and m == "delta_ssim" for c, f, _, m in missing)
    assert any(c == "mid1" and f == 3 and m == "delta_ssim" for c, f, _, m in missing)


@pytest.mark.parametrize("length", [1, 3, F])
def test_unserved_frames_and_empty_masks(length: int) -> None:
    """Nor is there a change from an unserved frame, which may be the last of the partition before."""
    path = world()[2]
    served = path.served.copy()
    served[1, 0] = False
    rows = table(length, path=dataclasses.replace(path, served=served))
    assert not any(c == "mid0" and f == 1 for c, f, _, _ in rows)
    assert {f for c, f, _, m in rows if (c, m) == ("mid0", "delta_ssim")} == set(range(3, F))
    assert {f for c, f, _, m in rows if (c, m) == ("mid1", "delta_ssim")} == set(range(1, F))
    mask = world()[3]["frames/mask"]
    mask[0, 1] = 90
    rows = table(arrays={"frames/mask": mask})
    assert not any(c == "mid0" and f == 0 for c, f, _, _ in rows), "nobody is in it: there is nothing to measure"
    assert ("mid0", 1, "full", "psnr") in rows
    assert not any(c == "mid0" and f == 1 and m == "delta_ssim" for c, f, _, m in rows)
    assert ("mid1", 1, "full", "delta_ssim") in rows
    assert all(np.isfinite(v) for v in rows.values())


def test_padding_is_cropped_away() -> None:
    rendered = world()[3]["rendering/{path}/color"]
    rendered[:, 1, H - 3 :] = 200
    rendered[:, 1, :, W - 5 :] = 200
    assert table(arrays={"rendering/{path}/color": rendered}) == table()


def test_the_background_of_the_truth_carries_no_error() -> None:
    _, _, _, arrays = world()
    mask, color = arrays["frames/mask"][0, 1], arrays["frames/color"][0, 1]
    other = np.where(mask[..., None] == 0, 255 - color, color)
    rendered = arrays["rendering/{path}/color"][0, 0]
    assert measure(rendered, color, mask, MetricsParams()) == measure(rendered, other, mask, MetricsParams())
    perfect = color * (mask[..., None] / 255)
    assert measure(perfect, color, mask, MetricsParams()) == {
        (r, m): pytest.approx(v) for r in ("full", "box", "mask") for m, v in (("psnr", 100.0), ("ssim", 1.0))
    }


def test_a_mask_counts_its_own_pixels_alone() -> None:
    """What is wrong beyond the mask changes full and box, never the mask's PSNR; a map is averaged over its pixels."""
    random = np.random.default_rng(2)
    truth = random.integers(0, 256, (40, 40, 3), np.uint8)
    mask = np.zeros((40, 40), np.uint8)
    mask[5:30, 5:30] = 255 * np.tri(25, dtype=np.uint8)
    inside = mask > 127
    noisy = np.clip(truth + random.normal(0, 9, truth.shape), 0, 255)
    rendered = np.where(inside[..., None], noisy, 0).astype(np.uint8)
    beyond = np.where(inside[..., None], rendered, 90).astype(np.uint8)
    params = MetricsParams(measures=["psnr", "ssim"])
    good, bad = (measure(r, truth, mask, params) for r in (rendered, beyond))
    assert good["mask", "psnr"] == bad["mask", "psnr"]
    assert good["box", "psnr"] > bad["box", "psnr"]
    assert good["mask", "psnr"] < good["box", "psnr"] < good["full", "psnr"]
    reference = truth * inside[..., None].astype(np.float64)
    error = ((rendered - reference) ** 2)[inside].mean()
    assert good["mask", "psnr"] == pytest.approx(10 * np.log10(255**2 / error), rel=1e-12)
    ssim = ssim_map(rendered.astype(np.float64), reference, 255.0)
    assert good["mask", "ssim"] == pytest.approx(ssim[inside].mean(), rel=1e-12)
    assert bad["mask", "ssim"] < good["mask", "ssim"], "windows that reach beyond the mask see what is there"


def test_frames_that_nobody_is_in_are_told() -> None:
    """Black equals black: a person who left the picture is no perfect picture."""
    rig, views, path, arrays = world()
    arrays["frames/mask"][1, 1] = 0
    from tests.support.memory_inputs import MemoryInputs

    inputs = MemoryInputs(stage("metrics"), MetricsParams(), arrays, rig, views, range(F), F, path=path)
    (block,) = resolve(stage("metrics").run)(inputs, MetricsParams())
    assert block.notes == (f"mid0: nobody is in 1 of {F} frames by its mask; they are not measured",)
    rows = list(zip(*(block.data[k] for k in ("camera", "frame", "measure")), strict=True))
    assert not [r for r in rows if r[:2] == ("mid0", 1)]
    assert [f for c, f, m in rows if c == "mid0" and m == "delta_ssim"] == [3] * 3, "neither to it nor from it"
