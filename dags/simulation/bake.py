"""Baking bodies: `python -m posegaussian.dags.simulation.bake FOLDER` makes the files of `stages/simulator/subjects/`
from the package `anny`.

Only this file needs anny and torch (extra `[bake]`); simulating needs neither. Anny's code is Apache-2.0, its mesh and
its shapes are MakeHuman's and CC0, so the baked files may be shipped. The topologies that fetch data for non-commercial
use are refused. A baked body stands at rest, feet at z = 0, facing +x, left is +y, metres; its fingers are slightly
bent and closed.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

from posegaussian.stages.simulator.subjects.skeleton import BONES, JOINT_BONES, SIDES
from posegaussian.storage.files.write import whole_file

NON_COMMERCIAL = ("smpl", "smplh", "smplx", "mano", "flame")
"""Topologies and rigs of anny whose data is for non-commercial use only."""

PHENOTYPES: dict[str, dict[str, float]] = {
    "anna": {"gender": 1.0, "age": 0.66, "muscle": 0.5, "weight": 0.45, "height": 0.4, "caucasian": 1.0},
    "boris": {"gender": 0.0, "age": 0.62, "muscle": 0.85, "weight": 0.5, "height": 0.42, "caucasian": 1.0},
    "chiara": {"gender": 1.0, "age": 0.92, "muscle": 0.4, "weight": 0.75, "height": 0.42, "caucasian": 1.0},
    "dayo": {"gender": 0.0, "age": 0.40, "muscle": 0.5, "weight": 0.45, "height": 0.5, "african": 1.0},
    "emil": {"gender": 0.0, "age": 0.95, "muscle": 0.4, "weight": 0.3, "height": 0.34, "caucasian": 1.0},
    "fatima": {"gender": 1.0, "age": 0.64, "muscle": 0.45, "weight": 0.85, "height": 0.36, "african": 1.0},
    "gao": {"gender": 0.0, "age": 0.70, "muscle": 0.55, "weight": 0.8, "height": 0.44, "asian": 1.0},
    "hana": {"gender": 1.0, "age": 0.42, "muscle": 0.5, "weight": 0.4, "height": 0.5, "asian": 1.0},
    "ines": {
        "gender": 1.0,
        "age": 0.60,
        "muscle": 0.75,
        "weight": 0.4,
        "height": 0.42,
        "caucasian": 0.6,
        "african": 0.4,
    },
}
"""Anny's phenotype of every subject; what is not named is 0.5, ancestries 0."""
_ANCESTRIES = ("african", "asian", "caucasian")


def refuse_non_commercial(topology: str) -> None:
    """Raise ValueError for a topology whose data may not be used commercially."""
    if any(name in topology.lower() for name in NON_COMMERCIAL):
        raise ValueError(
            f"topology {topology!r} fetches data for non-commercial use only;"
            " baked bodies ship with this project, use 'anny'"
        )


def _bone_of(label: str) -> str:
    """Our bone that takes over the weights of one of anny's."""
    stem, _, side = label.partition(".")
    side = {"L": "left_", "R": "right_"}.get(side, "")
    for start, bone in (
        ("upperleg", "thigh"), ("lowerleg", "shin"), ("foot", "foot"), ("toe", "toes"), ("clavicle", "clavicle"),
        ("shoulder01", "clavicle"),
        ("upperarm", "upper_arm"), ("lowerarm", "forearm"), ("wrist", "hand"), ("finger", "hand"),
        ("metacarpal", "hand"),
    ):  # fmt: skip
        if stem.startswith(start):
            return side + bone
    if stem.startswith("neck"):
        return "neck"
    return {
        "head": "head",
        "eye": "head",
        "spine04": "waist",
        "spine03": "waist",
        "spine02": "chest",
        "spine01": "chest",
    }.get(stem, "pelvis")


_PIVOTS = {
    "pelvis": "root", "waist": "spine04", "chest": "spine02", "neck": "neck01", "head": "head",
    "clavicle": "clavicle", "upper_arm": "upperarm01", "forearm": "lowerarm01", "hand": "wrist", "thigh": "upperleg01",
    "shin": "lowerleg01", "foot": "foot", "toes": "toe1-1",
}  # fmt: skip


def _to_ours(points: np.ndarray) -> np.ndarray:
    """Anny faces -y with left at +x; ours faces +x with left at +y."""
    return np.stack([-points[..., 1], points[..., 0], points[..., 2]], axis=-1)


def _axis_turn(axis: np.ndarray, angle: float) -> np.ndarray:
    a = axis / np.linalg.norm(axis)
    k = np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def _relaxed_hands(
    vertices: np.ndarray,
    weights: np.ndarray,
    heads: dict[str, np.ndarray],
    labels: list[str],
    bend: float = 0.30,
    close: float = 0.75,
) -> np.ndarray:
    """Vertices with every finger bent by `bend` rad a joint and turned by `close`
    of the way towards the middle finger."""
    out = vertices.copy()
    for side in "LR":
        middle = heads[f"finger3-2.{side}"] - heads[f"finger3-1.{side}"]
        across = heads[f"finger5-1.{side}"] - heads[f"finger2-1.{side}"]
        palm = np.cross(across, middle)
        palm /= np.linalg.norm(palm)
        for f in "2345":
            moved = {j: np.eye(4) for j in "123"}
            whole = np.eye(4)
            own = heads[f"finger{f}-3.{side}"] - heads[f"finger{f}-1.{side}"]
            flat = [d - palm * (d @ palm) for d in (own, middle)]
            spread = np.arctan2(np.cross(flat[0], flat[1]) @ palm, flat[0] @ flat[1])
            thumb = heads[f"finger1-3.{side}"] - heads[f"finger3-1.{side}"]
            inwards = 1.0 if thumb @ palm > 0 else -1.0
            for j in "123":
                pivot = heads[f"finger{f}-{j}.{side}"]
                axis = np.cross(own, palm * inwards)
                r = _axis_turn(axis, bend)
                if j == "1":
                    r = r @ _axis_turn(palm, close * spread)
                step = np.eye(4)
                step[:3, :3], step[:3, 3] = r, pivot - r @ pivot
                whole = whole @ step
                moved[j] = whole.copy()
            for j, m in moved.items():
                w = weights[:, labels.index(f"finger{f}-{j}.{side}")][:, None]
                out += w * (vertices @ m[:3, :3].T + m[:3, 3] - vertices)
    return out


