"""Cloth, straps, things in hands and loose hair: what they add, and that nothing changes without them."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from posegaussian.dags.simulation.simulate import read_scene
from posegaussian.stages.simulator.effects.soft_matte import SoftMatte, apply
from posegaussian.stages.simulator.render.mesh import Mesh, skin
from posegaussian.stages.simulator.render.patterns import PATTERNS
from posegaussian.stages.simulator.scene import Scene
from posegaussian.stages.simulator.setup import stage
from posegaussian.stages.simulator.subjects.bodies import load_body
from posegaussian.stages.simulator.subjects.motions import bones_at
from posegaussian.stages.simulator.wardrobe.carried import carried
from posegaussian.stages.simulator.wardrobe.description import CLOTH_PATTERNS, NOTHING, Carried, Extras
from posegaussian.stages.simulator.wardrobe.folds import finer
from posegaussian.stages.simulator.wardrobe.garments import dressed
from posegaussian.stages.simulator.wardrobe.straps import THICK
from posegaussian.storage.model.errors import ConfigError


def extras(**given: Any) -> Extras:
    return Extras.model_validate(given)


def area(mesh: Mesh) -> float:
    a, b, c = (mesh.vertices[mesh.tris[:, k]] for k in range(3))
    return float(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())


def of_layer(mesh: Mesh, layer: int) -> np.ndarray:
    return mesh.vertices[np.unique(mesh.tris[mesh.layer == layer])]


@pytest.fixture(scope="module")
def plain() -> Mesh:
    return dressed("boris", "dark")


def test_every_pattern_of_cloth_is_known() -> None:
    assert set(CLOTH_PATTERNS) < set(PATTERNS)


def test_finer_triangles_are_the_same_surface(plain: Mesh) -> None:
    fine = finer(plain)
    assert len(fine.tris) == 4 * len(plain.tris)
    assert area(fine) == pytest.approx(area(plain), rel=1e-9)
    np.testing.assert_array_equal(fine.vertices[: len(plain.vertices)], plain.vertices)
    np.testing.assert_allclose(fine.weights.sum(axis=1), 1.0, atol=1e-9)
    # each corner keeps its place in the texture, and four small triangles cover what the large one covered
    np.testing.assert_allclose(fine.uv.reshape(-1, 12, 2).mean(axis=1), plain.uv.mean(axis=1), atol=1e-6)


def test_straps_things_and_strands_are_added_behind_what_is_there(plain: Mesh) -> None:
    full = dressed(
        "boris", "dark", extras(straps=[{"kind": "belt"}], carries=[{"thing": "bag"}], hair={"strands": 100})
    )
    n, t = len(plain.vertices), len(plain.tris)
    np.testing.assert_array_equal(full.vertices[:n], plain.vertices)
    np.testing.assert_array_equal(full.tris[:t], plain.tris)
    assert np.isfinite(full.vertices).all()
    assert full.tris.max() < len(full.vertices)
    np.testing.assert_allclose(full.weights.sum(axis=1), 1.0, atol=1e-9)
    belt = of_layer(full, len(plain.textures))
    assert 0.02 < np.ptp(belt[:, 2]) < 0.08, "a belt is level and some centimetres wide"
    assert np.ptp(belt[:, 1]) > 0.25, "and goes around"
    cloth = of_layer(plain, 2)
    apart = np.linalg.norm(belt[:, None] - cloth[None], axis=2).min(axis=1)
    assert apart.min() > 0.5 * THICK, "it lies over the cloth, and not in it"


def test_folds_stand_out_by_no_more_than_they_are_deep_and_are_flat_below_straps(plain: Mesh) -> None:
    deep = 0.012
    flat, folded = (of_layer(dressed("boris", "dark", extras(upper={"folds": d})), 2) for d in (1e-9, deep))
    out = np.linalg.norm(folded - flat, axis=1)
    assert 0.6 * deep < out.max() <= deep * (1 + 1e-6)
    pressed = of_layer(dressed("boris", "dark", extras(upper={"folds": deep}, straps=[{"kind": "belt"}])), 2)
    belt = load_body("boris").pivot("left_thigh")[2] + 0.065
    near = (np.abs(flat[:, 2] - belt) < 0.015) & (np.abs(flat[:, 1]) < 0.2)
    assert near.sum() > 100
    np.testing.assert_allclose(pressed[near], flat[near], atol=1e-8)
    far = flat[:, 2] > belt + 0.1
    np.testing.assert_array_equal(pressed[far], folded[far])


@pytest.mark.parametrize("thing", ["helmet", "bag", "board"])
def test_a_thing_is_rigid_stays_in_the_hand_and_has_its_outside_outside(thing: str) -> None:
    body = load_body("boris")
    for hand in ("left", "right"):
        held = carried(body, Carried.model_validate({"thing": thing, "hand": hand}))
        moved = skin(held.vertices, held.bones, held.weights, bones_at(body, "walk", 0.3, np.zeros(4)))
        picked = slice(None, None, 37)
        before, after = (np.linalg.norm(v[picked, None] - v[None, picked], axis=2) for v in (held.vertices, moved))
        np.testing.assert_allclose(before, after, atol=1e-9)
        grip = body.vertices[body.bone(hand + "_hand") > 0.5].mean(axis=0)
        assert np.linalg.norm(held.vertices - grip, axis=1).min() < 0.12
        first = held.tris[held.layer == 0]
        middle = held.vertices[np.unique(first)].mean(axis=0)
        a, b, c = (held.vertices[first[:, k]] - middle for k in range(3))
        assert np.einsum("ij,ij->", a, np.cross(b, c)) > 0


def scene(**given: Any) -> Scene:
    return Scene.model_validate(
        {"seed": 4, "frames": 1, "samples": 3, "rig": {"cameras": 2, "size": [96, 128]}, **given}
    )


def test_loose_hair_has_a_soft_outline() -> None:
    bare, loose = (
        stage(scene(subject={"person": "boris", "hair": {"strands": n, "length": 0.08}})).take.shoot(0, 0).true_mask
        for n in (0, 3000)
    )
    partial = [((m > 0) & (m < 255)).mean() / (m > 0).mean() for m in (bare[:40], loose[:40])]
    assert partial[1] > 1.5 * partial[0]


def test_lacquer_shines_only_where_the_scene_lets_surfaces_shine() -> None:
    subject = {"upper": {"colors": [[30, 30, 32]], "material": "cotton"}}
    lacquer = {"upper": {"colors": [[30, 30, 32]], "material": "lacquer"}}

    def picture(subject: dict[str, Any], **effects: Any) -> np.ndarray:
        return stage(scene(subject=subject, effects=effects)).take.shoot(0, 0).color

    np.testing.assert_array_equal(picture(subject), picture(lacquer))
    dull, shiny = picture(subject, specular={}), picture(lacquer, specular={})
    assert (shiny.astype(int) - dull).max() > 40


def test_a_soft_matte_rises_over_as_many_pixels_as_it_says() -> None:
    step = np.zeros((9, 200), np.uint8)
    step[:, 100:] = 255
    for width in (2.0, 4.0, 8.0):
        soft = apply(step, None, SoftMatte.model_validate({"width": width}), 1)[4] / 255.0
        low, high = (np.interp(level, soft, np.arange(200) + 0.5) for level in (0.1, 0.9))
        # a step of whole pixels is itself one pixel wide, which adds to the width in quadrature
        assert np.hypot(width, 0.8) == pytest.approx(high - low, abs=0.25)
        assert soft.sum() == pytest.approx(100, abs=0.1)


def test_a_wrong_wardrobe_is_answered_with_its_place(tmp_path: Path) -> None:
    file = tmp_path / "scene.yaml"
    file.write_text(
        "subject:\n  upper: {material: tin, fold: 1}\n  straps: [{kind: belt}, {kind: rope}]\n  hair: {strands: -1}\n"
    )
    with pytest.raises(ConfigError) as told:
        read_scene(file)
    text = str(told.value)
    assert f"{file}:2:11 subject.upper.material: " in text
    assert "there is no material 'tin'; there are cotton, satin, leather, lacquer, metal" in text
    assert f"{file}:2:" in text
    assert "folds" in text, "the nearest name is offered"
    assert f"{file}:3:" in text
    assert f"{file}:4:" in text
    file.write_text("subject:\n  straps: [{kind: belt}, {kind: belt}]\n  carries: [{thing: bag}, {thing: board}]\n")
    with pytest.raises(ConfigError) as told:
        read_scene(file)
    assert "strap 'belt' is taken already" in str(told.value)
    assert "hand 'left' is taken already" in str(told.value)


def test_a_person_without_extras_wears_the_outfit() -> None:
    assert scene().subject.extras() == NOTHING
