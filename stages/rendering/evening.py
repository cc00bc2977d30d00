"""Outlines without saw-teeth: as smooth, and as soft, as those of the source masks.

Depth is a pixel off here and there, and coverage adds up where a surface turns away: the outline of a drawn picture is
frayed and hard. How smooth and how soft it is in truth the source masks show. Evening is one step of threshold dynamics
(Merriman, Bence, Osher, "Diffusion generated motion by mean curvature", 1992): the share around a pixel, then the alpha
that the masks have where their share around is the same. What the step changes of the masks themselves is shape: hair,
fingers, creases, or a soft matte. What it changes of the picture is shape and noise, so that the step goes as far as
noise has a part in it (Wiener's filter). Loose hair leaves it at nothing.

What Gaussians draw is still softer than the masks, and where it is trusted to lie in its place more contrast about a
half makes it nearly as sharp.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np

from posegaussian.stages.imaging.part import part_around
from posegaussian.stages.silhouettes.hull import Silhouettes
from posegaussian.stages.silhouettes.softness import softness
from posegaussian.stages.splatting.definition.scene import Camera
from posegaussian.storage.model.cameras import Rig

WIDTH = 1.2
"""Px: standard deviation of what is around a pixel. A strip of 1.6 px is as wide as it must be to stay."""
BINS = 32
"""Steps of the share around in which the masks' alpha is averaged."""
RIM = 0.02
"""Share around, above none and below all of it, from which on a pixel is at an outline."""
CONTRAST = 1.3
"""Of an outline that lies where it belongs."""
EXACT = 0.5
"""Px over which an outline rises at least: where pixels hold what of them is covered."""
REACH = math.ceil(2.5 * WIDTH)
"""Px beyond what is drawn that may get some alpha."""