def _merged_weights(weights: np.ndarray, labels: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """[V, 4] bone index and [V, 4] uint8 weight that sums to 255, of our bones."""
    ours = np.zeros((len(weights), len(BONES)))
    for i, label in enumerate(labels):
        ours[:, BONES.index(_bone_of(label))] += weights[:, i]
    index = np.argsort(-ours, axis=1, kind="stable")[:, :4]
    best = np.take_along_axis(ours, index, axis=1)
    whole = np.rint(255 * best / best.sum(axis=1, keepdims=True)).astype(np.int64)
    whole[:, 0] += 255 - whole.sum(axis=1)
    return index.astype(np.uint8), whole.astype(np.uint8)


def _quantised(vertices: np.ndarray) -> dict[str, np.ndarray]:
    low, span = vertices.min(axis=0), np.ptp(vertices, axis=0).max()
    return {"vertices": np.rint((vertices - low) / span * 65535).astype(np.uint16), "low": low, "span": np.array(span)}


def bake(folder: Path, topology: str = "anny") -> None:
    """Write `body.npz` (what all subjects share) and one NAME.npz a subject.
    Raises ValueError for a refused topology."""
    refuse_non_commercial(topology)
    import anny
    import torch
    from anny.keypoints import KeypointsRegressor

    model = anny.Anny(topology=topology, phenotypes="all", skinning_method="lbs")
    labels = list(model.bone_labels)
    weights = model.dense_vertex_bone_weights.numpy()
    faces, corners, keep = _outside(model)
    index, share = _merged_weights(weights[keep], labels)
    with whole_file(folder / "body.npz") as partial, open(partial, "wb") as f:
        np.savez_compressed(
            f,
            faces=faces.astype(np.uint16),
            corners=corners.astype(np.uint16),
            uv=np.rint(model.texture_coordinates.numpy() * 65535).astype(np.uint16),
            bones=index,
            weights=share,
        )
    regressor = KeypointsRegressor.coco(model)
    pose = torch.eye(4, dtype=model.dtype)[None, None].repeat(1, model.bone_count, 1, 1)
    for name, given in PHENOTYPES.items():
        phenotype = {k: given.get(k, 0.0 if k in _ANCESTRIES else 0.5) for k in model.phenotype_labels}
        out = model(pose_parameters=pose, phenotype_kwargs=phenotype)
        v = out["rest_vertices"][0].numpy()
        heads = dict(zip(labels, out["rest_bone_heads"][0].numpy(), strict=True))
        face = dict(zip(regressor.labels, regressor({"vertices": out["rest_vertices"]})[0].numpy(), strict=True))
        v = _relaxed_hands(v, weights, heads, labels)[keep]
        floor = np.array([0.0, 0.0, v[:, 2].min()])
        pivots = np.stack([_pivot(bone, heads) for bone in BONES])
        joints = np.stack(
            [face[j.removeprefix("=")] if j.startswith("=") else pivots[BONES.index(j)] for j in JOINT_BONES]
        )
        with whole_file(folder / f"{name}.npz") as partial, open(partial, "wb") as f:
            arrays: dict[str, Any] = {
                **_quantised(_to_ours(v - floor)),
                "pivots": _to_ours(pivots - floor),
                "joints": _to_ours(joints - floor),
            }
            np.savez_compressed(f, **arrays)
        print(f"{name}: {np.ptp(v[:, 2]):.2f} m")


def _pivot(bone: str, heads: dict[str, np.ndarray]) -> np.ndarray:
    for side, letter in zip(SIDES, "LR", strict=True):
        if bone.startswith(side):
            return heads[f"{_PIVOTS[bone.removeprefix(side)]}.{letter}"]
    return heads[_PIVOTS[bone]]


def _outside(model: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Faces and their corners in the texture without the tongue; and the vertices kept, to which the faces refer."""
    faces, corners = model.faces.numpy(), model.face_texture_coordinate_indices.numpy()
    group = np.arange(len(model.template_vertices))
    while True:
        low = group[faces].min(axis=1)
        new = group.copy()
        np.minimum.at(new, faces.ravel(), np.repeat(low, 3))
        if np.array_equal(new, group):
            break
        group = new
    sizes = {int(g): int((group == g).sum()) for g in np.unique(group)}
    tongue = [g for g, n in sizes.items() if 100 < n < 1000]
    keep = np.nonzero(~np.isin(group, tongue))[0]
    back = np.full(len(group), -1)
    back[keep] = np.arange(len(keep))
    inside = (back[faces] >= 0).all(axis=1)
    return back[faces[inside]], corners[inside], keep


if __name__ == "__main__":
    bake(Path(sys.argv[1]))
