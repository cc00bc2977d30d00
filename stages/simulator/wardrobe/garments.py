"""Dressing a baked body: garments, shoes and hair are shells over the skin, cut along smooth hems; skin below is left
out.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np

from posegaussian.stages.simulator.render.mesh import Mesh, Texture, joined
from posegaussian.stages.simulator.subjects.bodies import EYE_VERTICES, Body, load_body
from posegaussian.stages.simulator.subjects.outfits import LOOKS, OUTFITS, Appearance, Garment, Outfit
from posegaussian.stages.simulator.subjects.shells import Shell, cut, linear, marks, noise_at, painted, shell
from posegaussian.stages.simulator.subjects.shoes import shoes
from posegaussian.stages.simulator.subjects.skeleton import SIDES
from posegaussian.stages.simulator.wardrobe.carried import carried
from posegaussian.stages.simulator.wardrobe.description import NOTHING, Cloth, Extras
from posegaussian.stages.simulator.wardrobe.folds import folded
from posegaussian.stages.simulator.wardrobe.materials import MATERIALS, three
from posegaussian.stages.simulator.wardrobe.strands import strands
from posegaussian.stages.simulator.wardrobe.straps import strapped, unpressed

ARM, LEG = ("upper_arm", "forearm", "hand"), ("thigh", "shin", "foot")
TUCK = 0.03
"""Metres under a hem where skin or cloth below is no longer drawn."""
WAIST = 0.09
"""Metres that trousers reach up under the hem of a top."""


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


def _upper(body: Body, garment: Garment) -> Shell:
    inside = upper_field(body, garment)
    reach = np.maximum(body.along(ARM), 0.0) / body.limb_length(ARM, 2.0)
    belly = np.clip((body.pivot("chest")[2] - body.vertices[:, 2]) / 0.25, 0.0, 1.0) * (body.arms < 0.3)
    offset = garment.loose * (1.0 + 0.6 * belly + 0.2 * reach) + 0.003
    # where trousers are underneath there is less room to swing
    over = np.clip((body.pivot("left_thigh")[2] + 0.06 + WAIST - body.vertices[:, 2]) / 0.04, 0.0, 1.0) * (
        body.arms < 0.3
    )
    slack = offset * np.clip(0.3 + belly, 0.0, 1.0) * (1.0 - 0.7 * over)
    vertices = shell(body, inside, offset, 34, 0.5 * garment.loose)
    return Shell(vertices, inside, slack)


def _lower(body: Body, garment: Garment) -> Shell:
    inside = lower_field(body, garment)
    down = np.clip(body.along(LEG) / body.limb_length(LEG, 2.0), 0.0, 1.0)
    offset = garment.loose * (0.7 + 1.2 * down) + 0.002
    vertices = shell(body, inside, offset, 20, 0.45 * garment.loose)
    return Shell(vertices, inside, offset * down)


def _foot_field(body: Body) -> np.ndarray:
    """[V] metres below the rim of the shoes."""
    feet = body.bone(*(s + b for s in SIDES for b in ("foot", "toes", "shin"))) > 0.5
    return np.where(feet, body.pivot("left_foot")[2] + TUCK - 0.005 - body.vertices[:, 2], -1.0)


def _hair(body: Body, look: Appearance) -> tuple[Mesh, np.ndarray]:
    size = 1.0 / marks(body)[3, 0]
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
    offset = np.minimum(thick, 0.003 + 0.55 * np.maximum(inside, 0.0)) + 0.006 * noise_at(body.vertices, 0.035, 3.0) * (
        inside > 0.01
    )
    # hair lies over the ears, not along their folds
    ears = np.minimum(*(np.linalg.norm(body.vertices - e, axis=1) for e in body.joints[3:5])) / size < 0.055
    vertices = shell(body, inside, offset, 8 if look.style == "short" else 30, 0.0, 1.0 - 1.0 * ears)
    return cut(body, Shell(vertices, inside, np.zeros(len(vertices)))), np.where(ears, inside + TUCK, inside)


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
    whole = cut(body, Shell(body.vertices, everything, np.zeros(len(everything))))
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
        painted(body, _without(whole, eyes | hidden), "skin", (look.skin, lips, brows), 0.1, 0.035, 12.0),  # type: ignore[arg-type]
        painted(body, balls, "eye", ((206, 202, 198), (84, 62, 44), (10, 10, 12)), 0.1, 0.10, 80.0, 128),
    ]


@lru_cache(maxsize=4)
def dressed(subject: str, outfit: str, extras: Extras = NOTHING) -> Mesh:
    """A baked subject in an outfit, at rest, standing on its soles at z = -SOLE, with whatever else it wears and holds.
    Raises KeyError for unknown names."""
    body, look, clothes = load_body(subject), LOOKS[subject], OUTFITS[outfit]
    return _assembled(body, look, clothes, extras)


def _made_of(garment: Garment, cloth: Cloth) -> Garment:
    """A garment of the cloth that a scene asks for."""
    changed: dict[str, Any] = {"folds": cloth.folds}
    if cloth.colors is not None:
        changed |= {"colors": three(cloth.colors), "pattern": "plain"}
    if cloth.pattern is not None:
        changed["pattern"] = cloth.pattern
    if cloth.scale is not None:
        changed["scale"] = cloth.scale
    if cloth.material is not None:
        made = MATERIALS[cloth.material]
        changed |= {"gloss": made.gloss, "exponent": made.exponent, "sheen": made.sheen}
    return dataclasses.replace(garment, **changed)


def _sewn(body: Body, garment: Garment, whole: Shell, free: Callable[[Mesh], np.ndarray]) -> Mesh:
    """A garment's mesh, painted and folded; `free` says where folds may stand out."""
    g = garment
    flat = painted(body, cut(body, whole), g.pattern, g.colors, g.scale, g.gloss, g.exponent, sheen=g.sheen)
    return folded(body, flat, g.folds, free) if g.folds else flat


def _assembled(body: Body, look: Appearance, clothes: Outfit, extras: Extras) -> Mesh:
    tops, trousers = _made_of(clothes.upper, extras.upper), _made_of(clothes.lower, extras.lower)
    upper, lower = _upper(body, tops), _lower(body, trousers)
    hair, in_hair = _hair(body, look)
    covered = np.maximum.reduce([upper.inside, lower.inside, _foot_field(body), in_hair])
    uppers, soles = (
        Texture(np.broadcast_to(linear(c), (1, 1, 3)).astype(np.float32), g, 30.0)
        for c, g in ((clothes.shoes, 0.08), (clothes.sole, 0.03))
    )
    hem = body.pivot("left_thigh")[2] + 0.02

    def loose(mesh: Mesh) -> np.ndarray:
        return unpressed(body, extras.straps, mesh)

    def loose_below_the_hem(mesh: Mesh) -> np.ndarray:
        return loose(mesh) * np.clip((hem - mesh.vertices[:, 2]) / 0.06, 0.0, 1.0)

    return joined(
        [
            *_skin(body, look, covered),
            _sewn(body, tops, upper, loose),
            _sewn(body, trousers, lower, loose_below_the_hem),
            shoes(body, uppers, soles),
            painted(body, hair, "hair", (look.hair,) * 3, 0.1, 0.06, 25.0),
            *(m for k, strap in enumerate(extras.straps) for m in strapped(body, strap, k, (lower, upper))),
            *(carried(body, thing) for thing in extras.carries),
            *([strands(hair, extras.hair, linear(look.hair))] if extras.hair.strands else []),
        ]
    )
