"""The official weight files of LPIPS, given by the user: read, checked against their sha256, and brought to their
stack.

Networks are torchvision's state dicts (`alexnet-owt-7be5be79.pth`, `vgg16-397923af.pth`; the name ends with the
beginning of the sha256), linear layers those of the `lpips` package (`weights/v0.1/alex.pth`, `vgg.pth`). Nothing in a
file is run.
"""

from __future__ import annotations

import hashlib
from functools import lru_cache
from pathlib import Path
from typing import Any

import torch

from posegaussian.stages.metrics.measures.lpips_network import STACKS, Network, Stack
from posegaussian.storage.model.errors import SourceError


@lru_cache(maxsize=4)
def load_network(measure: str, network: str, network_sha256: str, linear: str, linear_sha256: str) -> Network:
    """The network of `lpips_alex` or `lpips_vgg`, kept by the process.

    Raises SourceError, naming the file, for one that is missing, has another sha256, cannot be read, or lacks a layer.
    """
    stack = STACKS[measure]
    trunk, heads = _read(network, network_sha256), _read(linear, linear_sha256)
    weights = {}
    for c in stack.layers:
        kernel = _tensor(network, trunk, f"{c.key}.weight", (c.channels[1], c.channels[0], c.size, c.size))
        weights[c.key] = (kernel, _tensor(network, trunk, f"{c.key}.bias", (c.channels[1],)))
    return Network(stack, weights, _heads(linear, heads, stack))


def _heads(path: str, state: dict[str, Any], stack: Stack) -> tuple[torch.Tensor, ...]:
    return tuple(
        _tensor(path, state, f"lin{i}.model.1.weight", (1, width, 1, 1)).reshape(width)
        for i, width in enumerate(stack.widths)
    )


def _read(path: str, sha256: str) -> dict[str, Any]:
    """The state dict of a file whose content is the one that was meant."""
    file = Path(path)
    if not file.is_file():
        raise SourceError(
            f"metrics.lpips_weights: no file {path}; give the path of the official weights, one that every worker can"
            " read"
        )
    with open(file, "rb") as f:
        found = hashlib.file_digest(f, "sha256").hexdigest()
    if found != sha256:
        raise SourceError(
            f"metrics.lpips_weights: {path} has sha256 {found}, but metrics.lpips_sha256 says {sha256}; it is another"
            " file, or the setting is to be corrected"
        )
    try:
        state = torch.load(file, map_location="cpu", weights_only=True)
    except Exception as e:  # torch raises whatever unpickling raises, from KeyError to RuntimeError
        raise SourceError(
            f"metrics.lpips_weights: {path} cannot be read as PyTorch weights ({type(e).__name__}); a state dict saved"
            " by torch is expected"
        ) from e
    if not isinstance(state, dict):
        raise SourceError(f"metrics.lpips_weights: {path} holds a {type(state).__name__}; a state dict is expected")
    return state


def _tensor(path: str, state: dict[str, Any], key: str, shape: tuple[int, ...]) -> torch.Tensor:
    """A copy of one entry in float32, so that the rest of the file's memory goes."""
    found = state.get(key)
    if not isinstance(found, torch.Tensor) or tuple(found.shape) != shape:
        have = (
            f"has the shape {list(found.shape)}"
            if isinstance(found, torch.Tensor)
            else f"is not there; the file has {', '.join(list(state)[:3])}..."
        )
        raise SourceError(f"metrics.lpips_weights: {path}: {key} {have}; a tensor {list(shape)} is expected")
    if not torch.isfinite(found).all():
        raise SourceError(f"metrics.lpips_weights: {path}: {key} holds values that are not finite")
    return found.to(torch.float32, copy=True).contiguous()
