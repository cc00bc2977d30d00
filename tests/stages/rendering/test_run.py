"""The kernel: pictures of held-out views, padding, unserved frames, missing views, partitions, quantisation."""

import dataclasses
import re

import numpy as np
import pytest
import torch

from posegaussian.stages.camera_paths.paths import make_path
from posegaussian.stages.contract import reading
from posegaussian.stages.contract.io import Block
from posegaussian.stages.gaussians.params import GaussiansParams
from posegaussian.stages.metrics.measures.psnr import psnr
from posegaussian.stages.registry import stage
from posegaussian.stages.rendering.params import RenderingParams
from posegaussian.stages.rendering.run import check, masked_note, quantise, run
from posegaussian.stages.simulator.subjects.capsule_person import PersonCapture, capture_person
from tests.support.memory_inputs import MemoryInputs, run_stage

COLOR, ALPHA = "rendering/{path}/color", "rendering/{path}/alpha"


@pytest.fixture(scope="module")
def person() -> PersonCapture:
    return capture_person(views=8, size=48, frames=3, held_out=2)


@pytest.fixture(scope="module")
def arrays(person: PersonCapture) -> dict[str, np.ndarray]:
    given = {
        "depth/depth": person.depth,
        "depth/confidence": (person.depth > 0).astype(np.float16),
        "frames/color": person.color,
        "frames/mask": person.mask,
    }
    return given | run_stage(stage("gaussians"), GaussiansParams(), given, person.rig, person.views, 3)


def render(
    c: PersonCapture,
    arrays: dict[str, np.ndarray],
    path: object,
    length: int = 3,
    params: RenderingParams | None = None,
    **more: object,
) -> dict[str, np.ndarray]:
    """Partition by partition, each a sequence of its own."""
    out: dict[str, list[np.ndarray]] = {COLOR: [], ALPHA: []}
    for start in range(0, 3, length):
        part = slice(start, min(start + length, 3))
        cut = {k: v[part] for k, v in arrays.items()}
        made = run_stage(
            stage("rendering"),
            params or RenderingParams(),
            cut,
            c.rig,
            c.views,
            part.stop - part.start,
            path=path.slice(part),
            **more,
        )  # type: ignore[attr-defined]
        for name in out:
            out[name].append(made[name])
    return {k: np.concatenate(v) for k, v in out.items()}


def test_held_out_views_with_true_depth(person: PersonCapture, arrays: dict[str, np.ndarray]) -> None:
    path = make_path("held_out", person.rig, person.views, np.arange(3))
    out = render(person, arrays, path)
    assert out[COLOR].shape == (3, 2, 48, 48, 3)
    assert out[ALPHA].shape == (3, 2, 48, 48)
    for c, view in enumerate(person.views.held_out):
        # 31.5 and 32.4 dB when written; a person 48 px high is mostly silhouette, and half-pixel Gaussians widen it
        assert psnr(out[COLOR][:, c], person.color[:, view], 255.0, 100.0) > 29
        # The rim of the masks' hull is a share of a pixel softer than the mask, and a pixel is much of a person of 48.
        assert out[ALPHA][:, c][person.mask[:, view] == 255].mean() > 238
        assert out[ALPHA][:, c][person.mask[:, view] == 0].mean() < 2.5
    assert (out[COLOR].max(axis=-1) <= out[ALPHA].astype(int) + 1).all()  # premultiplied


@pytest.mark.parametrize("at_once", [1, reading.AT_ONCE])
def test_partitions_change_nothing(
    person: PersonCapture, arrays: dict[str, np.ndarray], monkeypatch: pytest.MonkeyPatch, at_once: int
) -> None:
    """However many frames are read at once."""
    monkeypatch.setattr(reading, "AT_ONCE", at_once)
    path = make_path("orbit", person.rig, person.views, np.arange(3))
    whole = render(person, arrays, path)
    for length in (1, 2):
        cut = render(person, arrays, path, length)
        assert all(np.array_equal(whole[k], cut[k]) for k in whole)


