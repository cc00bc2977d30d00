"""An estimator that knows its answers, and pictures that say which one they are: detection without models."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from posegaussian.stages.estimators.interface import Found
from posegaussian.stages.imaging.regions import to_own


class Numbered:
    """`posegaussian.stages.contract.io.PictureReader`: the picture of frame f in view v is filled with (f, v, 0)."""

    def __init__(self, frames: int, size: tuple[int, int], missing: Sequence[tuple[int, int]] = ()) -> None:
        self._frames, self._size, self._missing = frames, size, set(missing)

    def numbers(self, view: int) -> np.ndarray:
        return np.array([f for f in range(self._frames) if (f, view) not in self._missing])

    def size(self, view: int) -> tuple[int, int]:
        return self._size

    def identity(self, view: int, number: int) -> str:
        return f"{view} {number}"

    def read(self, view: int, numbers: Sequence[int]) -> Iterator[np.ndarray]:
        for n in numbers:
            assert (n, view) not in self._missing, f"frame {n} of view {view} was read"
            yield np.full((self._size[1], self._size[0], 3), (n, view, 0), np.uint8)


def bell(joints: np.ndarray, region: np.ndarray, cells: float = 1.5) -> np.ndarray:
    """[17, 64, 64] float16: a Gaussian of `cells` at each joint [17, 2+] px over the region."""
    own = to_own(joints[:, :2], region) * 64 - 0.5
    y, x = np.mgrid[:64, :64]
    return np.exp(-((x - own[:, 0, None, None]) ** 2 + (y - own[:, 1, None, None]) ** 2) / (2 * cells**2)).astype(
        np.float16
    )


@dataclass(eq=False)
class Actor:
    """Finds in frame f of view v the people[f][v] (each [17, 3] px), and in a region the one of `everybody` whose
    middle is nearest to its centre."""

    people: list[list[list[np.ndarray]]]
    everybody: list[list[list[np.ndarray]]]
    joint_set: str = "coco17"
    asked: list[tuple[str, int, int]] = field(default_factory=list)

    def find(self, picture: np.ndarray, most: int) -> Found:
        f, v = (int(n) for n in picture[0, 0, :2])
        self.asked.append(("find", f, v))
        return self._found([(j, self._region(j)) for j in self.people[f][v]][:most])

    def look(self, picture: np.ndarray, regions: np.ndarray) -> Found:
        f, v = (int(n) for n in picture[0, 0, :2])
        self.asked.append(("look", f, v))
        nearest = [
            min(self.everybody[f][v], key=lambda j: float(np.linalg.norm(j[:, :2].mean(axis=0) - r[:2])))
            for r in regions
        ]
        return self._found(list(zip(nearest, regions, strict=True)))

    @staticmethod
    def _region(joints: np.ndarray) -> np.ndarray:
        return np.array([*joints[:, :2].mean(axis=0), 1.5 * float(np.ptp(joints[:, :2], axis=0).max()), 0.1])

    @staticmethod
    def _found(people: list[tuple[np.ndarray, np.ndarray]]) -> Found:
        if not people:
            return Found.nobody(17)
        joints, regions = (np.stack(part).astype(np.float32) for part in zip(*people, strict=True))
        maps = np.stack([bell(j, r) for j, r in zip(joints, regions, strict=True)])
        return Found(
            joints,
            regions,
            maps,
            np.full((len(people), 256, 256), 200, np.uint8),
            np.linspace(0.9, 0.5, len(people), dtype=np.float32),
        )
