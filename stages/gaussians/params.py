"""Settings of the gaussians stage."""

from __future__ import annotations

from posegaussian.stages.contract.declaration import Params, setting


class GaussiansParams(Params):
    """How large and how opaque the prior's Gaussians are. Defaults by measurement: true depth, 8 views at 512 px,
    held-out middle views."""

    footprint: float = setting(
        0.5, "Standard deviation of a Gaussian, in pixels of its own view.", unit="px", gt=0, le=4
    )
    thickness: float = setting(0.1, "Scale along the normal, as a share of the footprint.", gt=0, le=1)
    opacity: float = setting(0.99, "Opacity of a Gaussian of full confidence in a fully covered pixel.", gt=0, lt=1)
    grazing: float = setting(0.8, "Opacity at grazing angle, as a share of the one face-on.", ge=0, le=1)
    cosine_min: float = setting(
        0.5,
        "Cosine between normal and ray below which a Gaussian is not stretched further along the slope.",
        gt=0,
        le=1,
    )
    confidence_power: float = setting(
        0.1,
        "Exponent of the depth's confidence in the opacity: 0 ignores it, 1 makes unsure surfaces transparent.",
        ge=0,
        le=4,
    )
    confidence_min: float = setting(0.05, "Confidence of the depth below which a pixel makes no Gaussian.", ge=0, le=1)
