"""The network as an asset: which file the setting `network.weights` means, what it holds, and the thing itself.

Nothing heavy is imported before a network is made: a plan asks for the file and its digest alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

from posegaussian.stages.contract.declaration import Asset
from posegaussian.stages.geometry.turning import turned_pairs
from posegaussian.stages.network.card import Card, WeightsError, read_card, shipped
from posegaussian.stages.network.choice import settled, widest_angle
from posegaussian.stages.network.model.presets import Preset
from posegaussian.stages.network.params import (
    AUTO,
    NETWORK,
    NONE,
    QUATERNIONS,
    SINGLE_OPACITY,
    TURNED,
    TWISTED,
    NetworkParams,
)
from posegaussian.storage.model.cameras import Rig
from posegaussian.storage.model.capture import SourceFile
from posegaussian.storage.model.errors import ConfigError


def weights_file(params: NetworkParams) -> Path:
    """The file that the setting means. Raises ConfigError where there is none."""
    found = shipped().get(params.weights) or Path(params.weights)
    if not found.is_file():
        names = ", ".join([AUTO, NONE, *shipped()])
        raise ConfigError(
            f"network.weights is {params.weights}: neither weights that ship ({names}) nor a file; train some with"
            " `posegaussian train`, or use none"
        )
    return found


def weights_digest(params: NetworkParams) -> str:
    """sha256 of the file."""
    return SourceFile.of(weights_file(params)).sha256


def card_of(params: NetworkParams) -> Card:
    """The card in the file. Raises ConfigError, and WeightsError for a file without one."""
    file = weights_file(params)
    return _card(file, file.stat().st_mtime_ns)


@lru_cache(maxsize=8)
def _card(file: Path, stamp: int) -> Card:
    return read_card(file)


def kinds_of_heads(params: NetworkParams) -> list[str]:
    """Facts on what the heads say; none of weights that ship, which have a normal and two opacities.
    Raises ConfigError, and WeightsError for a file without a card."""
    if params.weights in (AUTO, NONE, *shipped()):
        return []
    preset = Preset.from_json(card_of(params).network)
    kinds = {QUATERNIONS: preset.rotation_head == "quaternion", SINGLE_OPACITY: preset.opacity_head == "single"}
    return [name for name, holds in kinds.items() if holds]


def facts_of(rig: Rig, sources: Sequence[int], params: NetworkParams) -> list[str]:
    """What the heads say, and whether Gaussians are twisted: by whole rotations, or by pairs that lie turned in their
    pictures. Raises as `kinds_of_heads`."""
    kinds, widest = kinds_of_heads(params), widest_angle(params)
    if QUATERNIONS in kinds:
        return [*kinds, TWISTED]
    if params.weights == NONE or len(sources) < 2 or not turned_pairs(rig, sources, params.pairs, widest):
        return kinds
    return [*kinds, TURNED, TWISTED]


def notes(params: NetworkParams) -> list[str]:
    """Sentences for the plan: what is asked of the weights that they were not trained for."""
    trained = card_of(params).iterations
    if params.iterations <= trained:
        return []
    warning = (
        f"network.iterations is {params.iterations}, but {params.weights} was trained with 1 to {trained}: beyond that"
        f" depth may get worse; use at most {trained}"
    )
    return [warning]


def network_of(params: NetworkParams) -> Any:
    """The network of the file, made once in a process.
    Raises ConfigError, and WeightsError for a file that does not hold one."""
    file = weights_file(params)
    return _made(file, file.stat().st_mtime_ns)


@lru_cache(maxsize=2)
def _made(file: Path, stamp: int) -> Any:
    import torch

    from posegaussian.stages.network.model.network import PoseGaussianNetwork
    from posegaussian.stages.network.weights import load_weights
    from posegaussian.stages.splatting.device import device

    try:
        preset = Preset.from_json(read_card(file).network)
    except ValueError as e:
        raise WeightsError(f"{file}: {e}; the card was changed, fetch the file again") from e
    network = PoseGaussianNetwork(preset)
    load_weights(file, network)
    for p in network.eval().requires_grad_(False).parameters():
        if p.ndim == 4:  # what convolutions are quickest with
            p.data = p.data.contiguous(memory_format=torch.channels_last)
    return network.to(device())


def _named(params: NetworkParams, name: str) -> NetworkParams:
    return params.model_copy(update={"weights": name})


def _shipped_digest(params: NetworkParams) -> str:
    return " ".join(f"{name} {weights_digest(_named(params, name))}" for name in shipped())


def _shipped_networks(params: NetworkParams) -> dict[str, Any]:
    return {name: network_of(_named(params, name)) for name in shipped()}


TRAINED = Asset(NETWORK, weights_digest, network_of, settled)
"""The network with the weights that the settings name, or that `auto` comes to."""
SHIPPED_NETWORKS = Asset("shipped_networks", _shipped_digest, _shipped_networks)
"""{name: network} with every set of weights that ships."""
