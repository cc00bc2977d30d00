"""The frames kernel: what is touched, what is not, and what is refused."""

import cv2
import numpy as np
import pytest

from posegaussian.stages.contract.io import Block, Views
from posegaussian.stages.frames.params import FramesParams
from posegaussian.stages.frames.run import check, run
from posegaussian.stages.frames.stage import STAGE
from posegaussian.stages.geometry.projection import pixel_centres
from posegaussian.stages.imaging.camera_mapping import frames_rig
from posegaussian.stages.imaging.color import to_display
from posegaussian.stages.simulator.subjects.capsule_person import capture_person
from posegaussian.storage.model.cameras import Rig, points_to_integer_centres
from posegaussian.storage.model.crop import Crop, captured_to_calibrated
from posegaussian.storage.model.errors import SourceError
from tests.support.frame_readers import Pictures
from tests.support.memory_inputs import MemoryInputs, run_stage


def _rig(sizes: list[tuple[int, int]], distortion: np.ndarray | None = None) -> Rig:
    n = len(sizes)
    k = np.stack([np.array([[1.1 * w, 0, w / 2 + 1.3], [0, 1.1 * w, h / 2 - 2.1], [0, 0, 1]]) for w, h in sizes])
    d = np.zeros((n, 8)) if distortion is None else np.tile(distortion, (n, 1))
    return Rig(tuple(f"c{i}" for i in range(n)), k, d, np.tile(np.eye(4), (n, 1, 1)), np.array(sizes))


def _run(
    rig: Rig,
    params: FramesParams,
    pictures: Pictures,
    frames: int,
    sources: dict | None = None,
    length: int | None = None,
    **more,
) -> dict[str, np.ndarray]:
    views = Views(rig.names, tuple(range(len(rig))), ())
    more.setdefault("facts", frozenset({"several_frames"}))
    out: dict[str, np.ndarray] = {}
    for view in range(len(rig)):
        part = run_stage(
            STAGE,
            params,
            more.get("arrays", {}),
            frames_rig(rig, params.size),
            views,
            frames,
            length,
            view=view,
            source_rig=rig,
            sources={"pictures": pictures, **(sources or {})},
            captured_to_calibrated=captured_to_calibrated(rig.names, params.crop),
            **{k: v for k, v in more.items() if k != "arrays"},
        )
        for name, data in part.items():
            out.setdefault(name, np.zeros_like(data))[:, view] = data[:, view]
    return out


def _smooth(size: tuple[int, int], seed: int = 0) -> np.ndarray:
    noise = cv2.GaussianBlur(np.random.default_rng(seed).normal(size=(size[1], size[0], 3)), (0, 0), 4)
    return np.clip(128 + 45 * noise / noise.std(), 0, 255).astype(np.uint8)


def test_pictures_that_need_nothing_are_untouched_and_partitions_do_not_matter() -> None:
    capture = capture_person(3, 48, 5, 0)
    pictures, masks, depth = (
        Pictures([list(a[:, v]) for v in range(3)]) for a in (capture.color, capture.mask, capture.depth)
    )
    facts = frozenset({"masks", "truth_depth", "several_frames"})
    for length in (5, 2, 1):
        out = _run(capture.rig, FramesParams(), pictures, 5, {"masks": masks, "depth": depth}, length, facts=facts)
        np.testing.assert_array_equal(out["frames/color"], capture.color)
        np.testing.assert_array_equal(out["frames/mask"], capture.mask)
        np.testing.assert_array_equal(out["truth/depth"], capture.depth)


def test_smaller_views_are_padded_and_missing_frames_are_black_and_not_read() -> None:
    rig = _rig([(40, 30), (24, 36)])
    white = (
        [np.full((30, 40, 3), 255, np.uint8)] * 3,
        [
            np.full((36, 24, 3), 255, np.uint8),
            None,
            np.full((36, 24, 3), 255, np.uint8),
        ],
    )
    valid = np.array([[True, True], [True, False], [True, True]])
    out = _run(rig, FramesParams(matte="none"), Pictures([list(w) for w in white]), 3, valid_all=valid)
    assert out["frames/color"].shape == (3, 2, 36, 40, 3)
    for v, (w, h) in enumerate([(40, 30), (24, 36)]):
        expected = np.zeros((3, 36, 40), np.uint8)
        expected[valid[:, v], :h, :w] = 255
        np.testing.assert_array_equal(out["frames/mask"][:, v], expected)
        np.testing.assert_array_equal(out["frames/color"][:, v], np.repeat(expected[..., None], 3, -1))


