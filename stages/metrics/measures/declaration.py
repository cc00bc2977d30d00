"""What a metric declares: the setting, the memory, the table's definitions and the trade-off's figures follow from it.

Declarations are read wherever settings are, so a metric imports what it computes with inside its function.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal, NamedTuple, Protocol

import numpy as np

WeightFile = Literal["alex", "alex_linear", "vgg", "vgg_linear"]


class MetricSettings(Protocol):
    """The settings of the stage that a metric may look at: `posegaussian.stages.metrics.params.MetricsParams` has them,
    each with its sentence."""

    @property
    def psnr_cap(self) -> float:
        """PSNR of identical pictures, dB."""

    @property
    def flip_pixels_per_degree(self) -> float:
        """Pixels in a degree of the viewer's eye."""

    @property
    def lpips_weights(self) -> Mapping[WeightFile, str]:
        """Paths of weight files."""

    @property
    def lpips_sha256(self) -> Mapping[WeightFile, str]:
        """The sha256 of each."""


class Pictures(NamedTuple):
    """What is compared."""

    picture: np.ndarray
    """[h, w, 3] float64, 0..data_range, sRGB: as rendered, premultiplied on black."""
    truth: np.ndarray
    """[h, w, 3] float64: as filmed, on black as well."""
    data_range: float
    visible: np.ndarray | None = None
    """[h, w] bool: pixels that count, where the subject stands partly behind something; both pictures are black in the
    others. None: all."""

    def region(self, at: tuple[slice, slice]) -> Pictures:
        """Rows and columns of it."""
        visible = None if self.visible is None else self.visible[at]
        return Pictures(self.picture[at], self.truth[at], self.data_range, visible)


@dataclass(frozen=True)
class Unavailable:
    """Stands where a number would be."""

    reason: str
    """What is missing, and what to do."""


Value = float | Unavailable
OfRegion = Callable[[Pictures, MetricSettings], Value]
"""One number of the pictures of one region, cut out."""
OfPixels = Callable[[Pictures, MetricSettings], np.ndarray]
"""[h, w] of the full pictures; a region's value is the mean over its visible pixels."""


def nothing(settings: MetricSettings) -> str | None:
    """The answer of a metric that lacks nothing."""
    return None


def no_bytes(settings: MetricSettings) -> int:
    """Of a metric that keeps nothing from picture to picture."""
    return 0


@dataclass(frozen=True)
class Metric:
    """One measure of a picture against its truth. It has one of `of_region`, `of_pixels` and `change_of`."""

    name: str
    """As in `metrics.measures` and in the table."""
    title: str
    """As figures name it."""
    unit: str
    """"1" where there is none."""
    better: Literal["higher", "lower"]
    """Which values are good."""
    definition: Callable[[MetricSettings], str]
    """What exactly it is, for the rows of the table."""
    bytes_a_pixel: int
    """Working memory, as `benchmarks/metrics_time.py` finds it; one metric is taken after the other."""
    of_region: OfRegion | None = None
    """Measures each region by itself."""
    of_pixels: OfPixels | None = None
    """Measures the full picture once."""
    change_of: str | None = None
    """The metric whose change from the frame before it is."""
    refusal: Callable[[MetricSettings], str | None] = nothing
    """Why it cannot be measured at all, with what to do, or None."""
    kept_bytes: Callable[[MetricSettings], int] = no_bytes
    """Bytes it holds whatever the picture's size."""
    traded: bool = False
    """Whether `tradeoff` weighs it against seconds."""


def too_small(picture: np.ndarray, smallest: int) -> Unavailable | None:
    """Of a picture [h, w, ...] with a side below `smallest` px."""
    h, w = picture.shape[:2]
    return Unavailable(f"a region of less than {smallest} px height or width") if min(h, w) < smallest else None
