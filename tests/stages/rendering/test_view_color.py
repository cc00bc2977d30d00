"""Colours blended by angle: what source views say of a point, weighted; who sees it; and whom it serves."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from posegaussian.stages.camera_paths.paths import make_path
from posegaussian.stages.gaussians.params import GaussiansParams
from posegaussian.stages.imaging.exposure import NONE
from posegaussian.stages.metrics.measures.psnr import psnr
from posegaussian.stages.registry import stage
from posegaussian.stages.rendering.effects import VIEW_DEPENDENT_COLOR
from posegaussian.stages.rendering.lift import GaussianMaps, Lifted, lift
from posegaussian.stages.rendering.params import RenderingParams
from posegaussian.stages.rendering.view_color import Photo, color_towards
from posegaussian.stages.simulator.subjects.capsule_person import PersonCapture, capture_person
from posegaussian.stages.splatting.definition.scene import Camera
from tests.support.memory_inputs import run_stage

SIZE, COLOR = 96, "rendering/{path}/color"
CPU = torch.device("cpu")


@pytest.fixture(scope="module")
def person() -> PersonCapture:
    return capture_person(views=8, size=SIZE, frames=1, held_out=1)


def posed(c: PersonCapture, view: int, color: np.ndarray | None = None) -> tuple[GaussianMaps, np.ndarray, np.ndarray]:
    shape = (SIZE, SIZE)
    maps = GaussianMaps(
        c.color[0, view] if color is None else color,
        c.depth[0, view],
        np.full((3, *shape), 0.01),
        np.stack([np.zeros(shape), np.zeros(shape), -np.ones(shape)]),
        np.full((2, *shape), 0.9),
    )
    return maps, c.rig.intrinsics[view], c.rig.world_to_camera[view]


def target(c: PersonCapture, view: int) -> Camera:
    return Camera(c.rig.intrinsics[view], c.rig.world_to_camera[view], SIZE, SIZE)


def seen(
    c: PersonCapture, at: int, colors: dict[int, np.ndarray], limit: float = np.pi / 3
) -> tuple[Lifted, torch.Tensor]:
    """View 0's Gaussians and their colours towards the camera of view `at`."""
    lifted = lift(*posed(c, 0, colors[0]), torch.float64, CPU)
    photos = {v: Photo.of(*posed(c, v, color), torch.float64, CPU) for v, color in colors.items()}
    return lifted, color_towards(target(c, at), lifted, 0, photos, limit)


def plain(*rgb: int) -> np.ndarray:
    return np.full((SIZE, SIZE, 3), rgb, np.uint8)


def test_its_own_camera_sees_a_view_as_it_is(person: PersonCapture) -> None:
    lifted, towards = seen(person, 0, {0: plain(200, 0, 0), 1: plain(0, 200, 0)}, limit=np.pi / 4)
    # The neighbour is 45 degrees away, as is the first view left out: what is nearer is nearer than it by perspective.
    assert (towards[:, 0] > 0.97 * lifted.color[:, 0]).all()


def test_halfway_between_two_views_both_have_a_say_where_both_see_the_point(person: PersonCapture) -> None:
    middle = person.views.held_out[0]
    _, towards = seen(person, middle, {0: plain(200, 0, 0), 1: plain(0, 200, 0)})
    total = towards.sum(dim=1) * 255
    torch.testing.assert_close(total, torch.full_like(total, 200.0), rtol=0, atol=1e-6)
    alone = towards[:, 1] == 0
    assert 0.1 < alone.double().mean() < 0.7, "much of the body is hidden from the neighbour, or turned away"
    assert (towards[~alone, 1].median() * 255 - 100).abs() < 40


def test_a_view_that_sees_another_surface_there_has_no_say(person: PersonCapture) -> None:
    maps, k, pose = posed(person, 1, plain(0, 200, 0))
    nearer = Photo.of(
        GaussianMaps(
            maps.color,
            np.where(person.depth[0, 1] > 0, person.depth[0, 1] * 0.9, 0),
            maps.scale,
            maps.normal,
            maps.opacity,
        ),
        k,
        pose,
        torch.float64,
        CPU,
    )
    points = lift(*posed(person, 1), torch.float64, CPU).mean
    assert float(nearer.at(points)[1].max()) == 0
    color, share = Photo.of(maps, k, pose, torch.float64, CPU).at(points)
    assert share.min() > 0.999, "a view sees all of its own points"
    torch.testing.assert_close(color * 255, torch.tensor([0.0, 200.0, 0.0], dtype=torch.float64).expand_as(color))


