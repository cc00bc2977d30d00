"""Dressing a baked body: garments, shoes and hair are shells over the skin, cut along smooth hems; skin below is left
out.

A shell is the skin's own surface, smoothed until it no longer follows every muscle, pushed out along its normals, never
closer to the skin than a few millimetres. A field that is positive inside says how far it reaches.
"""

from __future__ import annotations

import dataclasses
from functools import lru_cache

import numpy as np

from posegaussian.stages.simulator.render.mesh import Mesh, Texture, clipped, joined
from posegaussian.stages.simulator.render.patterns import PATTERNS, texture
from posegaussian.stages.simulator.render.raster import vertex_normals
from posegaussian.stages.simulator.render.texture import noise
from posegaussian.stages.simulator.subjects.bodies import EYE_VERTICES, Body, load_body
from posegaussian.stages.simulator.subjects.outfits import LOOKS, OUTFITS, Appearance, Garment, Outfit, Rgb
from posegaussian.stages.simulator.subjects.shoes import shoes
from posegaussian.stages.simulator.subjects.skeleton import SIDES

ARM, LEG = ("upper_arm", "forearm", "hand"), ("thigh", "shin", "foot")
TEXELS = 1024
"""Side of a layer's texture: about 2 mm a texel on the body."""
TUCK = 0.03
"""Metres under a hem where skin or cloth below is no longer drawn."""
WAIST = 0.09
"""Metres that trousers reach up under the hem of a top."""


def _smoothed(values: np.ndarray, edges: np.ndarray, weight: np.ndarray, rounds: int) -> np.ndarray:
    """Laplacian smoothing over the vertices with weight > 0;
    each moves by `weight` of the way to its neighbours' mean."""
    own = edges[(weight[edges] > 0).all(axis=1)]
    a, b = np.concatenate([own[:, 0], own[:, 1]]), np.concatenate([own[:, 1], own[:, 0]])
    count = np.maximum(np.bincount(a, minlength=len(values)), 1)[:, None]
    linked = np.bincount(a, minlength=len(values)) > 0
    out = values.copy()
    for _ in range(rounds):
        mean = np.stack([np.bincount(a, out[b, k], minlength=len(values)) for k in range(3)], axis=1) / count
        out = np.where(linked[:, None], out + weight[:, None] * (mean - out), out)
    return out


def _noise(points: np.ndarray, cell: float, shift: float) -> np.ndarray:
    return np.array([noise(x + shift, y, z) for x, y, z in points / cell]) - 0.5


def _shell(
    body: Body, inside: np.ndarray, offset: np.ndarray, rounds: int, wrinkles: float, follows: np.ndarray | float = 1.0
) -> np.ndarray:
    """[V, 3] the skin smoothed and pushed out by `offset` metres, where it `follows` (0..1) nowhere nearer than a
    third of it."""
    region = (inside > -0.06).astype(np.float64)
    smooth = _smoothed(body.vertices, body.edges, 0.5 * region, rounds)
    used = body.tris[(inside[body.tris] > -0.08).any(axis=1)]
    out_of_skin, out = vertex_normals(body.vertices, body.tris), vertex_normals(smooth, used)
    if wrinkles:
        p = body.vertices * np.array([1.0, 1.0, 1.6])
        offset = offset + wrinkles * (np.abs(_noise(p, 0.075, 0.0)) * -2.0 + 0.5 + _noise(p, 0.03, 11.0))
    pushed = smooth + out * offset[:, None]
    short = np.maximum(0.35 * offset, 0.004) - np.einsum("vk,vk->v", pushed - body.vertices, out_of_skin)
    pushed += out_of_skin * (follows * np.maximum(short, 0.0))[:, None]
    return _smoothed(pushed, body.edges, 0.35 * region, 2)


def _cut(body: Body, vertices: np.ndarray, inside: np.ndarray, layer: Texture, slack: np.ndarray) -> Mesh:
    """The part of a shell where the field is positive, as a mesh of its own."""
    parent, corners, tris = clipped(inside, body.tris)
    flat = corners.reshape(-1, 3)
    owners = np.repeat(tris, 3, axis=0)
    ranked = np.where(flat > 0, owners, -1)
    low_rank = np.argsort(ranked, axis=1, kind="stable")
    ids = np.take_along_axis(ranked, low_rank, axis=1)[:, 1:]
    part = np.take_along_axis(flat, low_rank, axis=1)[:, 1:]
    single = ids[:, 0] < 0
    ids[single, 0], part[single, 0] = ids[single, 1], 0.0
    _, first, back = np.unique(ids[:, 0] * (len(vertices) + 1) + ids[:, 1], return_index=True, return_inverse=True)
    a, b, s, t = ids[first, 0], ids[first, 1], part[first, :1], part[first, 1:]

    def blend(values: np.ndarray) -> np.ndarray:
        return s * values[a] + t * values[b]

    uv = np.einsum("nij,njk->nik", corners, body.uv[parent]).astype(np.float32)
    bones, weights = _strongest(blend(body.weights))
    return Mesh(
        blend(vertices),
        back.reshape(-1, 3).astype(np.int32),
        uv,
        np.zeros(len(parent), np.int32),
        (layer,),
        bones,
        weights,
        blend(slack[:, None])[:, 0],
    )