@dataclass(frozen=True, eq=False)
class Outlines:
    """What one frame's masks say about outlines."""

    transfer: np.ndarray
    """[BINS + 1] alpha by the share around, from none to all; rising from 0 to 1."""
    shape: float
    """Mean square by which evening to a hard outline would change the masks along theirs."""
    softness: float
    """Px over which the masks rise (`posegaussian.stages.silhouettes.softness`), `EXACT` at least."""

    @classmethod
    def of(cls, masks: Iterable[np.ndarray], softness: float = 0.0) -> Outlines | None:
        """Of masks [h, w] uint8 of any sizes that rise over so many px; None without any outline."""
        sums, counts, changed = np.zeros(BINS + 1), np.zeros(BINS + 1), 0.0
        for mask in masks:
            alpha = mask.astype(np.float32) / np.float32(255)
            around = _around(alpha)
            rim = _rim(around)
            bins = np.rint(around[rim] * BINS).astype(np.int64)
            sums += np.bincount(bins, alpha[rim], BINS + 1)
            counts += np.bincount(bins, minlength=BINS + 1)
            changed += float(((_hard(around[rim]) - alpha[rim]).astype(np.float64) ** 2).sum())
        known = np.flatnonzero(counts)
        if not len(known):
            return None
        steps = np.arange(1, BINS)
        transfer = np.interp(steps, known, sums[known] / counts[known])
        along = np.concatenate([[0.0], np.maximum.accumulate(transfer), [1.0]])
        return cls(along, changed / float(counts.sum()), max(softness, EXACT))

    def evened(self, color: np.ndarray, alpha: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Color [h, w, 3], premultiplied, and alpha [h, w] of a picture with its outline evened; float32.

        What gains alpha takes the mean colour around it, weighted by alpha; what loses some keeps its own.
        """
        whole = color.astype(np.float32), alpha.astype(np.float32)
        drawn = part_around(alpha > 0, 2 * REACH)
        for out, part in zip(whole, self._evened(color[drawn], alpha[drawn]), strict=True):
            out[drawn] = part
        return whole

    def sharpened(
        self, color: np.ndarray, alpha: np.ndarray, trust: float, lit: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """The same with more contrast about an alpha of a half, as far as the outline is trusted to lie where it
        belongs, `trust` 0..1, and until it is as sharp as the masks'.

        What gains alpha keeps its colour with `lit` of 1, and its light with 0.
        """
        contrast = 1 + trust * (CONTRAST - 1)
        if contrast > 1:
            contrast = min(contrast, softness([np.rint(alpha * 255).astype(np.uint8)]) / self.softness)
        if contrast <= 1:
            return color, alpha
        wanted = np.where(alpha > 0, np.clip((alpha - 0.5) * np.float32(contrast) + np.float32(0.5), 0, 1), 0)
        change = wanted / np.where(alpha > 0, alpha, 1)
        return color * np.where(change > 1, 1 + np.float32(lit) * (change - 1), change)[..., None], wanted

    def _evened(self, color: np.ndarray, alpha: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The same of the part of a picture that holds something."""
        around = _around(alpha)
        share = self._noise(alpha, around)
        if share <= 0:
            return color, alpha
        towards = np.interp(around, np.linspace(0, 1, BINS + 1), self.transfer)
        wanted = np.clip(alpha + share * (towards - alpha), 0, 1)
        less, more = np.minimum(wanted, alpha), np.maximum(wanted - alpha, 0)
        kept = color * (less / np.where(alpha > 0, alpha, 1))[..., None]
        beside = _around(color) / np.maximum(around, 1e-3)[..., None]
        return kept + more[..., None] * beside, wanted

    def _noise(self, alpha: np.ndarray, around: np.ndarray) -> float:
        """Part 0..1 of what evening to a hard outline changes of a picture's alpha [h, w] that the masks have not."""
        rim = _rim(around)
        if not rim.any():
            return 0.0
        changed = float(((_hard(around[rim]) - alpha[rim]).astype(np.float64) ** 2).mean())
        return max(0.0, 1 - self.shape / changed) if changed > 0 else 0.0


def outlines_for(
    camera: Camera, rig: Rig, silhouettes: Silhouettes, masks: dict[int, np.ndarray], widths: dict[int, float]
) -> Outlines | None:
    """What the masks [h, w] uint8 by view would say at the size at which a camera sees the subject, of the views that
    the silhouettes are made of; `widths`: px over which the masks as they are rise, for resizing softens them. None
    where no mask has an outline."""
    pixel = float(np.linalg.norm(camera.centre - silhouettes.centre)) / float(
        np.asarray(camera.intrinsics)[[0, 1], [0, 1]].mean()
    )
    factors = {v: own / pixel for v, own in zip(silhouettes.views, silhouettes.pixels.tolist(), strict=True)}
    risen = [factor * widths[v] for v, factor in factors.items() if widths.get(v, 0) > 0]
    return Outlines.of(
        (_resized(masks[v][: rig.size[v, 1], : rig.size[v, 0]], factor) for v, factor in factors.items()),
        float(np.median(risen)) if risen else 0.0,
    )


def _resized(mask: np.ndarray, factor: float) -> np.ndarray:
    """The part of a mask [h, w] uint8 that has an outline, `factor` times as large; at most twice, as nothing finer is
    known."""
    part = mask[part_around(mask > 0, 2 * REACH)]
    if not part.size or factor == 1:
        return part
    size = tuple(max(1, round(n * min(factor, 2.0))) for n in part.shape[::-1])
    return np.asarray(cv2.resize(part, size, interpolation=cv2.INTER_AREA if factor < 1 else cv2.INTER_LINEAR))


def _around(values: np.ndarray) -> np.ndarray:
    """[h, w, ...] float32 mean around each pixel; beyond the picture it goes on as at its edge."""
    if not values.size:
        return values.astype(np.float32)
    return np.asarray(
        cv2.GaussianBlur(values.astype(np.float32), (0, 0), WIDTH, borderType=cv2.BORDER_REPLICATE), np.float32
    )


def _rim(around: np.ndarray) -> np.ndarray:
    """[h, w] bool: at an outline."""
    return (around > RIM) & (around < 1 - RIM)


def _hard(around: np.ndarray) -> np.ndarray:
    """Coverage of a pixel by a straight hard edge, from the share around; float32."""
    return np.clip((around - 0.5) * np.float32(WIDTH * math.sqrt(2 * math.pi)) + np.float32(0.5), 0, 1)
