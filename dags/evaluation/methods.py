"""The methods that are compared: each is a name, a sentence and the settings that make it, laid over the user's own.

What a method shares with another is made once; results of all but the first, which is the configuration as it stands,
lie in variants (`dags/planning/variants.py`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from posegaussian.dags.config.settings import Configuration, from_assignments, validate
from posegaussian.dags.config.yaml_source import Document
from posegaussian.stages.rendering.params import GAUSSIANS
from posegaussian.storage.model.errors import ConfigError

OURS = "posegaussian"
"""The configuration as it stands."""
DRAWN = f"rendering.method={GAUSSIANS}"
"""Pictures of our own Gaussians, whatever the user has drawn."""
OF_HULL = ("depth.method=hull", "network.weights=none", "refinement.steps=0")
"""Settings of whatever starts from the visual hull alone."""


@dataclass(frozen=True)
class Method:
    """One line of the comparison."""

    name: str
    """As `--methods` knows it."""
    summary: str
    """What it is, in a sentence."""
    assignments: tuple[str, ...] = ()
    """`stage.key=value`, laid over everything else."""

    @property
    def different(self) -> dict[str, Any]:
        """{stage.key: value as text} of what sets it apart; it names the folder of its results."""
        return dict(a.split("=", 1) for a in self.assignments)

    def over(self, configuration: Configuration) -> Configuration:
        """The configuration with its settings on top, those of single sequences, too. Raises ConfigError."""
        if not self.assignments:
            return configuration
        own = from_assignments(self.assignments).values
        everywhere = {**own, "sequences": dict.fromkeys(configuration.overrides, own)}
        return validate((*configuration.layers, Document(f"method {self.name}", everywhere)))


def methods() -> dict[str, Method]:
    """All of them by name, in the order in which tables show them."""
    every = (
        Method(OURS, "the configuration as it stands"),
        Method(
            "fast",
            "the cheap end: depth by the sweep, no network, nothing judged",
            ("depth.method=sweep", "network.weights=none", "refinement.steps=0", DRAWN),
        ),
        Method(
            "dear",
            "the dear end: every frame refined on its own pictures, 200 steps",
            ("refinement.steps=200", "refinement.worth=0", DRAWN),
        ),
        Method(
            "pose_off",
            "the network shown no pose, by weights that a tenth of the training showed none",
            ("effects.pose_heatmaps=off", DRAWN),
        ),
        Method(
            "hull",
            "the visual hull alone as depth, no network",
            (*OF_HULL, DRAWN),
        ),
        Method(
            "ibr",
            "image-based rendering: source pictures blended over the visual hull by angle and visibility",
            (*OF_HULL, "rendering.method=ibr"),
        ),
        Method(
            "3dgs",
            "3D Gaussian splatting, fitted to each frame's source pictures from points of the visual hull, by our own"
            " rasterizer",
            (*OF_HULL, "rendering.method=3dgs"),
        ),
    )
    return {m.name: m for m in every}


def chosen(text: str | None) -> list[Method]:
    """Those of a list with commas, in its order; only ours without one. Raises ConfigError for a name that is none."""
    known = methods()
    names = [n.strip() for n in text.split(",")] if text is not None else [OURS]
    for name in names:
        if name not in known:
            told = "; ".join(f"{m.name} ({m.summary})" for m in known.values())
            raise ConfigError(f"--methods {text}: there is no method {name!r}; there are {told}")
    return [known[n] for n in dict.fromkeys(names)]
