"""The stage's kernel: every view, zeros where a view is no source,
frames by themselves, and frames that a camera missed."""

import copy
from dataclasses import replace

import numpy as np
import pytest
import torch

from posegaussian.stages.contract.declaration import resolve
from posegaussian.stages.contract.facts import Facts
from posegaussian.stages.contract.io import Block, Views
from posegaussian.stages.network.choice import PICKED
from posegaussian.stages.network.model.network import PoseGaussianNetwork
from posegaussian.stages.network.model.presets import PRESETS
from posegaussian.stages.network.params import NetworkParams
from posegaussian.stages.network.run import check, stored
from posegaussian.stages.network.stage import STAGE, unneeded
from posegaussian.storage.model.cameras import Rig
from tests.support.memory_inputs import MemoryInputs, run_stage
from tests.support.network_views import network, plane_depth, source, two_cameras

torch.set_num_threads(1)
FRAMES, SIDE = 3, 64
PLAIN = {"effects": frozenset()}
PARAMS = NetworkParams(weights="any", iterations=1, precision="float32")
VIEWS = Views(tuple("abcd"), (0, 1, 2), (3,))


@pytest.fixture(scope="module")
def net() -> PoseGaussianNetwork:
    return network()


@pytest.fixture(scope="module")
def rig() -> Rig:
    return two_cameras((SIDE, SIDE), angles=(-25.0, 0.0, 25.0, 12.0))