@pytest.mark.parametrize("level", [0, 90, 255])
def test_a_picture_that_shows_nothing_counts_as_none_and_is_named(level: int) -> None:
    """One black, grey or white frame of one camera, whose mask holds the person as ever; noise shows nothing."""
    capture = capture_person(3, 48, 5, 0)
    noise = np.random.default_rng(0).normal(level, 3, (48, 48, 3))
    color = capture.color.copy()
    color[2, 1] = np.clip(noise, 0, 255)
    pictures, masks = (Pictures([list(a[:, v]) for v in range(3)]) for a in (color, capture.mask))
    facts = frozenset({"masks", "several_frames"})
    for length in (5, 2):
        out = _run(capture.rig, FramesParams(), pictures, 5, {"masks": masks}, length, facts=facts)
        assert not out["frames/color"][2, 1].any()
        assert not out["frames/mask"][2, 1].any()
        for found, given in (("frames/color", capture.color), ("frames/mask", capture.mask)):
            others = np.ones((5, 3), bool)
            others[2, 1] = False
            np.testing.assert_array_equal(out[found][others], given[others])
    inputs = MemoryInputs(
        STAGE,
        FramesParams(),
        {},
        capture.rig,
        Views(capture.rig.names, (0, 1, 2), ()),
        range(5),
        5,
        view=1,
        sources={"pictures": pictures, "masks": masks},
        facts=facts,
    )
    (told,) = [note for block in run(inputs, FramesParams()) for note in block.notes]
    assert "frame 2 show nothing" in told


def test_scaling_averages_areas_and_depth_is_never_mixed() -> None:
    rig = _rig([(64, 48)])
    picture = np.random.default_rng(1).integers(0, 256, (48, 64, 3), dtype=np.uint8)
    depth = np.where(np.arange(64)[None] < 31, 0.0, 2.5).repeat(48, 0).astype(np.float32)
    out = _run(
        rig,
        FramesParams(size=32, matte="none"),
        Pictures([[picture]]),
        1,
        {"depth": Pictures([[depth]])},
        facts=frozenset({"truth_depth"}),
    )
    mean = picture.reshape(24, 2, 32, 2, 3).astype(float).mean(axis=(1, 3))
    assert np.abs(out["frames/color"][0, 0] - mean).max() <= 0.5
    assert set(np.unique(out["truth/depth"])) == {0.0, 2.5}
    np.testing.assert_array_equal(
        out["truth/depth"][0, 0, 0], np.where(np.arange(32) < 15, 0.0, 2.5).astype(np.float32)
    )


@pytest.mark.parametrize("scale", [1.00741, 1.5, 0.5])
def test_crop_and_distortion_bring_captured_colours_where_the_frames_rig_sees_them(scale: float) -> None:
    lens = np.array([-0.2, 0.05, 0.002, -0.001, 0, 0, 0, 0])
    rig, crop = _rig([(320, 240)], lens), Crop(scale=scale, offset=(5.0, -7.11))
    captured = (round(330 / scale), round(250 / scale))
    picture = _smooth(captured)
    params = FramesParams(matte="none", crop={"c0": crop})
    out = _run(rig, params, Pictures([[picture]]), 1)
    # Where OpenCV's own undistortion map looks, in integer centres; then the crop.
    k = rig.intrinsics[0].copy()
    k[:2, 2] -= 0.5
    x, y = cv2.initUndistortRectifyMap(k, lens, None, k, (320, 240), cv2.CV_32FC1)
    positions = (np.stack([x, y], -1) + 0.5 - crop.offset) / scale
    inside = np.all((positions >= 0) & (positions <= captured), axis=-1)
    expected = cv2.remap(
        picture.astype(np.float32),
        (positions - 0.5).astype(np.float32),
        None,
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )
    # Rounding and the 1/32 px of cv2.remap; the area average that precedes a crop of scale 0.5 takes some contrast.
    # Half a pixel would cost 4 in the mean.
    difference = np.abs(out["frames/color"][0, 0].astype(float) - expected)[inside]
    assert difference.mean() < (0.5 if scale >= 1 else 1.6)
    np.testing.assert_array_equal(out["frames/mask"][0, 0] > 0, inside)
    assert not out["frames/color"][0, 0][~inside].any()