def _strongest(weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """[V, 4] bones and [V, 4] weights from [V, B]."""
    index = np.argsort(-weights, axis=1, kind="stable")[:, :4]
    best = np.take_along_axis(weights, index, axis=1)
    return index, best / best.sum(axis=1, keepdims=True)


def linear(color: Rgb | tuple[float, float, float]) -> np.ndarray:
    """[3] linear reflectance of an sRGB colour in bytes (IEC 61966-2-1)."""
    c = np.array(color, dtype=np.float64) / 255.0
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def _marks(body: Body) -> np.ndarray:
    """[4, 3] nose, eyes, and 1 / size of the head relative to an adult's, whose eyes are 64 mm apart."""
    apart = np.linalg.norm(body.joints[1] - body.joints[2])
    return np.stack([*body.joints[:3], [0.064 / apart, 0.0, 0.0]])


def _painted(
    body: Body,
    mesh: Mesh,
    pattern: str,
    colors: tuple[Rgb, Rgb, Rgb],
    scale: float,
    gloss: float,
    exponent: float = 20.0,
    texels: int = TEXELS,
) -> Mesh:
    picture = texture(
        PATTERNS.index(pattern),
        np.stack([linear(c) for c in colors]),
        scale,
        _marks(body),
        mesh.vertices,
        mesh.tris,
        mesh.uv,
        texels,
    )
    return Mesh(
        mesh.vertices,
        mesh.tris,
        mesh.uv,
        mesh.layer,
        (Texture(picture, gloss, exponent),),
        mesh.bones,
        mesh.weights,
        mesh.slack,
    )


BLANK = Texture(np.zeros((1, 1, 3), np.float32))


def upper_field(body: Body, garment: Garment) -> np.ndarray:
    """[V] metres inside a top: from the neck to below the waist, along the arms as far as the sleeves."""
    sleeve = body.limb_length(ARM, garment.length) - body.along(ARM)
    hem = np.where(body.arms > 0.5, 1.0, body.vertices[:, 2] - (body.pivot("left_thigh")[2] + 0.02))
    tilt = np.array([0.55, 0.0, 1.0]) / np.hypot(0.55, 1.0)
    neck = (body.pivot("neck") - body.vertices) @ tilt + 0.022
    # below the chin the plane of the collar would also cut the shoulders of a tilted neck
    return np.minimum(np.minimum(sleeve, hem), neck)


def lower_field(body: Body, garment: Garment) -> np.ndarray:
    """[V] metres inside trousers: from the waist, well under a top's hem, along the legs."""
    leg = body.limb_length(LEG, garment.length) - body.along(LEG)
    waist = body.pivot("left_thigh")[2] + 0.02 + WAIST - body.vertices[:, 2]
    return np.where(body.arms > 0.3, -1.0, np.minimum(leg, waist))


def _upper(body: Body, garment: Garment) -> tuple[Mesh, np.ndarray]:
    inside = upper_field(body, garment)
    reach = np.maximum(body.along(ARM), 0.0) / body.limb_length(ARM, 2.0)
    belly = np.clip((body.pivot("chest")[2] - body.vertices[:, 2]) / 0.25, 0.0, 1.0) * (body.arms < 0.3)
    offset = garment.loose * (1.0 + 0.6 * belly + 0.2 * reach) + 0.003
    # where trousers are underneath there is less room to swing
    over = np.clip((body.pivot("left_thigh")[2] + 0.06 + WAIST - body.vertices[:, 2]) / 0.04, 0.0, 1.0) * (
        body.arms < 0.3
    )
    slack = offset * np.clip(0.3 + belly, 0.0, 1.0) * (1.0 - 0.7 * over)
    vertices = _shell(body, inside, offset, 34, 0.5 * garment.loose)
    return _cut(body, vertices, inside, BLANK, slack), inside


def _lower(body: Body, garment: Garment) -> tuple[Mesh, np.ndarray]:
    inside = lower_field(body, garment)
    down = np.clip(body.along(LEG) / body.limb_length(LEG, 2.0), 0.0, 1.0)
    offset = garment.loose * (0.7 + 1.2 * down) + 0.002
    vertices = _shell(body, inside, offset, 20, 0.45 * garment.loose)
    return _cut(body, vertices, inside, BLANK, offset * down), inside


def _foot_field(body: Body) -> np.ndarray:
    """[V] metres below the rim of the shoes."""
    feet = body.bone(*(s + b for s in SIDES for b in ("foot", "toes", "shin"))) > 0.5
    return np.where(feet, body.pivot("left_foot")[2] + TUCK - 0.005 - body.vertices[:, 2], -1.0)


def _hair(body: Body, look: Appearance) -> tuple[Mesh, np.ndarray]:
    size = 1.0 / _marks(body)[3, 0]
    ear, eye, nose = body.joints[3:5].mean(axis=0), body.joints[1:3].mean(axis=0), body.joints[0]
    p = (body.vertices - ear) / size
    front = (nose[0] - ear[0]) / size
    brow = (eye[2] - ear[2]) / size + 0.060
    back = {"short": -0.035, "bob": -0.085, "long": -0.19}[look.style]
    side = {"short": 0.030, "bob": -0.045, "long": -0.10}[look.style]
    line = np.interp(
        p[:, 0],
        [-0.12, -0.045, -0.012, 0.022, 0.045, front - 0.03, front + 0.02],
        [back, back, side, 0.045 if look.style == "short" else 0.035, 0.055, brow, brow + 0.01],
    )
    head = body.bone("head", "neck", *(("chest",) if look.style == "long" else ())) > 0.5
    inside = np.where(head, (p[:, 2] - line) * size, -1.0)
    inside[-EYE_VERTICES:] = -1.0
    if look.style == "long":
        inside = np.where(np.abs(p[:, 1]) > 0.085 + 0.1 * (p[:, 2] > -0.02), -1.0, inside)
    thick = {"short": 0.014, "bob": 0.028, "long": 0.026}[look.style]
    offset = np.minimum(thick, 0.003 + 0.55 * np.maximum(inside, 0.0)) + 0.006 * _noise(body.vertices, 0.035, 3.0) * (
        inside > 0.01
    )
    # hair lies over the ears, not along their folds
    ears = np.minimum(*(np.linalg.norm(body.vertices - e, axis=1) for e in body.joints[3:5])) / size < 0.055
    vertices = _shell(body, inside, offset, 8 if look.style == "short" else 30, 0.0, 1.0 - 1.0 * ears)
    return _cut(body, vertices, inside, BLANK, np.zeros(len(vertices))), np.where(ears, inside + TUCK, inside)


def _without(mesh: Mesh, hidden: np.ndarray) -> Mesh:
    """The mesh less the triangles marked; vertices stay."""
    return Mesh(
        mesh.vertices,
        mesh.tris[~hidden],
        mesh.uv[~hidden],
        mesh.layer[~hidden],
        mesh.textures,
        mesh.bones,
        mesh.weights,
        mesh.slack,
    )


def _skin(body: Body, look: Appearance, covered: np.ndarray) -> list[Mesh]:
    """Skin that shows, and the eyes."""
    everything = np.ones(len(body.vertices))
    eyes = np.all(body.tris >= len(body.vertices) - EYE_VERTICES, axis=1)
    hidden = np.all(covered[body.tris] > TUCK, axis=1)
    whole = _cut(body, body.vertices, everything, BLANK, np.zeros(len(everything)))
    r, g, b = look.skin
    balls = _without(whole, ~eyes)
    low = balls.uv.min(axis=(0, 1))
    # in the body's atlas an iris has two texels
    balls = dataclasses.replace(balls, uv=(balls.uv - low) / (balls.uv.max(axis=(0, 1)) - low))
    lips, brows = (
        (int(0.82 * r), int(0.58 * g), int(0.60 * b)),
        tuple(int(0.6 * c + 0.08 * s) for c, s in zip(look.hair, look.skin, strict=True)),
    )
    return [
        _painted(body, _without(whole, eyes | hidden), "skin", (look.skin, lips, brows), 0.1, 0.035, 12.0),  # type: ignore[arg-type]
        _painted(body, balls, "eye", ((206, 202, 198), (84, 62, 44), (10, 10, 12)), 0.1, 0.10, 80.0, 128),
    ]


@lru_cache(maxsize=4)
def dressed(subject: str, outfit: str) -> Mesh:
    """A baked subject in an outfit, at rest, standing on its soles at z = -SOLE. Raises KeyError for unknown names."""
    body, look, clothes = load_body(subject), LOOKS[subject], OUTFITS[outfit]
    return _assembled(body, look, clothes)


def _assembled(body: Body, look: Appearance, clothes: Outfit) -> Mesh:
    upper, in_upper = _upper(body, clothes.upper)
    lower, in_lower = _lower(body, clothes.lower)
    hair, in_hair = _hair(body, look)
    covered = np.maximum.reduce([in_upper, in_lower, _foot_field(body), in_hair])
    uppers, soles = (
        Texture(np.broadcast_to(linear(c), (1, 1, 3)).astype(np.float32), g, 30.0)
        for c, g in ((clothes.shoes, 0.08), (clothes.sole, 0.03))
    )
    return joined(
        [
            *_skin(body, look, covered),
            _painted(
                body, upper, clothes.upper.pattern, clothes.upper.colors, clothes.upper.scale, clothes.upper.gloss
            ),
            _painted(
                body, lower, clothes.lower.pattern, clothes.lower.colors, clothes.lower.scale, clothes.lower.gloss
            ),
            shoes(body, uppers, soles),
            _painted(body, hair, "hair", (look.hair,) * 3, 0.1, 0.06, 25.0),
        ]
    )
