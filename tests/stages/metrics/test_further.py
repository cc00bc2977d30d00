"""Measures that are asked for: which run, over which regions, what they say where something is missing."""

import hashlib
import sys
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from posegaussian.stages.contract.facts import Facts
from posegaussian.stages.contract.io import Block
from posegaussian.stages.metrics.measures import flip
from posegaussian.stages.metrics.measures.declaration import Unavailable
from posegaussian.stages.metrics.measures.lpips_network import ALEX
from posegaussian.stages.metrics.measures.lpips_weights import load_network
from posegaussian.stages.metrics.measures.ms_ssim import ms_ssim
from posegaussian.stages.metrics.measures.registry import METRICS as MEASURES
from posegaussian.stages.metrics.params import MetricsParams
from posegaussian.stages.metrics.run import UNAVAILABLE, check, measure
from posegaussian.stages.registry import stage
from tests.stages.metrics.test_lpips import made_weights, saved
from tests.stages.metrics.test_run import F, world
from tests.support.memory_inputs import run_stage
from tests.test_conformance import SHAPE

METRICS = stage("metrics")
BOX = (slice(10, 190), slice(20, 190))


def scene() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rendered, truth, mask: 200 x 210, the box just large enough for MS-SSIM."""
    rng = np.random.default_rng(0)
    truth = rng.integers(0, 256, (200, 210, 3), np.uint8)
    mask = np.zeros((200, 210), np.uint8)
    mask[BOX] = 255
    rendered = np.clip(truth * (mask[..., None] / 255) + rng.normal(0, 9, truth.shape), 0, 255).astype(np.uint8)
    return rendered, truth, mask


def table(params: MetricsParams) -> dict[str, list]:
    rig, views, path, arrays = world()
    (data,) = run_stage(METRICS, params, arrays, rig, views, F, path=path)["metrics/{path}"]
    return data


@pytest.mark.parametrize("names", [["psnr"], ["ssim"], ["delta_ssim"], ["delta_ssim", "psnr"]])
def test_what_is_not_asked_for_is_not_there_and_the_rest_is_unchanged(names: list[str]) -> None:
    data, every = table(MetricsParams(measures=names)), table(MetricsParams())
    kept = [i for i, m in enumerate(every["measure"]) if m in names]
    assert data == {column: [values[i] for i in kept] for column, values in every.items()}
    assert set(data["measure"]) == set(names)


def test_nothing_is_computed_that_was_not_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("posegaussian.stages.metrics.measures.ssim.ssim_map", None)
    for module in (
        "posegaussian.stages.metrics.measures.lpips_network",
        "posegaussian.stages.metrics.measures.lpips_weights",
        "flip_evaluator",
    ):
        monkeypatch.setitem(sys.modules, module, None)  # importing it would raise
    assert set(measure(*scene(), MetricsParams(measures=["psnr"]))) == {
        (region, "psnr") for region in ("full", "box", "mask")
    }
    table(MetricsParams(measures=["psnr"]))


def test_the_frame_before_is_read_for_its_ssim_alone() -> None:
    for read in METRICS.reads:
        assert read.halo_for(MetricsParams(), Facts()) == (1, 0)
        assert read.halo_for(MetricsParams(measures=["psnr", "ssim"]), Facts()) == (0, 0)


def test_ms_ssim_of_the_box_is_that_of_the_cut_out() -> None:
    rendered, truth, mask = scene()
    values = measure(rendered, truth, mask, MetricsParams(measures=["ms_ssim"]))
    reference = truth * (mask[..., None] / 255.0)
    assert values == {
        ("full", "ms_ssim"): ms_ssim(rendered, reference, 255.0),
        ("box", "ms_ssim"): ms_ssim(rendered[BOX], reference[BOX], 255.0),
        ("mask", "ms_ssim"): ms_ssim(rendered[BOX], reference[BOX], 255.0),  # the mask is its box
    }


def test_a_region_that_is_too_small_has_rows_without_a_value_and_one_warning() -> None:
    params = MetricsParams(measures=["psnr", "ms_ssim"])
    data = table(params)
    without = [i for i, m in enumerate(data["measure"]) if m == "ms_ssim"]
    assert len(without) == len(data["measure"]) / 2
    for i in without:
        assert data["value"][i] is None
        assert data["definition"][i] == UNAVAILABLE + "a region of less than 161 px height or width"
    assert check(Block("metrics/{path}", data), params) == [
        "ms_ssim is not available: a region of less than 161 px height or width"
    ]


@pytest.mark.parametrize("name", ["lpips_alex", "lpips_vgg"])
def test_lpips_without_weights_is_not_available_and_never_a_number(name: str) -> None:
    values = measure(*scene(), MetricsParams(measures=[name]))
    network = name.removeprefix("lpips_")
    assert set(values) == {(region, name) for region in ("full", "box", "mask")}
    for value in values.values():
        assert isinstance(value, Unavailable)
        assert f"metrics.lpips_weights.{network} and metrics.lpips_weights.{network}_linear" in value.reason
    params = MetricsParams(measures=["psnr", name])
    (warning,) = check(Block("metrics/{path}", table(params)), params)
    assert warning.startswith(f"{name} is not available: no weight files; give")


def test_lpips_of_the_files_in_the_settings(tmp_path: Path) -> None:
    path, sha, heads, heads_sha = saved(tmp_path, *made_weights(ALEX))
    params = MetricsParams(
        measures=["lpips_alex"],
        lpips_weights={"alex": path, "alex_linear": heads},
        lpips_sha256={"alex": sha, "alex_linear": heads_sha},
    )
    rendered, truth, mask = scene()
    values, reference = measure(rendered, truth, mask, params), truth * (mask[..., None] / 255.0)
    network = load_network("lpips_alex", path, sha, heads, heads_sha)
    assert values == {
        ("full", "lpips_alex"): network.distance(rendered, reference, 255.0),
        ("box", "lpips_alex"): network.distance(rendered[BOX], reference[BOX], 255.0),
        ("mask", "lpips_alex"): network.distance(rendered[BOX], reference[BOX], 255.0),  # the mask is its box
    }
    assert "lpips_weights" not in params.hashed()  # where the files lie cannot change a result; what they are can
    assert params.hashed()["lpips_sha256"] == {"alex": sha, "alex_linear": heads_sha}
    assert METRICS.needs(SHAPE, params).ram >= METRICS.needs(
        SHAPE, MetricsParams(measures=["lpips_alex"])
    ).ram + MEASURES["lpips_alex"].kept_bytes(params)
    small = {name: values[:14, :14] for name, values in (("rendered", rendered), ("truth", truth), ("mask", mask))}
    assert isinstance(measure(*small.values(), params)["full", "lpips_alex"], Unavailable)


def test_flip_of_the_box_is_the_mean_of_the_full_map() -> None:
    pytest.importorskip("flip_evaluator", reason="flip-evaluator is not installed; `pip install 'posegaussian[flip]'`")
    rendered, truth, mask = scene()
    params = MetricsParams(measures=["flip"], flip_pixels_per_degree=40)
    seen = flip.flip_map(rendered, truth * (mask[..., None] / 255.0), 255.0, 40)
    values = measure(rendered, truth, mask, params)
    assert values == {
        ("full", "flip"): pytest.approx(seen.mean(), rel=1e-6),
        ("box", "flip"): pytest.approx(seen[BOX].mean(), rel=1e-6),
        ("mask", "flip"): pytest.approx(seen[BOX].mean(), rel=1e-6),  # the mask is its box
    }
    assert "40 px a degree" in table(params)["definition"][0]


def test_settings_that_cannot_be_served_are_refused_in_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    def refusal(**settings: object) -> str | None:
        return METRICS.refusal(MetricsParams(**settings), frozenset({"held_out"}))

    sha = hashlib.sha256(b"").hexdigest()
    assert refusal() is None
    assert refusal(measures=["psnr", "lpips_vgg"]) is None  # told as not available
    assert refusal(lpips_weights={"alex": "a.pth"}, lpips_sha256={"alex": sha}) is None
    assert "lpips_sha256 has not; give the sha256" in str(refusal(lpips_weights={"alex": "a.pth"}))
    assert "lpips_weights has not; give the path" in str(refusal(lpips_sha256={"vgg_linear": sha}))
    monkeypatch.setattr(flip, "PACKAGE", "no-such-package")
    assert "not installed; `pip install" in str(refusal(measures=["flip"]))
    assert refusal(measures=["psnr"]) is None
    for wrong in (
        {"measures": []},
        {"measures": ["psnr", "psnr"]},
        {"measures": ["mse"]},
        {"lpips_weights": {"squeeze": "x"}},
        {"lpips_sha256": {"alex": "abc"}},
        {"flip_pixels_per_degree": 0},
    ):
        with pytest.raises(ValidationError):
            MetricsParams(**wrong)


def test_memory_is_projected_for_the_dearest_measure() -> None:
    ram = {name: METRICS.needs(SHAPE, MetricsParams(measures=[name])).ram for name in MEASURES}
    assert ram["psnr"] == ram["ssim"] <= ram["ms_ssim"] < ram["lpips_vgg"]
    assert METRICS.needs(SHAPE, MetricsParams(measures=["psnr", "lpips_vgg"])).ram == ram["lpips_vgg"]
