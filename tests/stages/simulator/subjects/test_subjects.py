"""Baked bodies, what they wear, and how they move."""

import os

import numpy as np
import pytest

from posegaussian.dags.simulation.bake import bake, refuse_non_commercial
from posegaussian.stages.simulator.render.mesh import clipped, skin
from posegaussian.stages.simulator.render.patterns import PATTERNS
from posegaussian.stages.simulator.scans import parse_obj, scan_mesh, texture_name
from posegaussian.stages.simulator.scene import Scan
from posegaussian.stages.simulator.subjects.bodies import FOLDER, load_body
from posegaussian.stages.simulator.subjects.motion_names import MOTION_NAMES
from posegaussian.stages.simulator.subjects.motions import MOTIONS, bones_at
from posegaussian.stages.simulator.subjects.outfits import LOOKS, OUTFITS
from posegaussian.stages.simulator.subjects.skeleton import BONES, CARRIERS, PARENTS
from posegaussian.stages.simulator.subjects.splits import KEPT_OUTFITS, KEPT_SUBJECTS, VALIDATION_SUBJECT
from posegaussian.stages.simulator.wardrobe.garments import dressed

STYLE = np.array([0.3, -0.5, 0.1, 0.6])


def test_there_are_enough_subjects_and_outfits_and_their_files_are_small() -> None:
    assert len(LOOKS) >= 9
    assert len(OUTFITS) >= 8
    assert len(KEPT_SUBJECTS) == len(KEPT_OUTFITS) == 4
    assert VALIDATION_SUBJECT not in KEPT_SUBJECTS
    files = {f.stem: os.path.getsize(f) for f in FOLDER.glob("*.npz")}
    assert set(files) == {*LOOKS, "body"}
    assert max(files.values()) < 2e6
    assert all(g.pattern in PATTERNS for o in OUTFITS.values() for g in (o.upper, o.lower))
    assert set(MOTION_NAMES) == set(MOTIONS)


@pytest.mark.parametrize("topology", ["smpl", "SMPLX", "smplh"])
def test_topologies_with_non_commercial_data_are_refused(topology: str, tmp_path: object) -> None:
    with pytest.raises(ValueError, match="non-commercial"):
        refuse_non_commercial(topology)
    with pytest.raises(ValueError, match="non-commercial"):
        bake(tmp_path, topology)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", sorted(LOOKS))
def test_a_body_is_upright_symmetric_and_whole(name: str) -> None:
    body = load_body(name)
    assert body.vertices[:, 2].min() == pytest.approx(0, abs=1e-3)
    assert 1.3 < body.vertices[:, 2].max() < 2.0
    np.testing.assert_allclose(body.weights.sum(axis=1), 1.0, atol=1e-9)
    left, right = ([i for i, b in enumerate(BONES) if b.startswith(s)] for s in ("left_", "right_"))
    np.testing.assert_allclose(body.pivots[left] * [1, -1, 1], body.pivots[right], atol=2e-3)
    assert (body.pivots[left, 1] > 0).all()
    nose, eyes, ears = body.joints[0], body.joints[1:3].mean(axis=0), body.joints[3:5].mean(axis=0)
    assert nose[0] > ears[0]
    assert eyes[2] > nose[2]
    assert all(p < i for i, p in enumerate(PARENTS))


@pytest.mark.parametrize("motion", MOTION_NAMES)
def test_limbs_are_rigid_feet_stand_on_the_ground_and_nothing_tears(motion: str) -> None:
    body, mesh = load_body("boris"), dressed("boris", "dark")
    lengths = []
    for t in np.arange(0.0, 2.6, 0.35):
        m = bones_at(body, motion, float(t), STYLE)
        np.testing.assert_allclose(
            m[:, :3, :3] @ m[:, :3, :3].transpose(0, 2, 1), np.broadcast_to(np.eye(3), (len(m), 3, 3)), atol=1e-9
        )
        v = skin(mesh.vertices, mesh.bones, mesh.weights, m)
        # the four points of the soles that carry the body are not the lowest of the mesh by more than a rounded heel
        assert v[:, 2].min() == pytest.approx(0.0, abs=0.06)
        j = np.einsum("jab,jb->ja", m[CARRIERS][:, :3, :3], body.joints) + m[CARRIERS][:, :3, 3]
        lengths.append(
            [
                np.linalg.norm(j[a] - j[b])
                for a, b in ((5, 7), (7, 9), (6, 8), (8, 10), (11, 13), (13, 15), (12, 14), (14, 16))
            ]
        )
    np.testing.assert_allclose(lengths, np.broadcast_to(lengths[0], np.shape(lengths)), atol=1e-9)


