"""The tangent frame that follows from a normal:
the smallest rotation, so that neighbours never twist against each other."""

from __future__ import annotations

from typing import Any, TypeAlias

Values: TypeAlias = Any
"""numpy arrays or torch tensors alike: only + - * / are used."""


def tangents(nx: Values, ny: Values, nz: Values) -> tuple[tuple[Values, Values, Values], tuple[Values, Values, Values]]:
    """Two unit tangents (components in camera axes) of unit normals that face the camera.

    The rotation about (0, 0, -1) x n that takes (0, 0, -1) to n takes the camera's x axis to the first tangent and its
    -y axis to the second, so (first, second, normal) is right-handed. It is singular only for n = (0, 0, 1), which
    looks away from the camera.
    """
    k = 1 / (1 - nz)
    xy = k * nx * ny
    return (1 - k * nx * nx, -xy, nx), (xy, k * ny * ny - 1, -ny)
