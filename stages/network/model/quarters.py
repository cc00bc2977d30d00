"""Rectified pictures turned by quarters, so that the network sees a person upright whichever way a pair's rows run.

Rows of a pair run along its baseline: between cameras above each other a standing person lies across its rectified
pictures, and weights that were trained on upright ones know nobody who lies. So pictures are turned before they are
looked at, what is compared along rows is compared in the pair's own pictures, and what is said is turned back.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch


@dataclass(frozen=True)
class Quarters:
    """By how many quarters, counter-clockwise, the pictures of B directions are turned to stand upright."""

    turns: tuple[int, ...]

    @staticmethod
    def none(directions: int) -> Quarters:
        """Of pictures that stand upright."""
        return Quarters((0,) * directions)

    def upright(self, maps: torch.Tensor) -> torch.Tensor:
        """Maps [B, C, h, w] of rectified pictures, turned; the same tensor where nothing is. Raises ValueError where
        some are turned on their side and others not, and they are not square."""
        return self._turned(maps, 1)

    def in_rows(self, maps: torch.Tensor) -> torch.Tensor:
        """Upright maps [B, C, h, w] as the rectified pictures lie; undoes `upright`."""
        return self._turned(maps, -1)

    def along_rows(self, said: torch.Tensor, axes: Sequence[int], signed: bool) -> torch.Tensor:
        """What is said [B, n, h, w] along the axes of upright pictures, in the channels `axes` (x, y), along those of
        the rectified ones: sizes change places, the two components of a normal (x, -y), `signed`, are turned."""
        if not any(self.turns):
            return said
        x, y = axes
        return torch.stack([_axes_turned(own, x, y, turn, signed) for own, turn in zip(said, self.turns, strict=True)])

    def _turned(self, maps: torch.Tensor, sense: int) -> torch.Tensor:
        if not any(self.turns):
            return maps
        if len(set(self.turns)) == 1:
            return torch.rot90(maps, sense * self.turns[0], (2, 3)).contiguous()
        if maps.shape[2] != maps.shape[3] and any(t % 2 for t in self.turns):
            raise ValueError(f"maps of {tuple(maps.shape[2:])} cells, some turned on their side, are no batch")
        return torch.stack([torch.rot90(m, sense * t, (1, 2)) for m, t in zip(maps, self.turns, strict=True)])


def _axes_turned(said: torch.Tensor, x: int, y: int, turn: int, signed: bool) -> torch.Tensor:
    """Maps [n, h, w] with the channels x and y turned by quarters; gradients pass."""
    channels = list(said)
    for _ in range(turn % 4):
        channels[x], channels[y] = channels[y], -channels[x] if signed else channels[x]
    return torch.stack(channels)
