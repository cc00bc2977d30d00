"""Things in hands: a helmet held by its rim, a bag by its handle, a board by its edge; they turn with the hand."""

from __future__ import annotations

import numpy as np

from posegaussian.stages.simulator.render.mesh import Mesh, joined
from posegaussian.stages.simulator.subjects.bodies import Body
from posegaussian.stages.simulator.subjects.shells import BLANK, painted
from posegaussian.stages.simulator.subjects.skeleton import BONES
from posegaussian.stages.simulator.wardrobe.description import Carried
from posegaussian.stages.simulator.wardrobe.materials import MATERIALS, three

TEXELS = 256
"""Side of a thing's texture."""


def _grid(points: np.ndarray) -> Mesh:
    """A surface from points [n, m, 3], its texture spread over the grid."""
    n, m, _ = points.shape
    ids = np.arange(n * m).reshape(n, m)
    a, b, c, d = ids[:-1, :-1], ids[:-1, 1:], ids[1:, :-1], ids[1:, 1:]
    tris = np.concatenate([np.stack(t, axis=-1).reshape(-1, 3) for t in ((a, b, c), (b, d, c))])
    # a texel free at the border: the texture's neighbours there are its own
    u, v = np.meshgrid(np.linspace(0.01, 0.99, m), np.linspace(0.01, 0.99, n))
    uv = np.stack([u, v], axis=-1).reshape(-1, 2)[tris]
    return Mesh(
        points.reshape(-1, 3),
        tris.astype(np.int32),
        uv.astype(np.float32),
        np.zeros(len(tris), np.int32),
        (BLANK,),
        np.zeros((n * m, 4), np.int64),
        np.tile([1.0, 0.0, 0.0, 0.0], (n * m, 1)),
        np.zeros(n * m),
    )


def _power(x: np.ndarray, exponent: float) -> np.ndarray:
    return np.sign(x) * np.abs(x) ** exponent


def _block(centre: tuple[float, float, float], half: tuple[float, float, float], roundness: float) -> Mesh:
    """A superellipsoid: 1 an ellipsoid, towards 0 a box."""
    v, u = np.meshgrid(np.linspace(-0.5 * np.pi, 0.5 * np.pi, 25), np.linspace(-np.pi, np.pi, 49), indexing="ij")
    unit = np.stack(
        [
            _power(np.cos(v), roundness) * _power(np.cos(u), roundness),
            _power(np.cos(v), roundness) * _power(np.sin(u), roundness),
            _power(np.sin(v), roundness),
        ],
        axis=-1,
    )
    return _grid(np.array(centre) + unit * np.array(half))


def _bowl(half: tuple[float, float, float], top: float, bottom: float, inwards: bool = False) -> Mesh:
    """The part of an ellipsoid about the origin between two shares of its height."""
    v, u = np.meshgrid(
        np.linspace(np.arcsin(bottom), np.arcsin(top), 17), np.linspace(-np.pi, np.pi, 41), indexing="ij"
    )
    points = np.stack([np.cos(v) * np.cos(u), np.cos(v) * np.sin(u), np.sin(v)], axis=-1) * np.array(half)
    return _grid(points[:, ::-1] if inwards else points)


def _tube(along: np.ndarray, radius: float) -> Mesh:
    """A tube of a radius around a line of points [n, 3] in a plane of constant y."""
    ahead = np.gradient(along, axis=0)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    side = np.array([0.0, 1.0, 0.0])
    turn = np.linspace(-np.pi, np.pi, 13)[None, :, None]
    return _grid(along[:, None] + radius * (np.cos(turn) * side + np.sin(turn) * np.cross(ahead, side)[:, None]))


def _parts(thing: str) -> list[tuple[Mesh, bool]]:
    """(surface, whether it is trim) around the grip at the origin, metres: x forwards, y away from the body, z up."""
    if thing == "helmet":  # crown down, as one holds it by the rim
        outer, inner = (0.135, 0.110, 0.155), (0.125, 0.100, 0.145)
        rim = [_bowl(outer, 1.0, -0.12), _bowl(inner, 1.0, -0.12, inwards=True)]
        band = _bowl((0.139, 0.114, 0.159), 0.16, -0.13)
        crest = _block((0.0, 0.0, 0.145), (0.13, 0.010, 0.035), 0.6)
        turned = [(rim[0], False), (rim[1], True), (band, True), (crest, True)]
        return [(_moved(m, np.array([1.0, -1.0, -1.0]), np.array([0.0, 0.05, -0.035])), t) for m, t in turned]
    if thing == "bag":
        a = np.linspace(0.0, np.pi, 19)
        handle = np.stack([0.085 * np.cos(a), np.zeros_like(a), -0.115 + 0.125 * np.sin(a)], axis=1)
        return [(_block((0.0, 0.0, -0.25), (0.19, 0.065, 0.135), 0.35), False), (_tube(handle, 0.010), True)]
    edge = _block((0.05, 0.0, -0.07), (0.40, 0.010, 0.105), 0.25)
    wheels = [_block((x, 0.03, -0.07), (0.028, 0.022, 0.06), 0.6) for x in (-0.2, 0.3)]
    return [(edge, False), *((w, True) for w in wheels)]


def _moved(mesh: Mesh, sign: np.ndarray, shift: np.ndarray) -> Mesh:
    return Mesh(
        mesh.vertices * sign + shift,
        mesh.tris,
        mesh.uv,
        mesh.layer,
        mesh.textures,
        mesh.bones,
        mesh.weights,
        mesh.slack,
    )


def carried(body: Body, thing: Carried) -> Mesh:
    """What a hand holds, at rest: it hangs as the forearm points, and follows the hand's bone alone."""
    side = thing.hand + "_"
    hand = body.vertices[body.bone(side + "hand") > 0.5]
    down = body.pivot(side + "hand") - body.pivot(side + "forearm")
    down /= np.linalg.norm(down)
    away = np.array([0.0, 1.0 if thing.hand == "left" else -1.0, 0.0])
    away -= down * (away @ down)
    away /= np.linalg.norm(away)
    ahead = np.cross(away, -down)
    ahead *= np.sign(ahead[0])
    frame = np.stack([ahead, away, -down])
    outwards = 1 if np.linalg.det(frame) > 0 else -1  # a mirrored frame turns surfaces inside out
    made, ground = MATERIALS[thing.material], three(thing.colors)
    out = []
    for mesh, trim in _parts(thing.thing):
        mesh = painted(
            body,
            mesh,
            "plain" if trim else thing.pattern,
            (ground[1],) * 3 if trim else ground,
            thing.scale,
            made.gloss,
            made.exponent,
            TEXELS,
            made.sheen,
        )
        bones = np.full_like(mesh.bones, BONES.index(side + "hand"))
        out.append(
            Mesh(
                mesh.vertices @ frame + hand.mean(axis=0),
                np.ascontiguousarray(mesh.tris[:, ::outwards]),
                np.ascontiguousarray(mesh.uv[:, ::outwards]),
                mesh.layer,
                mesh.textures,
                bones,
                mesh.weights,
                mesh.slack,
            )
        )
    return joined(out)
