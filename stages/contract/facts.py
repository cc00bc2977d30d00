"""Facts of a capture: short names by which stages, inputs and effects are turned on or left out.

What a capture has is named here, an effect or a stage that others look for beside the code that looks for it; the names
of all effects, optional stages and constants of a sequence are known as soon as they are declared.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Set
from dataclasses import dataclass
from typing import Any

_DECLARED: set[str] = set()


def fact(name: str) -> str:
    """Declare a name that may be among the facts, and return it."""
    _DECLARED.add(name)
    return name


@dataclass(frozen=True, eq=False, repr=False)
class Facts(Set[str]):
    """The facts that hold: a frozen set of declared names.

    A name that nobody declared raises KeyError, wherever it is put in or looked for: it would be False for ever.
    """

    names: frozenset[str] = frozenset()
    """All of them."""

    def __post_init__(self) -> None:
        for name in self.names:
            _check(name)

    def __contains__(self, name: object) -> bool:
        """Whether it holds. Raises KeyError for a name that nobody declared."""
        return name in self.names or _check(name)

    def __iter__(self) -> Iterator[str]:
        """Names in no order."""
        return iter(self.names)

    def __len__(self) -> int:
        """How many hold."""
        return len(self.names)

    def __and__(self, other: Set[Any]) -> Facts:
        """Those of some names that hold."""
        return Facts(self.names & Facts(frozenset(other)).names)

    def __or__(self, other: Set[Any]) -> Facts:
        """With some more."""
        return Facts(self.names | frozenset(other))

    def __sub__(self, other: Set[Any]) -> Facts:
        """Without some."""
        return Facts(self.names - Facts(frozenset(other)).names)

    __rand__, __ror__ = __and__, __or__

    def __hash__(self) -> int:
        """That of a set of the same names, to which it is equal."""
        return hash(self.names)

    def __repr__(self) -> str:
        """Sorted, for messages of tests."""
        return f"Facts({sorted(self.names)})"


def _check(name: object) -> bool:
    """False for a declared name; raise KeyError for another."""
    if name in _DECLARED:
        return False
    near = difflib.get_close_matches(str(name), _DECLARED, n=1)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    raise KeyError(
        f"no fact is called {name!r}{hint}: facts of a capture are declared in"
        " posegaussian.stages.contract.facts, effects and optional stages by their names"
    )


MASKS = fact("masks")
"""Masks came with every view that is worked on."""
TRUTH_DEPTH = fact("truth_depth")
"""The true depth of every view that is worked on is known: the capture is simulated."""
HELD_OUT = fact("held_out")
"""A camera is held out to measure against."""
SEVERAL_FRAMES = fact("several_frames")
"""The capture has more than one frame."""
LINEAR_LIGHT = fact("linear_light")
"""Pictures of a source view came as linear light, in EXR files."""
JOINTS2D = fact("joints2d")
"""2D joints are known, given or estimated."""
JOINTS3D = fact("joints3d")
"""3D joints came with the capture."""
SINGLE_SOURCE = fact("single_source")
"""There is one source view only."""
FEW_SOURCES = fact("few_sources")
"""There are fewer than three source views: none can be left out and drawn from two others."""
REFINING = fact("refining")
"""Gaussians are to be optimised on their frame's own pictures."""
GIVEN_JOINTS = fact("given_joints")
"""Joints came with the capture, 2D ones of a source view or 3D ones."""
GIVEN_DEPTH = fact("given_depth")
"""Every source view came with depth maps to reconstruct from."""
BLAZEPOSE = fact("blazepose")
"""BlazePose's models are in the cache and what runs them is installed."""
ESTIMATED = fact("detected")
"""Joints are estimated from the pictures."""
TRACKED = fact("tracked")
"""Pictures may show several people, who are followed through the sequence."""
SEGMENTED = fact("segmented")
"""The estimator segments the person it finds."""
