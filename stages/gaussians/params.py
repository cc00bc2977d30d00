"""Settings of the gaussians stage."""

from __future__ import annotations

from stages.contract import Params, setting


class GaussiansParams(Params):
    """How large and how opaque the prior's Gaussians are."""

    footprint: float = setting(0.5, "Standard deviation of a Gaussian, in pixels of its own view.", unit="px", gt=0, le=4)
    thickness: float = setting(0.3, "Scale along the normal, as a share of the footprint.", gt=0, le=1)
    opacity: float = setting(0.95, "Opacity of a Gaussian of full confidence.", gt=0, lt=1)