def test_points_behind_a_camera_or_in_its_plane_are_not_seen_and_nothing_is_nan(person: PersonCapture) -> None:
    maps, k, pose = posed(person, 0)
    centre = target(person, 0).centre
    points = torch.as_tensor(
        np.stack([centre, centre - 2 * pose[2, :3], centre + 1e-9 * pose[2, :3], np.full(3, 1e30)])
    )
    color, share = Photo.of(maps, k, pose, torch.float64, CPU).at(points)
    assert torch.isfinite(color).all()
    assert not share.any()


def test_threads_change_nothing(person: PersonCapture) -> None:
    found = []
    for threads in (1, 2):
        before = torch.get_num_threads()
        torch.set_num_threads(threads)
        found.append(seen(person, person.views.held_out[0], {0: person.color[0, 0], 1: person.color[0, 1]})[1])
        torch.set_num_threads(before)
    assert torch.equal(*found)


def rendered(c: PersonCapture, color: np.ndarray, on: bool) -> float:
    """PSNR of the held-out picture, dB, from true depth."""
    given = {
        "depth/depth": c.depth,
        "depth/confidence": (c.depth > 0).astype(np.float16),
        "frames/color": color,
        "frames/mask": c.mask,
    }
    arrays = given | run_stage(stage("gaussians"), GaussiansParams(), given, c.rig, c.views, 1)
    path = make_path("held_out", c.rig, c.views, np.arange(1))
    picture = run_stage(
        stage("rendering"),
        RenderingParams(),
        arrays,
        c.rig,
        c.views,
        1,
        path=path,
        effects=frozenset({"view_dependent_color"} if on else ()),
    )[COLOR]
    return psnr(picture[:, 0], c.color[:, c.views.held_out[0]], 255.0, 100.0)


def test_views_that_disagree_are_blended_to_a_picture_closer_to_the_truth(person: PersonCapture) -> None:
    """Every camera sees the body in noise of its own, 30/255;
    the one that lies in front is chance, the mean of both is not."""
    random = np.random.default_rng(0)
    noisy = np.clip(person.color + random.normal(0, 30, person.color.shape), 0, 255).astype(np.uint8)
    noisy[:, 8:] = person.color[:, 8:]
    assert rendered(person, noisy, True) > rendered(person, noisy, False) + 0.3  # 0.5 dB when written


def evidence(colors: np.ndarray, noise: float, *facts: str, sources: int = 2) -> SimpleNamespace:
    """The first camera is brighter by as much at 40 surface points as on all patches of the body."""
    surface = np.full((len(colors), len(colors), 64, 3), NONE)
    surface[0, 1, :40] = np.log2(np.maximum(colors[0], 1e-3) / np.maximum(colors[1], 1e-3)).mean(axis=0)
    noted = {"survey/colors": colors, "survey/noise": np.full((len(colors), 1), noise), "survey/surface": surface}
    return SimpleNamespace(
        params=RenderingParams(sources=sources),
        facts=frozenset({"joints3d", *facts}),
        sources=(0, 1),
        joint_views=(),
        noted=noted,
    )


def test_it_is_for_views_that_differ_by_more_than_noise_and_exposure() -> None:
    random = np.random.default_rng(1)
    base = random.uniform(0.1, 0.5, (192, 3))
    glossy = np.stack([base, base + 0.1 * random.uniform(0, 1, (192, 3))])
    darker = np.stack([base, 0.6 * base])
    effect = VIEW_DEPENDENT_COLOR

    def on(e: SimpleNamespace) -> bool:
        decision = effect.decide(e, effect.threshold)  # type: ignore[arg-type]
        assert decision is not None
        return decision.on

    assert on(evidence(glossy, 0.5))
    assert not on(evidence(np.stack([base, base]), 0.5))
    assert not on(evidence(glossy, 30.0)), "noise alone explains that"
    assert on(evidence(darker, 0.5))
    assert not on(evidence(darker, 0.5, "exposure_matching")), "gains have taken that away"
    assert not on(evidence(np.zeros((2, 192, 3)), 0.5)), "no patch is shared"
    assert effect.decide(SimpleNamespace(noted={}, facts=frozenset()), 5.0) is None  # type: ignore[arg-type]
    assert "rendering.sources is 1" in (effect.lacks(evidence(glossy, 0.5, sources=1)) or "")  # type: ignore[arg-type]