def test_a_pixel_of_depth_under_a_warp_is_the_captured_pixel_it_falls_into() -> None:
    rig = _rig([(64, 48)], np.array([-0.1, 0, 0, 0, 0, 0, 0, 0]))
    index = (1 + np.arange(48 * 64)).reshape(48, 64).astype(np.float32)
    out = _run(
        rig,
        FramesParams(matte="none", size=40),
        Pictures([[np.zeros((48, 64, 3), np.uint8)]]),
        1,
        {"depth": Pictures([[index]])},
        facts=frozenset({"truth_depth"}),
    )
    frames = frames_rig(rig, 40)
    ideal = (pixel_centres((40, 30)) - frames.intrinsics[0, :2, 2]) / frames.intrinsics[0, [0, 1], [0, 1]]
    points = np.concatenate([ideal, np.ones((30, 40, 1))], -1).reshape(-1, 1, 3)
    k = rig.intrinsics[0].copy()
    k[:2, 2] = points_to_integer_centres(k[:2, 2])
    u, v = np.rint(cv2.projectPoints(points, np.zeros(3), np.zeros(3), k, rig.distortion[0])[0][:, 0].T).astype(int)
    inside = (u >= 0) & (u < 64) & (v >= 0) & (v < 48)
    np.testing.assert_array_equal(out["truth/depth"][0, 0].ravel()[inside], index[v[inside], u[inside]])


def test_linear_light_is_encoded_and_clipped() -> None:
    picture = np.array([0.0, 0.0031308, 0.18, 1.0, 40.0, np.nan, np.inf, -1.0], np.float16)[None, :, None].repeat(3, -1)
    # 0.18 is 117.6 of 255 by IEC 61966-2-1; float16 keeps eleven bits.
    np.testing.assert_array_equal(to_display(picture)[0, :, 0], [0, 10, 118, 255, 255, 0, 255, 0])
    same = np.arange(256, dtype=np.uint8)
    assert to_display(same) is same


def test_a_picture_that_reaches_beyond_the_calibrated_one_is_cut() -> None:
    padded = np.zeros((34, 40, 3), np.uint8)
    padded[:30] = _smooth((40, 30))
    out = _run(_rig([(40, 30)]), FramesParams(matte="none"), Pictures([[padded]]), 1)
    np.testing.assert_array_equal(out["frames/color"][0, 0], padded[:30])


def test_sizes_that_contradict_are_refused_with_both_named() -> None:
    rig = _rig([(40, 30)])
    picture = Pictures([[np.zeros((30, 40, 3), np.uint8)]])
    with pytest.raises(SourceError, match=r"c0: a mask is 20x15 px but its picture is 40x30"):
        _run(
            rig,
            FramesParams(),
            picture,
            1,
            {"masks": Pictures([[np.zeros((15, 20), np.uint8)]])},
            facts=frozenset({"masks"}),
        )
    with pytest.raises(SourceError, match=r"38x30 px among pictures of 40x30"):
        _run(rig, FramesParams(matte="none"), Pictures([[picture.views[0][0], np.zeros((30, 38, 3), np.uint8)]]), 2)


def test_given_masks_are_cut_where_the_captured_picture_ends() -> None:
    rig = _rig([(40, 30)])
    params = FramesParams(crop={"c0": Crop(scale=1.0, offset=(10.0, 0.0))})
    picture, mask = np.full((30, 40, 3), 200, np.uint8), np.full((30, 40), 255, np.uint8)
    out = _run(rig, params, Pictures([[picture]]), 1, {"masks": Pictures([[mask]])}, facts=frozenset({"masks"}))
    assert not out["frames/mask"][0, 0, :, :10].any()
    assert (out["frames/mask"][0, 0, :, 10:] == 255).all()


def test_a_plate_s_matte_ends_where_the_captured_picture_ends() -> None:
    rig = _rig([(64, 64)])
    params = FramesParams(matte="plate", crop={"c0": Crop(scale=1.0, offset=(10.0, 0.0))})
    plate = np.full((1, 64, 64, 3), 150, np.uint8)
    picture = plate[0].copy()
    picture[10:50, :30] = (250, 30, 30)
    arrays = {"survey/plate": plate, "survey/spread": np.zeros((1, 64, 64), np.uint8)}
    mask = _run(rig, params, Pictures([[picture]]), 1, arrays=arrays)["frames/mask"][0, 0]
    assert not mask[:, :10].any()
    assert (mask[15:45, 12:38] == 255).all()


def test_check_refuses_impossible_depth() -> None:
    with pytest.raises(ValueError, match=r"truth/depth of view 1.*nan"):
        check(Block("truth/depth", np.array([[[1.0, np.nan]]], np.float32), 1), FramesParams())
    assert check(Block("truth/depth", np.array([[[1.0, 0.0]]], np.float32), 1), FramesParams()) == []
