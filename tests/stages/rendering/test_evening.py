"""Evening of outlines: noise goes, shape stays, colours are the subject's own."""

import numpy as np
import pytest

from posegaussian.stages.rendering.evening import EXACT, Outlines, outlines_for
from posegaussian.stages.silhouettes.places import agreed
from posegaussian.stages.silhouettes.softness import softness
from posegaussian.stages.splatting.definition.scene import Camera
from posegaussian.storage.model.cameras import Rig
from tests.support.known_geometry import ring, sphere_mask

SIZE, CENTRE, RADIUS = 192, np.zeros(3), 0.5
COLOR = np.float32([0.8, 0.5, 0.2])


def disc(softness: float = 1.0) -> np.ndarray:
    """[SIZE, SIZE] float32 coverage of a disc whose outline is so many px wide."""
    y, x = np.mgrid[:SIZE, :SIZE] + 0.5 - SIZE / 2
    return np.clip(0.5 - (np.hypot(x, y) - SIZE / 3) / softness, 0, 1).astype(np.float32)


def strands() -> np.ndarray:
    """A comb of hairs 1 px wide, beside a body."""
    alpha = np.zeros((SIZE, SIZE), np.float32)
    alpha[100:160, 20:170] = 1
    alpha[40:100, 20:170:4] = 1
    return alpha


def as_mask(alpha: np.ndarray) -> np.ndarray:
    return np.rint(255 * alpha).astype(np.uint8)


def of(*alphas: np.ndarray) -> Outlines:
    masks = [as_mask(a) for a in alphas]
    found = Outlines.of(masks, softness(masks))
    assert found is not None
    return found


def frayed(alpha: np.ndarray) -> np.ndarray:
    """Hard, with every pixel near the outline chosen by chance."""
    return (alpha + np.random.default_rng(3).normal(0, 0.3, alpha.shape) * (alpha > 0) * (alpha < 1) > 0.5).astype(
        np.float32
    )


def colored(alpha: np.ndarray) -> np.ndarray:
    return alpha[..., None] * COLOR


