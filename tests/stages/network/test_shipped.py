"""Laws of the weights that ship: they fit the network their card describes, are as small as promised, and change
depth by little where all is right."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from posegaussian.stages.network.asset import card_of, network_of, notes
from posegaussian.stages.network.card import shipped
from posegaussian.stages.network.model.presets import PRESETS, Preset
from posegaussian.stages.network.params import NetworkParams
from posegaussian.stages.network.weights import sha256

BYTES = {"fast": 4_000_000, "wide": 4_000_000, "base": 10_000_000}
SHAPES = {"fast": "fast", "wide": "fast", "base": "base"}
"""Preset of each set of weights; `wide` has seen wider pairs and views alone."""


def test_every_name_that_is_offered_as_a_level_ships() -> None:
    levels = NetworkParams.model_fields["weights"].json_schema_extra["quality_levels"]  # type: ignore[index,call-overload]
    assert set(levels) - {"none"} <= shipped().keys()


@pytest.mark.parametrize("file", shipped().values(), ids=lambda f: f.stem)
def test_weights_fit_their_card_and_their_size(file: Path) -> None:
    params = NetworkParams(weights=file.stem)
    card, network = card_of(params), network_of(params)
    assert card.preset == SHAPES[file.stem]
    seen = {"alone": True, "widest": 92.0} if file.stem == "wide" else {}
    assert Preset.from_json(card.network) == network.preset == replace(PRESETS[card.preset], **seen)
    assert file.stat().st_size <= BYTES[file.stem]
    assert params.iterations <= card.iterations, "the default asks for no more than was trained"
    assert notes(params) == []
    assert file.with_suffix(".md").read_text() == card.markdown(sha256(file))
    assert "/" not in card.seeds, "no path of a machine"
