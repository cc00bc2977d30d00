"""The benchmark's picture: a held-out view of each scene, filmed and rendered from every kind of depth."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

HEIGHT = 256
"""Height of a picture, px."""
LABEL = 18
"""Height of a line of text, px."""


def draw(rows: Sequence[dict[str, Any]], file: Path, cameras: int = 8) -> None:
    """Write a PNG: one line a scene with `cameras` cameras:
    the picture as filmed, then each method's, with its box PSNR."""
    chosen = [r for r in rows if r["cameras"] == cameras]
    lines = []
    for seed in dict.fromkeys(r["seed"] for r in chosen):
        scene = [r for r in chosen if r["seed"] == seed]
        filmed = scene[0]["shown"][1]
        span = around(filmed)
        tiles = [tile(filmed[:, span], f"{seed} {scene[0]['motion']}")]
        tiles += [tile(r["shown"][0][:, span], f"{r['depth']} {r['box psnr']:.1f} dB") for r in scene]
        lines.append(np.hstack(tiles))
    save(lines, file)


def around(filmed: np.ndarray) -> slice:
    """Columns of the person in a picture [h, w, 3] on black, and a few beside."""
    columns = np.nonzero(filmed.any(axis=(0, 2)))[0]
    return slice(max(int(columns[0]) - 12, 0), int(columns[-1]) + 13)


def save(lines: Sequence[np.ndarray], file: Path) -> None:
    """Write a PNG of lines of equal height, in two columns."""
    half = -(-len(lines) // 2)
    width = max((line.shape[1] for line in lines), default=1)
    padded = [np.pad(line, ((0, 0), (0, width - line.shape[1]), (0, 0))) for line in lines]
    padded += [np.zeros_like(padded[0])] * (2 * half - len(lines))
    sheet = np.hstack([np.vstack(padded[:half]), np.vstack(padded[half:])]) if half else np.zeros((1, 1, 3), np.uint8)
    cv2.imwrite(str(file), sheet[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])


def tile(picture: np.ndarray, text: str, height: int = HEIGHT) -> np.ndarray:
    """A picture [h, w, 3] `height` px high under a line of text."""
    scaled = cv2.resize(
        picture, (max(round(picture.shape[1] * height / picture.shape[0]), 110), height), interpolation=cv2.INTER_AREA
    )
    label = np.zeros((LABEL, scaled.shape[1], 3), np.uint8)
    cv2.putText(label, text, (3, 13), cv2.FONT_HERSHEY_SIMPLEX, 0.38, (255, 255, 255), 1, cv2.LINE_AA)
    return np.vstack([label, scaled])