@pytest.mark.parametrize("softness", [1.0, 3.0])
def test_a_frayed_outline_becomes_that_of_the_masks(softness: float) -> None:
    truth = disc(softness)
    rough = frayed(truth)
    shown, alpha = of(truth).evened(colored(rough), rough)
    assert ((alpha - truth) ** 2).sum() < 0.35 * ((rough - truth) ** 2).sum()
    np.testing.assert_allclose(shown, colored(alpha), atol=1e-5)  # the subject's own colour wherever there is any
    inside = slice(SIZE // 2 - 40, SIZE // 2 + 40)
    assert alpha[inside, inside].min() > 0.999


@pytest.mark.parametrize("shape", [disc(), strands(), disc(4.0)], ids=["disc", "strands", "soft"])
def test_what_is_as_rough_as_the_masks_stays(shape: np.ndarray) -> None:
    shown, alpha = of(shape).evened(colored(shape), shape)
    np.testing.assert_allclose(alpha, shape, atol=1 / 255)  # the masks are told in 1/255
    np.testing.assert_allclose(shown, colored(shape), atol=1 / 255)


def test_the_rougher_the_masks_the_less_is_evened() -> None:
    rough = frayed(disc())
    moved = [
        np.abs(Outlines(of(disc()).transfer, shape, 1.0).evened(colored(rough), rough)[1] - rough).sum()
        for shape in (0.0, 0.01, 0.02, 1.0)
    ]
    assert moved == sorted(moved, reverse=True)
    assert moved[0] > moved[1] > 0
    assert moved[-1] == 0


@pytest.mark.parametrize("lit", [0.0, 0.4, 1.0])
def test_a_soft_outline_becomes_as_sharp_as_the_masks_at_most_the_more_it_is_trusted(lit: float) -> None:
    soft, masks = disc(2.5), of(disc())
    widths, areas = [], []
    for trust in (0.0, 0.3, 0.6, 1.0):
        shown, alpha = masks.sharpened(colored(soft), soft, trust, lit)
        assert 0 <= alpha.min() <= alpha.max() <= 1
        assert (alpha[soft == 0] == 0).all()
        assert (np.sign(alpha - soft) * np.sign(soft - 0.5) >= 0).all(), "away from a half"
        brighter = np.clip(alpha - soft, 0, None)[..., None] * COLOR
        np.testing.assert_allclose(shown, np.minimum(colored(alpha), colored(soft)) + lit * brighter, atol=1e-5)
        widths.append(softness([as_mask(alpha)]))
        areas.append(float(alpha.sum()))
    assert widths == sorted(widths, reverse=True)
    assert widths[0] > widths[1] > widths[-1]
    np.testing.assert_allclose(areas, areas[0], rtol=2e-3, err_msg="an outline stays where it is")


@pytest.mark.parametrize("width", [1.0, 2.5, 4.0])
def test_what_is_as_sharp_as_the_masks_becomes_no_sharper(width: float) -> None:
    shape = disc(width)
    for masks in (disc(width), disc(1.5 * width)):
        shown, alpha = of(masks).sharpened(colored(shape), shape, 1.0, 1.0)
        np.testing.assert_array_equal(alpha, shape)
        np.testing.assert_array_equal(shown, colored(shape))
    drawn = of(disc(width / 1.1)).sharpened(colored(shape), shape, 1.0, 1.0)[1]
    assert softness([as_mask(drawn)]) >= 0.97 * softness([as_mask(disc(width / 1.1))])


def test_the_transfer_rises_from_none_to_all_and_is_softer_for_softer_masks() -> None:
    hard, soft = (of(disc(s)).transfer for s in (1.0, 4.0))
    for transfer in (hard, soft):
        assert (transfer[0], transfer[-1]) == (0, 1)
        assert (np.diff(transfer) >= 0).all()
        assert transfer[len(transfer) // 2] == pytest.approx(0.5, abs=0.05)
    quarter = len(hard) // 4
    assert hard[quarter] < soft[quarter]
    assert hard[-1 - quarter] > soft[-1 - quarter]


def test_alpha_away_from_any_outline_and_an_empty_picture_stay() -> None:
    even, outlines = np.full((40, 40), 1, np.float32), of(disc())
    np.testing.assert_array_equal(outlines.evened(colored(even), even)[1], even)
    np.testing.assert_array_equal(outlines.evened(colored(0 * even), 0 * even)[1], 0 * even)
    assert Outlines.of([]) is None
    assert Outlines.of([np.zeros((5, 5), np.uint8), np.full((5, 5), 255, np.uint8), np.zeros((0, 0), np.uint8)]) is None


def sphere_seen_from(rig: Rig, away: float) -> Camera:
    """As the first camera, `away` times as far."""
    pose = rig.world_to_camera[0].copy()
    pose[2, 3] *= away
    return Camera(rig.intrinsics[0], pose, *(int(n) for n in rig.size[0]))


def test_a_frayed_sphere_is_given_back_by_its_source_camera_with_the_masks_outline() -> None:
    rig = ring(6, (SIZE, SIZE), 180.0)
    masks = {v: sphere_mask(rig, v, CENTRE, RADIUS) for v in range(6)}
    outlines = outlines_for(sphere_seen_from(rig, 1.0), rig, agreed(rig, masks), masks, {})
    assert outlines is not None
    truth = (masks[0] / 255).astype(np.float32)
    rough = frayed(truth)
    _, alpha = outlines.evened(colored(rough), rough)
    assert ((alpha - truth) ** 2).sum() < 0.35 * ((rough - truth) ** 2).sum()


def test_masks_are_looked_at_in_the_size_of_the_picture() -> None:
    rig = ring(6, (SIZE, SIZE), 180.0)
    masks = {v: np.maximum(sphere_mask(rig, v, CENTRE, RADIUS), as_mask(strands())) for v in range(6)}
    silhouettes = agreed(rig, {v: sphere_mask(rig, v, CENTRE, RADIUS) for v in range(6)})
    near, far = (outlines_for(sphere_seen_from(rig, a), rig, silhouettes, masks, {}) for a in (0.5, 1.0))
    assert near is not None
    assert far is not None
    assert near.shape < far.shape, "hairs of 2 px are easier to follow than of 1 px"
    none = agreed(rig, {v: np.full((SIZE, SIZE), 255, np.uint8) for v in range(6)})
    assert outlines_for(sphere_seen_from(rig, 1.0), rig, none, masks, {}) is None


def test_sharpness_is_that_of_the_masks_as_they_are_in_the_size_of_the_picture() -> None:
    rig = ring(6, (SIZE, SIZE), 180.0)
    masks = {v: sphere_mask(rig, v, CENTRE, RADIUS) for v in range(6)}
    widths = {**dict.fromkeys(range(6), 0.0), 0: 2.0, 3: 2.0}  # where there is no outline, nothing is said
    for away, wanted in ((1.0, 2.0), (2.0, 1.0), (0.5, 4.0), (8.0, EXACT)):
        found = outlines_for(sphere_seen_from(rig, away), rig, agreed(rig, masks), masks, widths)
        assert found is not None
        assert found.softness == pytest.approx(wanted, rel=1e-6)
