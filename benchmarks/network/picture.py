"""The network benchmark's picture: a held-out view of each scene with and without the network, and where they differ
from the film."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.quality.picture import around, save, tile

SCENES = 4
"""Scenes drawn, the first ones."""
WHITE = 48.0
"""Of 255 steps: a mean difference that is drawn brightest."""


def draw(rows: Sequence[dict[str, Any]], file: Path) -> None:
    """Write a PNG: a line a scene: as filmed, floor, network, their differences from the film, and where the network
    is nearer or farther."""
    lines = []
    for seed in list(dict.fromkeys(r["seed"] for r in rows))[:SCENES]:
        floor, network = (
            next(r for r in rows if (r["seed"], r["depth"]) == (seed, kind)) for kind in ("floor", "network")
        )
        filmed = floor["shown"][1]
        span = around(filmed)
        apart = [difference(r["shown"][0], filmed) for r in (floor, network)]
        tiles = [tile(filmed[:, span], f"{seed} {floor['motion']}")]
        tiles += [tile(r["shown"][0][:, span], f"{r['depth']} {r['box psnr']:.2f} dB") for r in (floor, network)]
        tiles += [
            tile(glowing(a)[:, span], f"error of {name}") for name, a in zip(("floor", "network"), apart, strict=True)
        ]
        tiles.append(tile(nearer(*apart)[:, span], "better / worse"))
        lines.append(np.hstack(tiles))
    save(lines, file)


def difference(picture: np.ndarray, filmed: np.ndarray) -> np.ndarray:
    """[h, w] mean absolute difference of the colours, 1/255."""
    return np.abs(picture.astype(np.float64) - filmed).mean(axis=2)


def nearer(floor: np.ndarray, network: np.ndarray) -> np.ndarray:
    """[h, w, 3] of two differences [h, w]: green where the network's is smaller, red where it is larger."""
    change = np.clip((floor - network) / WHITE, -1, 1)
    shown = np.zeros((*change.shape, 3))
    shown[..., 1], shown[..., 0] = np.maximum(change, 0), np.maximum(-change, 0)
    return np.asarray((255 * shown).round(), np.uint8)


def glowing(apart: np.ndarray) -> np.ndarray:
    """A difference [h, w] as colours [h, w, 3], black to yellow."""
    steps = (255 * np.clip(apart / WHITE, 0, 1)).astype(np.uint8)
    return np.asarray(cv2.applyColorMap(steps, cv2.COLORMAP_INFERNO)[..., ::-1])
