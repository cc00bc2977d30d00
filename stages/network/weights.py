"""Weights as float16 safetensors: written with a card, loaded by name, known by their sha256."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Mapping
from dataclasses import asdict
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import nn

from posegaussian.stages.network.card import Card, WeightsError, must_exist

LARGEST = 65504.0
"""Of float16."""


def sha256(path: Path) -> str:
    """Hexadecimal digest of a file."""
    with path.open("rb") as f:
        return hashlib.file_digest(f, "sha256").hexdigest()


def packed(state: Mapping[str, torch.Tensor], card: Card, where: str) -> bytes:
    """A state as the bytes of a float16 safetensors file that holds its card.

    Floating numbers become float16, whole numbers stay. Equal weights give equal bytes.

    Args:
        state: tensors by name.
        card: what one should know of them.
        where: name of the file they are for, for the error.

    Raises:
        WeightsError: for a value that is not finite or beyond float16, naming the key.
    """
    tensors = {}
    for key, value in sorted(state.items()):
        if value.is_floating_point():
            largest = float(value.abs().max()) if value.numel() else 0.0
            if not largest <= LARGEST:
                raise WeightsError(
                    f"{where}: {key} {tuple(value.shape)} holds {largest:g};"
                    f" float16 weights must be finite and within {LARGEST:g}"
                )
            value = value.half()
        tensors[key] = value.detach().cpu().contiguous().clone()
    return save(tensors, metadata={"card": json.dumps(asdict(card), sort_keys=True)})


def load_weights(path: Path, network: nn.Module, digest: str | None = None, may_lack: Collection[str] = ()) -> None:
    """Load weights by name into a network, in the network's dtypes; nothing is changed unless everything fits.

    `may_lack`: keys that stay what they are where the file lacks them.

    Raises:
        WeightsError: where the file is missing, damaged or not the expected one, and where a key is missing,
            superfluous or of another shape: it names the keys, the shapes and the file.
    """
    must_exist(path)
    if digest is not None and (found := sha256(path)) != digest:
        raise WeightsError(
            f"{path} has sha256 {found}, expected {digest}: it is damaged or another version; fetch it again"
        )
    try:
        with safe_open(path, framework="pt") as f:
            tensors = {key: f.get_tensor(key) for key in f.keys()}  # noqa: SIM118 (it is no mapping)
    except SafetensorError as e:
        raise WeightsError(f"{path} is no safetensors file: {e}") from e
    own = {k: v for k, v in network.state_dict().items() if k in tensors or k not in may_lack}
    wrong = [
        f"{k} is {tuple(tensors[k].shape)} in the file, {tuple(own[k].shape)} in the network"
        for k in sorted(own.keys() & tensors.keys())
        if tensors[k].shape != own[k].shape
    ]
    wrong += [f"{k} {tuple(own[k].shape)} is missing in the file" for k in sorted(own.keys() - tensors.keys())]
    wrong += [f"{k} {tuple(tensors[k].shape)} is not known to the network" for k in sorted(tensors.keys() - own.keys())]
    wrong += [
        f"{k} {tuple(v.shape)} holds what is not finite"
        for k, v in sorted(tensors.items())
        if v.is_floating_point() and not torch.isfinite(v).all()
    ]
    if wrong:
        more = f"; and {len(wrong) - 4} more" if len(wrong) > 4 else ""
        raise WeightsError(
            f"{path} does not fit this network: {'; '.join(wrong[:4])}{more}. Are preset and variant those of its card?"
        )
    with torch.no_grad():
        for key, value in own.items():
            value.copy_(tensors[key])