def test_motions_are_continuous_and_do_what_they_say() -> None:
    body = load_body("anna")

    def joints(motion: str, t: float) -> np.ndarray:
        m = bones_at(body, motion, t, np.zeros(4))[CARRIERS]
        return np.einsum("jab,jb->ja", m[:, :3, :3], body.joints) + m[:, :3, 3]

    for motion in MOTION_NAMES:
        # a kicking foot reaches 14 m/s
        path = np.stack([joints(motion, t) for t in np.arange(0, 0.85, 0.01)])
        assert np.linalg.norm(np.diff(path, axis=0), axis=-1).max() < 0.16, motion
    assert joints("wave", 0.0)[10, 2] > joints("wave", 0.0)[6, 2] + 0.1, "the right wrist is above the shoulder"
    assert joints("kick", 0.3)[16, 2] > 0.4
    assert joints("crouch", 1.3)[0, 2] < joints("stand", 0.0)[0, 2] - 0.4
    crossed = joints("crossed_arms", 0.0)
    assert crossed[9, 1] < crossed[10, 1] - 0.03, "the left wrist is to the right of the right one"


def test_cloth_lies_outside_the_skin_and_hems_are_cut() -> None:
    mesh = dressed("anna", "stripes")
    assert np.isfinite(mesh.vertices).all()
    np.testing.assert_allclose(mesh.weights.sum(axis=1), 1.0, atol=1e-9)
    assert mesh.slack.max() > 0.01
    assert mesh.tris.max() < len(mesh.vertices)
    for t in mesh.textures:
        assert np.isfinite(t.albedo).all()
        assert 0 <= t.albedo.min() <= t.albedo.max() <= 0.95


def test_clipping_keeps_the_area_where_the_field_is_positive() -> None:
    points = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    tris = np.array([[0, 1, 2], [0, 2, 3]])
    parent, corners, of = clipped(points[:, 0] - 0.3, tris)
    new = np.einsum("nij,njk->nik", corners, points[of])
    a, b = new[:, 1] - new[:, 0], new[:, 2] - new[:, 0]
    assert (0.5 * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])).sum() == pytest.approx(0.7)
    assert set(parent) == {0, 1}
    assert new[..., 0].min() == pytest.approx(0.3)


OBJ = (
    "mtllib m.mtl\nv 0 10 0\nv 2 10 0\nv 2 14 0\nv 0 14 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nf 1/1 2/2 3/3 4/4\nf -4/-4"
    " -3/-3 -2/-2\n"
)


def test_a_scan_is_read_and_stood_on_the_ground() -> None:
    v, tris, uv, material = parse_obj(OBJ)
    assert material == "m.mtl"
    assert tris.tolist() == [[0, 1, 2], [0, 2, 3], [0, 1, 2]]
    np.testing.assert_array_equal(uv[2], [[0, 0], [1, 0], [1, 1]])
    assert texture_name("newmtl a\nmap_Kd -s 1 1 1 skin.jpeg\n") == "skin.jpeg"
    mesh = scan_mesh(v, tris, uv, None, Scan(obj="x.obj", scale=2.0))
    np.testing.assert_allclose(np.ptp(mesh.vertices, axis=0), [0, 1, 2])
    assert mesh.vertices[:, 2].min() == 0
    np.testing.assert_allclose(scan_mesh(v, tris, uv, None, Scan(obj="x.obj", height=1.7)).vertices[:, 2].max(), 1.7)
    with pytest.raises(ValueError, match="line 2: cannot read 'v 1 x 3'"):
        parse_obj("v 0 0 0\nv 1 x 3\n")
    with pytest.raises(ValueError, match="nothing to film"):
        parse_obj("v 0 0 0\n")


def test_indices_below_zero_count_from_the_face_and_each_corner_has_its_own_place_in_the_texture() -> None:
    three = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"
    _, tris, _, _ = parse_obj(f"{three}f -3 -2 -1\n{three}f -3 -2 -1\n")
    assert tris.tolist() == [[0, 1, 2], [3, 4, 5]]
    _, tris, uv, _ = parse_obj(
        f"{three}vt 0 0\nvt 1 0\nusemtl a\nf 1/1 2/2 3/1\nusemtl b\nf 1 2 3\nusemtl a\nf 1/2 2/1 3/1\n"
    )
    assert tris.tolist() == [[0, 1, 2]] * 3
    assert uv[..., 0].tolist() == [[0, 1, 0], [0, 0, 0], [1, 0, 0]]
