"""What a close-up, or a picture that cuts the subject off, does not show, the next nearest views draw."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from posegaussian.stages.camera_paths.paths import make_path
from posegaussian.stages.gaussians.params import GaussiansParams
from posegaussian.stages.registry import stage
from posegaussian.stages.rendering.params import RenderingParams
from posegaussian.stages.rendering.sources import angles_at, asked, choose, cut_off, shown, weights
from posegaussian.stages.simulator.subjects.capsule_person import PersonCapture, capture_person
from posegaussian.storage.model.cameras import Rig
from posegaussian.storage.model.masks import foreground
from tests.support.known_geometry import ring
from tests.support.memory_inputs import run_stage

COLOR, ALPHA = "rendering/{path}/color", "rendering/{path}/alpha"


@pytest.fixture(scope="module")
def person() -> PersonCapture:
    return capture_person(views=10, size=64, frames=1, held_out=1)


def cropped(c: PersonCapture, views: Sequence[int], rows: int) -> tuple[Rig, dict[str, np.ndarray]]:
    """The capture with pictures of some views that end after so many rows."""
    size, given = c.rig.size.copy(), {"depth": c.depth, "color": c.color, "mask": c.mask}
    given = {name: a.copy() for name, a in given.items()}
    for v in views:
        size[v, 1] = rows
        for a in given.values():
            a[:, v, rows:] = 0
    return replace(c.rig, size=size), given


def drawn(
    c: PersonCapture, rig: Rig, given: dict[str, np.ndarray], sources: Sequence[int] | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Colour [h, w, 3] and alpha [h, w] uint8 of the held-out camera's picture."""
    arrays = {
        "depth/depth": given["depth"],
        "depth/confidence": (given["depth"] > 0).astype(np.float16),
        "frames/color": given["color"],
        "frames/mask": given["mask"],
    }
    views = c.views if sources is None else replace(c.views, sources=tuple(sources))
    arrays |= run_stage(stage("gaussians"), GaussiansParams(), arrays, rig, views, 1)
    path = make_path("held_out", rig, views, np.arange(1))
    effects = frozenset({"silhouette_clipping"})
    out = run_stage(stage("rendering"), RenderingParams(), arrays, rig, views, 1, path=path, effects=effects)
    return out[COLOR][0, 0], out[ALPHA][0, 0]


def nearest(c: PersonCapture) -> list[int]:
    """The source views, the nearest to the held-out camera first."""
    (target,) = c.views.held_out
    angles = angles_at(np.zeros(3), c.rig.centres, c.rig.centres[target])
    return sorted(c.views.sources, key=lambda v: float(angles[v]))


def test_what_the_nearest_views_cut_off_is_drawn_from_the_next(person: PersonCapture) -> None:
    first = nearest(person)[:2]
    (target,) = person.views.held_out
    color, alpha = drawn(person, *cropped(person, first, 32))
    others = [v for v in person.views.sources if v not in first]
    without_color, without = drawn(person, *cropped(person, (), 64), sources=others)
    below = np.s_[40:]
    truth = foreground(person.mask[0, target])[below]
    assert truth.sum() > 100, "the legs lie below"
    assert (alpha[below][truth] > 128).mean() >= (without[below][truth] > 128).mean() - 0.01 > 0.9
    np.testing.assert_allclose(color[below][truth], without_color[below][truth], atol=3)
    whole_color, whole = drawn(person, *cropped(person, (), 64))
    above = np.s_[:20]
    assert np.abs(color[above].astype(int) - whole_color[above]).mean() < 1, "what they show they draw"
    np.testing.assert_array_equal(alpha[above] > 128, whole[above] > 128)


def test_where_every_view_shows_all_of_the_subject_nothing_else_is_drawn() -> None:
    rig = ring(6)
    angles, usable = np.arange(6) * 0.1, np.ones(6, bool)

    def fails(view: int, views: Sequence[int]) -> np.ndarray:
        raise AssertionError("nobody asks what a view shows")

    assert asked(angles, usable, frozenset(), 2) is None
    assert weights(angles, usable, frozenset(), 2, fails) == dict(choose(angles, usable, 2))
    assert weights(angles, usable, frozenset({3, 5}), 2, fails) == dict(choose(angles, usable, 2)), (
        "of far ones neither"
    )
    points = np.zeros((4, 3))
    assert shown(rig, points, 0, range(6), frozenset({1})).all(), "a cut picture that shows a point shows it"


def test_each_point_is_weighed_among_the_views_that_show_it() -> None:
    angles, usable, parts = np.array([0.1, 0.2, 0.4, 0.5, 0.9]), np.ones(5, bool), frozenset({0, 1})
    seen = np.ones((2, 5), bool)
    seen[1, [0, 1]] = False  # the second point lies beside the pictures of two

    def shown_of(view: int, views: Sequence[int]) -> np.ndarray:
        return seen if view not in parts else seen[:1]

    assert asked(angles, usable, parts, 2) == [0, 1, 2, 3, 4]
    found = weights(angles, usable, parts, 2, shown_of)
    everywhere, beside = dict(choose(angles, usable, 2)), dict(choose(angles, usable & seen[1], 2))
    for view, own in found.items():
        expected = [everywhere.get(view, 0.0), beside.get(view, 0.0)]
        np.testing.assert_array_equal(own, expected[: np.size(own)])
    assert set(found) == set(everywhere) | set(beside)


def test_a_picture_cuts_off_what_its_mask_takes_to_its_border() -> None:
    mask, size = np.zeros((20, 30), np.uint8), np.array([24, 16])
    mask[4:10, 4:10] = 255
    assert not cut_off(mask, size)
    for rows, columns in ((slice(14, 16), 5), (slice(0, 1), 5), (5, slice(23, 24)), (5, slice(0, 2))):
        reaching = mask.copy()
        reaching[rows, columns] = 255
        assert cut_off(reaching, size)
    beyond = mask.copy()
    beyond[18] = 255
    assert not cut_off(beyond, size), "what lies beside the picture is padding"
