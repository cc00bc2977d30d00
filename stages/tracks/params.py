"""Settings of the tracks stage."""

from posegaussian.stages.contract.declaration import Params, setting

LONGEST = 1024
"""Longer side, px, of the cameras in which people are compared, whatever `frames.size` says."""


class TracksParams(Params):
    """How people are followed."""

    gap: float = setting(
        0.5,
        "Longest time for which a person out of sight is looked for where they went; after it, by looks. Where frames"
        " usually lie farther apart, 1.5 times as long as that.",
        unit="s",
        ge=0,
        le=30,
    )