def test_unserved_frames_are_black_and_smaller_cameras_are_padded(
    person: PersonCapture, arrays: dict[str, np.ndarray]
) -> None:
    path = make_path("held_out", person.rig, person.views, np.arange(3))
    served = path.served.copy()
    served[1, 0] = False
    size = path.size.copy()
    size[1] = (20, 30)
    # A hole may be open in a smaller picture.
    plain = frozenset({"silhouette_clipping"})
    out = render(person, arrays, dataclasses.replace(path, served=served, size=size), effects=plain)
    whole = render(person, arrays, path, effects=plain)
    assert not out[COLOR][1, 0].any()
    assert np.array_equal(out[COLOR][0, 0], whole[COLOR][0, 0])
    assert not out[COLOR][:, 1, 30:].any()
    assert not out[COLOR][:, 1, :, 20:].any()
    assert np.array_equal(out[COLOR][:, 1, :30, :20], whole[COLOR][:, 1, :30, :20])


@pytest.mark.parametrize("off", ["", "source_detail", "hole_filling", "silhouette_clipping", "outline_evening"])
def test_a_camera_that_looks_past_the_subject_shows_nothing_and_leaves_the_others_alone(
    person: PersonCapture, arrays: dict[str, np.ndarray], off: str
) -> None:
    """Whatever of pictures with something in them is retouched."""
    path = make_path("held_out", person.rig, person.views, np.arange(3))
    away = path.world_to_camera.copy()
    away[:, 1] = np.diag([-1.0, 1.0, -1.0, 1.0]) @ away[:, 1]
    every = frozenset({"source_detail", "hole_filling", "silhouette_clipping", "outline_evening"})
    out, whole = (
        render(person, arrays, p, effects=every - {off})
        for p in (dataclasses.replace(path, world_to_camera=away), path)
    )
    for name in (COLOR, ALPHA):
        assert not out[name][:, 1].any()
        assert whole[name][:, 1].any()
        np.testing.assert_array_equal(out[name][:, 0], whole[name][:, 0])


def test_held_out_pictures_are_never_looked_at(person: PersonCapture, arrays: dict[str, np.ndarray]) -> None:
    noise = arrays["frames/color"].copy()
    noise[:, 8:] = np.random.default_rng(0).integers(0, 255, noise[:, 8:].shape)
    masks = arrays["frames/mask"].copy()
    masks[:, 8:] = noise[:, 8:, ..., 0]
    path = make_path("held_out", person.rig, person.views, np.arange(3))
    assert np.array_equal(
        render(person, arrays, path)[COLOR],
        render(person, arrays | {"frames/color": noise, "frames/mask": masks}, path)[COLOR],
    )


@pytest.mark.parametrize("off", ["silhouette_clipping", "hole_filling"])
def test_masks_are_not_read_without_the_effects_and_clipping_adds_no_alpha(
    person: PersonCapture, arrays: dict[str, np.ndarray], off: str
) -> None:
    path = make_path("held_out", person.rig, person.views, np.arange(3))
    without = {k: v for k, v in arrays.items() if k != "frames/mask"}
    plain = render(person, without, path, effects=frozenset())
    one = render(person, arrays, path, effects=frozenset({"silhouette_clipping", "hole_filling"} - {off}))
    sign = 1 if off == "silhouette_clipping" else -1
    assert (sign * (one[ALPHA].astype(int) - plain[ALPHA]) >= 0).all()
    assert (one[ALPHA] != plain[ALPHA]).any()


def test_masks_without_a_background_clip_nothing(person: PersonCapture, arrays: dict[str, np.ndarray]) -> None:
    path = make_path("held_out", person.rig, person.views, np.arange(3))
    everything = arrays | {"frames/mask": np.full_like(arrays["frames/mask"], 255)}
    found = render(person, everything, path, effects=frozenset({"silhouette_clipping"}))
    plain = render(person, everything, path, effects=frozenset())
    assert all(np.array_equal(found[k], plain[k]) for k in plain)


def test_a_frame_without_any_picture_is_black_and_one_missing_view_is_replaced(
    person: PersonCapture, arrays: dict[str, np.ndarray]
) -> None:
    path = make_path("held_out", person.rig, person.views, np.arange(3))
    valid = np.ones((3, 10), bool)
    valid[1] = False
    valid[2, 0] = False
    out = render(person, arrays, path, valid_all=valid)
    assert not out[ALPHA][1].any()
    assert out[ALPHA][2].any()
    assert not np.array_equal(out[COLOR][2, 0], render(person, arrays, path)[COLOR][2, 0])


