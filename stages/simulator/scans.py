"""Textured scans: Wavefront OBJ as THuman2.0, Twindom and most scanners write it.

Not read by trimesh (5.2): it counts negative indices from the end of the file instead of from the face, has one texture
place a vertex or takes vertices apart at seams, drops all places where one corner has none, sorts faces by material,
takes index 0 for a vertex, and names no line of what it cannot read.
"""

from __future__ import annotations

import numpy as np

from posegaussian.stages.simulator.render.light import decode
from posegaussian.stages.simulator.render.mesh import Mesh, Texture
from posegaussian.stages.simulator.scene import Scan
from posegaussian.stages.simulator.subjects.motion import turn


def parse_obj(text: str) -> tuple[np.ndarray, np.ndarray, np.ndarray, str | None]:
    """Vertices [V, 3], tris [T, 3], uv [T, 3, 2] (0 where a corner has none) and the name of the material file, or
    None.

    Polygons become fans; indices may be negative. Raises ValueError with the line number for what cannot be read.
    """
    points: list[list[float]] = []
    places: list[list[float]] = [[0.0, 0.0]]
    corners: list[tuple[tuple[int, int], ...]] = []
    material = None
    for number, line in enumerate(text.splitlines(), 1):
        word, *rest = line.split() or [""]
        try:
            if word == "v":
                points.append([float(x) for x in rest[:3]])
            elif word == "vt":
                places.append([float(x) for x in rest[:2]])
            elif word == "f":
                face = [_corner(c, len(points), len(places) - 1) for c in rest]
                corners += [(face[0], face[k], face[k + 1]) for k in range(1, len(face) - 1)]
            elif word == "mtllib" and rest:
                material = line.split(maxsplit=1)[1].strip()
        except (ValueError, IndexError) as e:
            raise ValueError(f"line {number}: cannot read {line.strip()!r} ({e})") from e
    if not points or not corners:
        raise ValueError(f"{len(points)} vertices and {len(corners)} triangles: there is nothing to film")
    index = np.array(corners, dtype=np.int64)
    if index[..., 0].max() >= len(points) or index[..., 1].max() >= len(places) or index.min() < 0:
        raise ValueError("a face names a vertex or a texture place that does not exist")
    return np.array(points), index[..., 0], np.array(places, dtype=np.float32)[index[..., 1]], material


def _corner(text: str, points: int, places: int) -> tuple[int, int]:
    """(vertex from 0, texture place from 1; 0 = none) of `7`, `7/3`, `7//2` or `7/3/2`."""
    v, _, rest = text.partition("/")
    t = rest.partition("/")[0]
    vertex, place = int(v), int(t) if t else 0
    return vertex - 1 if vertex > 0 else points + vertex, place if place >= 0 else places + 1 + place


def texture_name(material: str) -> str | None:
    """File that the first `map_Kd` of a material file names; None without one."""
    for line in material.splitlines():
        if line.strip().startswith("map_Kd"):
            return line.split()[-1]
    return None


_TO_OURS = {
    "z": np.eye(3),
    "y": np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]]),
    "x": np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]]),
}


def scan_mesh(vertices: np.ndarray, tris: np.ndarray, uv: np.ndarray, picture: np.ndarray | None, scan: Scan) -> Mesh:
    """A scan stood on the ground above the origin, in metres, Z up: v' = (v - translation) / scale, turned upright,
    then `height`.

    picture [h, w, 3] uint8 sRGB; without one the scan is grey.
    """
    v = ((vertices - np.array(scan.translation)) / scan.scale) @ _TO_OURS[scan.up].T
    if scan.height is not None:
        v = v * (scan.height / np.ptp(v[:, 2]))
    low, high = v.min(axis=0), v.max(axis=0)
    v = (v - [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]]) @ turn("z", np.deg2rad(scan.heading)).T
    albedo = np.full((1, 1, 3), 0.4, np.float32) if picture is None else decode(picture / 255.0)
    bones, weights = np.zeros((len(v), 4), np.int64), np.tile([1.0, 0, 0, 0], (len(v), 1))
    return Mesh(
        v,
        tris.astype(np.int32),
        uv.astype(np.float32),
        np.zeros(len(tris), np.int32),
        (Texture(albedo, 0.03),),
        bones,
        weights,
        np.zeros(len(v)),
    )
