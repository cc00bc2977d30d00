"""Trained weights as a file, with their card as a page beside it."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path

import torch

from posegaussian.stages.network.card import Card
from posegaussian.stages.network.weights import packed
from posegaussian.storage.files.write import write_atomically


def save_weights(path: Path, state: Mapping[str, torch.Tensor], card: Card) -> str:
    """Write a state as float16 with its card, and the card as a page beside it (.md); returns the sha256.

    The file appears whole or not at all; equal weights give equal bytes.

    Raises:
        WeightsError: for a value that is not finite or beyond float16, naming the key.
        NotWritten: where the disk does not take it.
    """
    data = packed(state, card, str(path))
    write_atomically(path, data)
    digest = hashlib.sha256(data).hexdigest()
    write_atomically(path.with_suffix(".md"), card.markdown(digest).encode())
    return digest
