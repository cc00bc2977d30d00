"""Other methods' pictures: laws they keep, and how they take their place in the pipeline."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from posegaussian.dags.planning.results import Results
from posegaussian.stages.peers import free_gaussians
from posegaussian.stages.peers.fitting import drawn, fitted
from posegaussian.stages.peers.ibr import Photo, around, blended
from posegaussian.stages.silhouettes.hull import Silhouettes
from posegaussian.stages.silhouettes.places import agreed
from posegaussian.stages.simulator.subjects.capsule_person import PersonCapture, capture_person
from posegaussian.stages.splatting.definition.scene import Camera
from tests.support.pipeline import Pipeline

SIZE, TARGET = 96, 3


@pytest.fixture(scope="module")
def person() -> PersonCapture:
    return capture_person(views=8, size=SIZE, frames=1)


def camera(person: PersonCapture, v: int) -> Camera:
    return Camera(person.rig.intrinsics[v], person.rig.world_to_camera[v], SIZE, SIZE)


def photos(person: PersonCapture, views: range | list[int]) -> list[Photo]:
    return [Photo(camera(person, v), person.color[0, v], person.mask[0, v], person.depth[0, v]) for v in views]


def hull(person: PersonCapture, views: range | list[int]) -> Silhouettes:
    return around(agreed(person.rig, {v: person.mask[0, v] for v in views}), photos(person, views))


def filmed(person: PersonCapture, v: int) -> np.ndarray:
    return person.color[0, v] / 255 * (person.mask[0, v][..., None] / 255)


def test_in_the_place_of_a_source_camera_its_own_picture_is_seen(person: PersonCapture) -> None:
    every = range(8)
    color, alpha = blended(camera(person, TARGET), hull(person, every), photos(person, every))
    solid = (person.mask[0, TARGET] == 255) & (alpha > 0.5)
    assert solid.sum() > 0.95 * (person.mask[0, TARGET] == 255).sum()
    straight = color / np.maximum(alpha, 1e-6)[..., None]
    assert np.abs(straight - person.color[0, TARGET] / 255)[solid].max() < 0.02


def test_from_the_others_a_view_is_drawn_better_than_by_the_nearest_alone(person: PersonCapture) -> None:
    others = [v for v in range(8) if v != TARGET]
    truth, silhouettes = filmed(person, TARGET), hull(person, others)
    all_of_them = blended(camera(person, TARGET), silhouettes, photos(person, others))[0]
    nearest = blended(camera(person, TARGET), silhouettes, photos(person, [TARGET + 1]))[0]
    error, alone = (float(((c - truth) ** 2).mean()) for c in (all_of_them, nearest))
    assert 10 * np.log10(1 / error) > 20
    assert error < alone


def test_the_order_of_the_photos_does_not_matter_and_what_is_empty_is_black(person: PersonCapture) -> None:
    others = [v for v in range(8) if v != TARGET]
    silhouettes = hull(person, others)
    color, alpha = blended(camera(person, TARGET), silhouettes, photos(person, others))
    turned = blended(camera(person, TARGET), silhouettes, photos(person, others[::-1]))
    np.testing.assert_allclose(turned[0], color, atol=1e-6)
    np.testing.assert_array_equal(turned[1], alpha)
    assert not color[alpha == 0].any()
    assert (color <= alpha[..., None] + 1e-5).all()
    assert (alpha > 0).sum() < 2 * (person.mask[0, TARGET] > 0).sum()


def test_what_stands_before_a_point_is_not_painted_on_it(person: PersonCapture) -> None:
    """A photo whose surface lies before all points has no say where another one sees them."""
    views = [TARGET - 1, TARGET + 1]
    silhouettes, (left, right) = hull(person, range(8)), photos(person, views)
    red = np.zeros_like(right.color)
    red[..., 0] = 255
    wall = replace(right, color=red, depth=np.where(right.depth > 0, right.depth - 0.5, 0).astype(np.float32))
    both, alpha = blended(camera(person, TARGET), silhouettes, [left, wall])
    alone, _ = blended(camera(person, TARGET), silhouettes, [left])
    bare = blended(camera(person, TARGET), silhouettes, [left, replace(wall, depth=right.depth)])[0]
    hidden, mixed = ((np.abs(c - alone).max(axis=2) < 1e-5)[alpha > 0.5].mean() for c in (both, bare))
    assert hidden > 0.5, "only what the left photo does not see is taken from the red one"
    assert mixed < 0.2, "where it may be seen, too, both have a say"


def test_without_photos_or_masks_a_picture_is_empty(person: PersonCapture) -> None:
    assert not blended(camera(person, TARGET), hull(person, range(8)), [])[1].any()
    blank = [replace(p, mask=np.zeros_like(p.mask)) for p in photos(person, range(8))]
    nothing = agreed(person.rig, {v: p.mask for v, p in enumerate(blank)})
    assert not any(picture.any() for picture in blended(camera(person, TARGET), around(nothing, blank), blank))
    assert fitted(blank, 5) is None


def test_fitting_comes_nearer_to_the_pictures_and_is_the_same_each_time(person: PersonCapture) -> None:
    others = [v for v in range(8) if v != TARGET]

    def error(steps: int) -> tuple[float, np.ndarray]:
        gaussians = fitted(photos(person, others), steps)
        assert gaussians is not None
        color, alpha = drawn(gaussians, camera(person, TARGET))
        assert color.shape == (*alpha.shape, 3)
        return float(((color - filmed(person, TARGET)) ** 2).mean()), color

    (few, _), (many, picture), (_, again) = error(1), error(60), error(60)
    assert many < 0.8 * few
    np.testing.assert_array_equal(picture, again)


def test_densification_clones_what_is_small_splits_what_is_large_and_drops_what_is_faint() -> None:
    random = np.random.default_rng(0)
    gaussians = free_gaussians.start(random.normal(size=(40, 3)), random.random((40, 3)), np.eye(3) * 3)
    n, values = len(gaussians), gaussians.values
    small, large = np.log(0.001 * gaussians.extent), np.log(0.05 * gaussians.extent)
    with torch.no_grad():
        values["scale"][:] = small
        values["scale"][10:20] = large
        values["opacity"][20:25] = -9.0
    for value in values.values():
        value.grad = torch.ones_like(value)
    gaussians.adam.step()
    with torch.no_grad():
        values["scale"][:10], values["scale"][10:20], values["opacity"][20:25] = small, large, -9.0
        gaussians.steepness[:20] = 1.0
    gaussians.seen[:] = 1
    before = gaussians.values["mean"].detach().clone()
    gaussians.grow(torch.Generator().manual_seed(0))
    # ten clones stay beside their origins, ten are each replaced by two, five are gone
    assert len(gaussians) == n + 10 - 10 + 2 * 10 - 5
    kept = gaussians.values["mean"].detach()
    assert all((kept == p).all(dim=1).sum() == 2 for p in before[:10])
    assert not any((kept == p).all(dim=1).any() for p in before[10:25])
    assert float(torch.exp(gaussians.values["scale"]).max()) < 0.05 * gaussians.extent / 1.5


@pytest.mark.parametrize("method", ["ibr", "3dgs"])
def test_a_method_takes_the_place_of_ours_and_partitions_change_nothing(
    finished: Pipeline, tmp_path: Path, method: str
) -> None:
    own = ("depth.method=hull", f"rendering.method={method}", "rendering.fit_steps=3", "frames.range=0:3")
    archive = finished.copy(tmp_path / "archive").with_settings(*own)
    archive.run()
    plan = archive.plan()
    assert plan.all_fresh
    assert {"gaussians", "refinement"} <= set(plan.unneeded), "nobody reads them"
    assert plan.context.effects["silhouette_clipping"].state == "off"
    (path,) = plan.context.paths
    results = Results(plan.context)
    color, alpha = (results.read(f"rendering/{path}/{a}", range(3)) for a in ("color", "alpha"))
    assert (alpha > 0).any(axis=(1, 2, 3)).all()
    assert not color[alpha == 0].any()
    measured = [
        o for t, r in plan.book.receipts.items() if t in plan.verdicts and t.stage == "metrics" for o in r.outputs
    ]
    assert {r["frame"] for r in results.rows(measured)} == {0, 1, 2}
    assert results.has(f"rendering/{path}/gaussians") is (method == "3dgs")
    whole = Pipeline(tmp_path / "whole", archive.folder, archive.settings, partition=3)
    whole.register()
    whole.run()
    other = Results(whole.context()).read(f"rendering/{path}/color", range(3))
    np.testing.assert_array_equal(other, color)
    if method == "3dgs":
        drawing = [r for t, r in plan.book.receipts.items() if t in plan.verdicts and t.stage == "rendering"]
        assert all(set(r.facts["modules"]) == {"optimising"} for r in drawing)
