"""Which of the people is the subject."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posegaussian.storage.model.errors import ConfigError

EQUAL = 0.8
"""Share of the largest person's size from which on others count as large, and the one in the middle is taken."""
THERE = 0.5
"""Share of the pictures of whoever is in most of them, from which on a person may be the central one."""
PREFIX = "person"
FIELDS = ("frames", "pictures", "span", "x", "y", "z", "size", "off_centre")
"""Of a person: shares of the frames and of the pictures that show them, mean extent over the longer side of these
pictures, median middle and extent (metres; px where there is one view), distance of the middle from what the cameras
look at."""


@dataclass(frozen=True, eq=False)
class People:
    """Everybody who is followed, by the pictures that show them."""

    about: np.ndarray
    """[N, 8] see `FIELDS`."""

    def __len__(self) -> int:
        """How many."""
        return len(self.about)

    @property
    def names(self) -> list[str]:
        """person1, person2, ..."""
        return [name_of(n) for n in range(len(self))]

    @property
    def largeness(self) -> np.ndarray:
        """[N] presence times size: the share of its pictures' longer sides that a person spans, over all pictures."""
        return np.asarray(self.about[:, 1] * self.about[:, 2])

    def largest(self) -> int:
        """Whoever spans most of all pictures; of several that span about as much, the one nearest to what the cameras
        look at. -1 of nobody."""
        if not len(self):
            return -1
        large = self.largeness >= EQUAL * self.largeness.max()
        return int(np.where(large, self.about[:, 7], np.inf).argmin())

    def central(self) -> int:
        """Whoever is nearest to what the cameras look at, of those who are in about as many pictures as anybody; -1
        of nobody."""
        if not len(self):
            return -1
        there = self.about[:, 1] >= THERE * self.about[:, 1].max()
        return int(np.where(there, self.about[:, 7], np.inf).argmin())

    def told(self, unit: str) -> list[str]:
        """A sentence on everybody, distances in `unit`."""
        each = "; ".join(
            f"{name} in {a[0]:.0%} of the frames and {a[1]:.0%} of the pictures, spanning {a[2]:.0%} of their longer"
            f" side, {a[7]:.2g} {unit} from what the cameras look at"
            for name, a in zip(self.names, self.about, strict=True)
        )
        largest, central = name_of(self.largest()), name_of(self.central())
        return [f"{len(self)} people are followed: {each}; the largest is {largest}, the central one {central}"]


def name_of(number: int) -> str:
    """person1 for 0."""
    return f"{PREFIX}{number + 1}"


def chosen(setting: str, largest: int, central: int, count: int) -> int:
    """The number of the subject for `pose.subject`, -1 where there is nobody. Raises ConfigError for somebody who is
    not there, naming those who are."""
    if not count:
        return -1
    if setting in ("largest", "central"):
        return largest if setting == "largest" else central
    number = int(setting.removeprefix(PREFIX)) - 1
    if not 0 <= number < count:
        there = ", ".join(name_of(n) for n in range(count))
        raise ConfigError(
            f"pose.subject: nobody in this sequence is called {setting!r}; there {'is' if count == 1 else 'are'}"
            f" {there} (`posegaussian inspect` shows them), or use largest or central"
        )
    return number