@pytest.fixture(scope="module")
def arrays(rig: Rig) -> dict[str, np.ndarray]:
    """A plane that comes nearer from frame to frame; heatmaps of noise."""
    shown = [
        [source(rig, v, plane_depth(rig, v, (np.array([1.0, 0.2, 0.1]), 0.05 * f))) for v in range(4)]
        for f in range(FRAMES)
    ]
    found = {
        f"frames/{name}": np.array([[getattr(s, name) for s in row] for row in shown]) for name in ("color", "mask")
    }
    found |= {
        f"depth/{name}": np.array([[getattr(s, name) for s in row] for row in shown])
        for name in ("depth", "confidence")
    }
    heatmaps = np.random.default_rng(0).random((FRAMES, 4, 17, SIDE // 4, SIDE // 4)).astype(np.float16)
    return {**found, "pose/heatmaps": heatmaps, "smoothing/heatmaps": heatmaps[:, :, ::-1].copy()}


def maps(
    net: PoseGaussianNetwork, rig: Rig, arrays: dict[str, np.ndarray], length: int | None = None, **more: object
) -> dict[str, np.ndarray]:
    return run_stage(STAGE, PARAMS, arrays, rig, VIEWS, FRAMES, length, sources={"network": net}, **{**PLAIN, **more})


@pytest.fixture(scope="module")
def whole(net: PoseGaussianNetwork, rig: Rig, arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return maps(net, rig, arrays)


def same(
    a: dict[str, np.ndarray], b: dict[str, np.ndarray], frames: slice = slice(None), views: slice = slice(None)
) -> bool:
    return a.keys() == b.keys() and all(
        a[name][frames, views].tobytes() == b[name][frames, views].tobytes() for name in a
    )


def test_sources_get_depth_where_they_had_one_and_other_views_get_zeros(
    whole: dict[str, np.ndarray], arrays: dict[str, np.ndarray]
) -> None:
    assert {name: (a.dtype, a.shape) for name, a in whole.items()} == {
        "network/depth": (np.float32, (FRAMES, 4, SIDE, SIDE)),
        "network/confidence": (np.float16, (FRAMES, 4, SIDE, SIDE)),
        "network/share": (np.float32, (FRAMES, 4, 1)),
        "network/blend": (np.float16, (FRAMES, 4, SIDE, SIDE)),
        "network/numbers": (np.float16, (FRAMES, 4, 8, SIDE, SIDE)),
    }
    assert not any(a[:, 3].any() for a in whole.values())
    np.testing.assert_array_equal(whole["network/depth"][:, :3] > 0, arrays["depth/depth"][:, :3] > 0)
    for view in range(3):
        assert (whole["network/depth"][:, view] != arrays["depth/depth"][:, view]).any()
        assert whole["network/confidence"][:, view].any()
        assert not whole["network/confidence"][:, view][arrays["depth/depth"][:, view] == 0].any()
        for name, data in whole.items():
            assert check(Block(name, data[:, view], view), NetworkParams()) == []


def test_partitions_and_their_order_change_nothing(
    net: PoseGaussianNetwork, rig: Rig, arrays: dict[str, np.ndarray], whole: dict[str, np.ndarray]
) -> None:
    assert same(maps(net, rig, arrays, length=1), whole)
    backwards = maps(net, rig, {name: a[::-1].copy() for name, a in arrays.items()}, length=2)
    assert same({name: a[::-1] for name, a in backwards.items()}, whole)


def test_a_frame_that_a_camera_missed_is_the_analytic_one_there(
    net: PoseGaussianNetwork, rig: Rig, arrays: dict[str, np.ndarray], whole: dict[str, np.ndarray]
) -> None:
    valid = np.ones((FRAMES, 4), bool)
    valid[1, 0], valid[2, :2] = False, False
    found = maps(net, rig, arrays, length=2, valid_all=valid)
    assert same(found, whole, slice(0, 1))
    for f, view in ((1, 0), (2, 0), (2, 1), (2, 2)):  # the last one has no neighbour left
        assert found["network/depth"][f, view].tobytes() == arrays["depth/depth"][f, view].tobytes()
        assert not found["network/confidence"][f, view].any()
        assert not found["network/numbers"][f, view].any()
    assert found["network/confidence"][1, 1].any()
    two = run_stage(
        STAGE, PARAMS, arrays, rig, Views(tuple("abcd"), (1, 2), (0, 3)), FRAMES, sources={"network": net}, **PLAIN
    )
    assert same(found, two, slice(1, 2), slice(1, 4)), "as if it were no source"


def test_third_views_are_sources_of_the_same_frame(rig: Rig, arrays: dict[str, np.ndarray]) -> None:
    """Partitions change nothing; a view that the camera missed is nobody's third, and what is held out never is."""
    further = network(further_views=True)
    whole = maps(further, rig, arrays)
    noise = np.random.default_rng(1)
    spoilt = {
        name: np.concatenate([a[:, :3], (a[:, 3:] * noise.random(a[:, 3:].shape)).astype(a.dtype)], axis=1)
        for name, a in arrays.items()
    }
    assert same(maps(further, rig, spoilt, length=1), whole)
    valid = np.ones((FRAMES, 4), bool)
    valid[1, 2] = False
    found = maps(further, rig, arrays, valid_all=valid)
    assert same(found, whole, slice(0, 1))
    two = run_stage(
        STAGE, PARAMS, arrays, rig, Views(tuple("abcd"), (0, 1), (2, 3)), FRAMES, sources={"network": further}, **PLAIN
    )
    assert same(found, two, slice(1, 2), slice(0, 2)), "as if it were no source"
    assert not same(found, whole, slice(1, 2), slice(0, 1)), "it had a say"


def test_the_frames_own_heatmaps_move_depth_and_stabilised_ones_the_pose_encoder_alone(
    net: PoseGaussianNetwork, rig: Rig, arrays: dict[str, np.ndarray], whole: dict[str, np.ndarray]
) -> None:
    """Section 3.2 of the paper: a network whose decoder sees no pose says the same with a stabiliser as without one."""
    once = {name: a[:1] for name, a in arrays.items()}
    blind = network(pose_in=frozenset({"depth"}))

    def said(network: PoseGaussianNetwork, *on: str, **other: np.ndarray) -> dict[str, np.ndarray]:
        given = {**once, **{name.replace("_", "/"): a for name, a in other.items()}}
        effects = frozenset(on)
        return run_stage(STAGE, PARAMS, given, rig, VIEWS, 1, sources={"network": network}, effects=effects)

    drawn, both = ("pose_heatmaps",), ("pose_heatmaps", "temporal_smoothing")
    assert said(net)["network/numbers"].tobytes() != said(net, *drawn)["network/numbers"].tobytes()
    assert not same(said(net, *drawn), said(net, *both))
    assert same(said(blind, *drawn), said(blind, *both))
    steady = once["smoothing/heatmaps"]
    assert same(said(net, *drawn, pose_heatmaps=steady), said(net, *both, pose_heatmaps=steady))
    assert not same(said(blind, *drawn), said(blind, *both, pose_heatmaps=steady))


def test_a_network_that_says_nothing_is_reported(
    net: PoseGaussianNetwork, rig: Rig, arrays: dict[str, np.ndarray]
) -> None:
    silent = copy.deepcopy(net)
    for last in silent.heads.last.values():
        torch.nn.init.zeros_(last.weight)
        torch.nn.init.constant_(last.bias, -1e6)
    inputs = MemoryInputs(
        STAGE, PARAMS, arrays, rig, VIEWS, range(1), FRAMES, sources={"network": silent}, effects=frozenset()
    )
    notes = [n for block in resolve(STAGE.run)(inputs, PARAMS) for n in block.notes]
    assert len(notes) == 3
    assert "mean confidence is 0.00" in notes[0]


def test_of_a_view_that_shows_nobody_nothing_is_reported(
    net: PoseGaussianNetwork, rig: Rig, arrays: dict[str, np.ndarray]
) -> None:
    empty = arrays | {name: np.zeros_like(arrays[name]) for name in ("depth/depth", "depth/confidence", "frames/mask")}
    inputs = MemoryInputs(
        STAGE, PARAMS, empty, rig, VIEWS, range(1), FRAMES, sources={"network": net}, effects=frozenset()
    )
    assert not [n for block in resolve(STAGE.run)(inputs, PARAMS) for n in block.notes]


def test_pairs_that_are_too_large_are_left_out_and_reported(
    net: PoseGaussianNetwork, rig: Rig, arrays: dict[str, np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("posegaussian.stages.network.inference.too_large", lambda pair, window: 1 in pair.views)
    inputs = MemoryInputs(
        STAGE, PARAMS, arrays, rig, VIEWS, range(2), FRAMES, sources={"network": net}, effects=frozenset()
    )
    blocks = list(resolve(STAGE.run)(inputs, PARAMS))
    told = {b.view: n for b in blocks for n in b.notes if "were not shown to the network" in n}
    assert told[1].startswith("4 of its pairs in these frames")  # with either neighbour, in two frames
    (depth,) = (b.data for b in blocks if b.array == "network/depth" and b.view == 1)
    assert depth.tobytes() == arrays["depth/depth"][:2, 1].tobytes()


def test_it_is_left_out_without_weights_and_for_a_single_view() -> None:
    assert "network.weights is none" in (unneeded(NetworkParams(weights="none"), Facts()) or "")
    left_out = unneeded(NetworkParams(), Facts(frozenset({PICKED["none"]})))
    assert "auto came to none" in (left_out or "")
    assert "single source view" in (unneeded(NetworkParams(weights="fast"), frozenset({"single_source"})) or "")
    assert unneeded(NetworkParams(weights="fast"), frozenset()) is None


def test_check_names_what_is_impossible() -> None:
    assert resolve(STAGE.check or "") is check
    for array, value in (
        ("depth", np.nan),
        ("depth", -1),
        ("confidence", 1.01),
        ("confidence", -0.1),
        ("numbers", np.inf),
    ):
        with pytest.raises(ValueError, match=f"network/{array} of view 2: 1 values"):
            check(Block(f"network/{array}", np.array([0.0, value]), 2), NetworkParams())


@pytest.mark.parametrize("rotation", ["normal", "quaternion"])
@pytest.mark.parametrize("opacity", ["facing", "single"])
def test_what_heads_say_has_its_place_whatever_their_kind(rotation: str, opacity: str) -> None:
    preset = replace(PRESETS["fast"], rotation_head=rotation, opacity_head=opacity)
    counts = {"scale": 3, "rotation": 4 if rotation == "quaternion" else 3, "opacity": 1 if opacity == "single" else 2}
    said = np.concatenate(
        [np.full((n, 2, 2), 10 * i + np.arange(n)[:, None, None]) for i, n in enumerate(counts.values())]
    )
    numbers, turn = stored(said, preset)
    assert numbers[:3, 0, 0].tolist() == [0, 1, 2]
    first = rotation == "quaternion"
    assert numbers[3:6, 0, 0].tolist() == [10 + first, 11 + first, 12 + first]
    assert numbers[6:, 0, 0].tolist() == [20, 0 if opacity == "single" else 21]
    assert turn[0, 0, 0] == (10 if first else 0)
