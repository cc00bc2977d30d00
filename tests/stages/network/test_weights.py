"""Laws of weights: a round trip to float16 spacing, equal bytes, and errors that name key, shape and file."""

from pathlib import Path

import pytest
import torch

from posegaussian.dags.training.weights import save_weights
from posegaussian.stages.network.card import Card, WeightsError, read_card
from posegaussian.stages.network.model.presets import PRESETS
from posegaussian.stages.network.weights import load_weights, sha256

CARD = Card(
    "tiny",
    "fast",
    PRESETS["fast"].as_json(),
    6,
    "Two spheres.",
    "1 and 2",
    0.5,
    "one core",
    (("measure", "value"), ("EPE", "1.5")),
    ("Anything at all.",),
)


def network(width: int = 8, seed: int = 0) -> torch.nn.Module:
    torch.manual_seed(seed)
    return torch.nn.Sequential(torch.nn.Conv2d(3, width, 3), torch.nn.BatchNorm2d(width), torch.nn.Conv2d(width, 2, 1))


def test_weights_come_back_within_float16_spacing(tmp_path: Path) -> None:
    first, second = network(), network(seed=1)
    first[1].num_batches_tracked += 70_000  # more than float16 holds: whole numbers stay whole
    digest = save_weights(tmp_path / "tiny.safetensors", first.state_dict(), CARD)
    load_weights(tmp_path / "tiny.safetensors", second, digest)
    for key, value in second.state_dict().items():
        # half a spacing of 2^-10; below 6e-5 numbers are 6e-8 apart
        torch.testing.assert_close(value, first.state_dict()[key], rtol=2**-11, atol=3e-8)
        assert value.dtype == first.state_dict()[key].dtype
    assert int(second[1].num_batches_tracked) == 70_000


def test_a_second_round_trip_changes_nothing_and_equal_weights_give_equal_bytes(tmp_path: Path) -> None:
    a, b = tmp_path / "a.safetensors", tmp_path / "b.safetensors"
    net = network()
    first = save_weights(a, net.state_dict(), CARD)
    load_weights(a, net)
    assert save_weights(b, dict(reversed(net.state_dict().items())), CARD) == first == sha256(b)
    assert a.read_bytes() == b.read_bytes()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.md", "a.safetensors", "b.md", "b.safetensors"]


def test_the_card_lies_within_and_beside(tmp_path: Path) -> None:
    digest = save_weights(tmp_path / "tiny.safetensors", network().state_dict(), CARD)
    assert read_card(tmp_path / "tiny.safetensors") == CARD
    text = (tmp_path / "tiny.md").read_text(encoding="utf-8")
    assert digest in text
    assert "| measure | value |\n| --- | --- |\n| EPE | 1.5 |" in text
    assert "Anything at all." in text


@pytest.mark.parametrize("value", [float("nan"), float("inf"), 7e4])
def test_what_float16_cannot_hold_is_refused_by_key(tmp_path: Path, value: float) -> None:
    state = network().state_dict()
    state["2.weight"][0, 0] = value
    with pytest.raises(WeightsError, match=r"2\.weight \(2, 8, 1, 1\)"):
        save_weights(tmp_path / "bad.safetensors", state, CARD)
    assert not list(tmp_path.iterdir())


def test_weights_that_do_not_fit_say_which_and_change_nothing(tmp_path: Path) -> None:
    file = tmp_path / "tiny.safetensors"
    save_weights(file, network().state_dict(), CARD)
    wide = network(16)
    before = {k: v.clone() for k, v in wide.state_dict().items()}
    with pytest.raises(
        WeightsError,
        match=r"tiny\.safetensors .*0\.weight is \(8, 3, 3, 3\) in the file, \(16, 3, 3, 3\) in the network",
    ):
        load_weights(file, wide)
    assert all(torch.equal(v, before[k]) for k, v in wide.state_dict().items())
    with pytest.raises(WeightsError, match=r"3\.bias \(4,\) is missing in the file"):
        load_weights(file, torch.nn.Sequential(*network(), torch.nn.Conv2d(2, 4, 1)))
    with pytest.raises(WeightsError, match=r"2\.weight \(2, 8, 1, 1\) is not known to the network"):
        load_weights(file, network()[:2])


def test_damaged_other_and_missing_files_are_named(tmp_path: Path) -> None:
    file = tmp_path / "tiny.safetensors"
    digest = save_weights(file, network().state_dict(), CARD)
    with pytest.raises(WeightsError, match=r"nothing\.safetensors: no such file"):
        load_weights(tmp_path / "nothing.safetensors", network())
    file.write_bytes(file.read_bytes()[:-7])
    with pytest.raises(WeightsError, match="is damaged or another version"):
        load_weights(file, network(), digest)
    with pytest.raises(WeightsError, match="no safetensors file"):
        load_weights(file, network())
    with pytest.raises(WeightsError, match="no safetensors file"):
        read_card(file)
