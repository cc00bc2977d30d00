"""LPIPS on AlexNet and on VGG16: which files of weights each needs, and what it is without them."""

from __future__ import annotations

from posegaussian.stages.metrics.measures.declaration import (
    Metric,
    MetricSettings,
    Pictures,
    Unavailable,
    Value,
    WeightFile,
    too_small,
)

FILES: dict[str, tuple[WeightFile, WeightFile]] = {
    "lpips_alex": ("alex", "alex_linear"),
    "lpips_vgg": ("vgg", "vgg_linear"),
}
"""{metric: files of its network and of its linear layers}."""


def without_weights(name: str, settings: MetricSettings) -> str | None:
    """What the settings lack for a metric, or None."""
    missing = [file for file in FILES[name] if file not in settings.lpips_weights]
    return (
        f"no weight files; give {' and '.join(f'metrics.lpips_weights.{file}' for file in missing)} with their"
        " metrics.lpips_sha256, or bring them with `posegaussian models fetch lpips`"
        if missing
        else None
    )


def _distance(name: str, pictures: Pictures, settings: MetricSettings) -> Value:
    if reason := without_weights(name, settings):
        return Unavailable(reason)
    from posegaussian.stages.metrics.measures.lpips_network import STACKS
    from posegaussian.stages.metrics.measures.lpips_weights import load_network

    small = too_small(pictures.picture, STACKS[name].smallest)
    if small:
        return small
    files = [part for file in FILES[name] for part in (settings.lpips_weights[file], settings.lpips_sha256[file])]
    return load_network(name, *files).distance(*pictures[:3])


def _metric(name: str, network: str, bytes_a_pixel: int, weights: int) -> Metric:
    """`weights`: bytes of the weight files, which are read as a whole, and of what is kept of them."""
    return Metric(
        name,
        f"LPIPS ({network})",
        "1",
        "lower",
        lambda settings: f"LPIPS 0.1, {network}, RGB -1..1; a box is cut out and measured by itself",
        bytes_a_pixel=bytes_a_pixel,
        of_region=lambda pictures, settings: _distance(name, pictures, settings),
        kept_bytes=lambda settings: 0 if without_weights(name, settings) else weights,
    )


LPIPS_ALEX = _metric("lpips_alex", "AlexNet", 200, 260 * 10**6)
LPIPS_VGG = _metric("lpips_vgg", "VGG16", 1800, 620 * 10**6)