def test_a_view_whose_mask_is_empty_makes_room_for_the_next_as_one_without_a_picture_does(
    person: PersonCapture, arrays: dict[str, np.ndarray]
) -> None:
    """Of the nearest view alone, as in an even ring the second says nothing beside two that are as near."""
    path, on = make_path("held_out", person.rig, person.views, np.arange(3)), frozenset({"hole_filling"})
    one = RenderingParams(sources=1)
    valid = np.ones((3, 10), bool)
    valid[:, 0] = False
    gone = render(person, arrays, path, params=one, valid_all=valid, effects=on)
    blank = {name: np.copy(a) for name, a in arrays.items()}
    blank["frames/mask"][:, 0] = blank["gaussians/opacity"][:, 0] = 0
    found = render(person, blank, path, params=one, effects=on)
    assert (found[ALPHA] != render(person, arrays, path, params=one, effects=on)[ALPHA]).any()
    assert gone[ALPHA].any(axis=(2, 3)).all(), "every held-out camera sees somebody"
    for name in gone:
        np.testing.assert_array_equal(found[name], gone[name])


def test_double_precision_gives_the_same_picture_to_a_grey_level_or_two(
    person: PersonCapture, arrays: dict[str, np.ndarray]
) -> None:
    path = make_path("still cam01", person.rig, person.views, np.arange(3))
    a = render(person, arrays, path)[COLOR].astype(int)
    b = render(person, arrays, path, params=RenderingParams(precision="float64"))[COLOR].astype(int)
    assert np.abs(a - b).max() <= 2  # a contribution of 1/255 more or less at the thresholds
    assert (a != b).mean() < 0.02


def test_s21_quantisation_clips_and_never_wraps() -> None:
    values = torch.tensor([1.2, -0.1, float("nan"), float("inf"), -float("inf"), 1.0000001, 0.5, 1 / 255])
    assert quantise(values).tolist() == [255, 0, 0, 255, 0, 255, 128, 1]


def test_check_warns_when_all_is_empty() -> None:
    blank = np.zeros((1, 1, 4, 4), np.uint8)
    assert "empty" in check(Block(ALPHA, blank), RenderingParams())[0]
    assert check(Block(ALPHA, blank + 1), RenderingParams()) == []


@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize(
    ("name", "channel"), [("gaussians/scale", (1,)), ("gaussians/opacity", (0,)), ("depth/depth", ())]
)
def test_gaussians_that_are_not_finite_are_left_out_and_spoken_of(
    person: PersonCapture, arrays: dict[str, np.ndarray], name: str, channel: tuple[int, ...], bad: float
) -> None:
    """The pictures of the scene without that pixel of the eight views, and one sentence with the frame's number."""
    path = make_path("held_out", person.rig, person.views, np.arange(3))
    row, column = np.argwhere((arrays["gaussians/opacity"][2, :8, 0] > 0).all(axis=0))[0]
    broken, without = (
        arrays | {name: arrays[name].copy()},
        arrays | {"gaussians/opacity": arrays["gaussians/opacity"].copy()},
    )
    broken[name][(2, slice(0, 8), *channel, row, column)] = bad
    without["gaussians/opacity"][2, :8, :, row, column] = 0
    blocks = list(
        run(
            MemoryInputs(
                stage("rendering"), RenderingParams(), broken, person.rig, person.views, range(3), 3, path=path
            ),
            RenderingParams(),
        )
    )
    expected = render(person, without, path)
    assert all(np.array_equal(np.asarray(b.data), expected[b.array]) for b in blocks)
    (said,) = [n for b in blocks for n in b.notes]
    # of two views, and of those that face the camera
    assert re.fullmatch("[12] Gaussians of frame 2 were not finite and were left out", said)


def test_what_was_left_out_is_one_sentence_a_partition() -> None:
    assert masked_note(np.zeros((3, 2), int), np.arange(46, 49)) == ()
    (said,) = masked_note(np.array([[0, 0], [3, 5], [0, 1]]), np.arange(46, 52, 2))
    assert (
        said
        == "5 Gaussians of frame 48 were not finite and were left out; so were others in 1 more of the frames 46-50"
    )
