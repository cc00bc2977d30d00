"""What noise of pictures as filmed becomes in the pictures that are worked on, which may be smaller."""

from __future__ import annotations

import numpy as np

from posegaussian.stages.imaging.camera_mapping import unreduced_size
from posegaussian.storage.model.cameras import Rig

OCTAVES = 4
"""Sizes at which noise is measured: that of the pictures as filmed, a half, a quarter and an eighth of it."""


def size_worked_at(rig: Rig, source_rig: Rig, captured_to_calibrated: np.ndarray) -> np.ndarray:
    """[V] px of `frames/*` for a px as filmed; `rig` holds the cameras of the frames, `source_rig` the calibrated ones,
    captured_to_calibrated [V, 3] is (scale, x, y)."""
    return np.asarray(rig.size[:, 0] / unreduced_size(rig, source_rig)[:, 0] * captured_to_calibrated[:, 0])


def noise_at(levels: np.ndarray, size: float) -> float:
    """Noise, 1/255, of pictures that are `size` times as large as filmed, from that at every octave [OCTAVES]: straight
    lines over the octaves between them. Larger pictures have that of the filmed ones, for they hold no more; beyond the
    last octave it halves with the size, as noise does whose pixels are strangers to each other.
    """
    octave = float(np.log2(1 / size)) if size < 1 else 0.0
    last = len(levels) - 1
    beyond = max(octave - last, 0.0)
    return float(np.interp(octave, np.arange(last + 1), levels) * 0.5**beyond)
