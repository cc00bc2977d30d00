"""Light beyond white: brought below it where a capture has some, clipped where that is asked for, and left alone
where there is none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from posegaussian.dags.planning.results import Results
from posegaussian.dags.planning.selection import Selection
from posegaussian.stages.imaging.color import to_linear, tone_mapped
from tests.laws.test_effects import filmed, pipeline, state
from tests.support.pipeline import Pipeline

FRAMES = Selection(only=frozenset({"survey", "frames"}))
SETTINGS = [
    "effects.exposure_matching=off",
    "effects.temporal_smoothing=on",
    "effects.outline_correction=off",
    "effects.gap_opening=off",
    "effects.outline_redrawing=off",
    "effects.limb_bounds=off",
    "effects.silhouette_clipping=on",
    "effects.hole_filling=on",
    "effects.outline_evening=on",
]


def in_linear_light(folder: Path, times: float, *settings: str) -> Pipeline:
    """The person filmed in EXR, with so many times the light."""
    scene = filmed(views=3)
    scene["color"] = (to_linear(scene["color"]) * times).astype(np.float16)
    return pipeline(folder, scene, *SETTINGS, *settings)


def test_light_beyond_white_is_kept_apart_and_one_curve_serves_all_frames(tmp_path: Path) -> None:
    on, off = in_linear_light(tmp_path, 6.0), in_linear_light(tmp_path, 6.0, "effects.tone_mapping=off")
    truth = (to_linear(filmed(views=3)["color"]) * 6.0).astype(np.float16)
    for p in (on, off):
        p.run(selection=FRAMES, expect_failure=True)
    assert state(on, "tone_mapping") == "on"
    assert "lies beyond white" in on.plan().context.effects["tone_mapping"].sentence
    for view in (0, 3):  # a source and a held-out view
        mapped, clipped = (Results(p.context()).read("frames/color", range(2), view) for p in (on, off))
        hot = truth[:, view].max(axis=-1) > 1.2
        assert hot.sum() > 20
        assert (clipped[hot].max(axis=-1) == 255).all()
        # What is brighter by a fifth is shown brighter, whichever frame it is in.
        light, shown = truth[:, view][hot].astype(float).max(axis=-1), mapped[hot].max(axis=-1).astype(int)
        order = np.argsort(light)
        assert (np.diff(shown[order]) >= -1).all()
        assert shown.max() - shown.min() > 20


def test_a_scene_within_white_and_ordinary_pictures_are_left_alone(tmp_path: Path) -> None:
    linear = in_linear_light(tmp_path / "linear", 0.9)
    linear.run(selection=FRAMES, expect_failure=True)
    assert state(linear, "tone_mapping") == "off"
    ordinary = pipeline(tmp_path / "ordinary", filmed(views=3))
    decision = ordinary.plan().context.effects["tone_mapping"].decision
    assert decision is not None
    assert not decision.on
    assert "EXR" in decision.reason


@pytest.mark.parametrize("white", [1.0, 4.0, 50.0])
def test_the_curve(white: float) -> None:
    grey = np.repeat(np.linspace(0, 2 * white, 200, dtype=np.float16)[None, :, None], 3, axis=2)
    shown = tone_mapped(grey, np.ones(3), white)[0, :, 0].astype(int)
    assert (np.diff(shown) >= 0).all()
    assert shown[grey[0, :, 0] >= white].min() == 255
    assert tone_mapped(np.full((1, 1, 3), white * 0.5, np.float16), np.ones(3), white).max() < 255
    # Hue: the ratio of two channels' light stays; dark light stays as it is, to a hundredth of itself.
    red = tone_mapped(np.array([[[white / 2, white / 4, 0.0]]], np.float16), np.ones(3), white)
    assert to_linear(red[0, 0, 0]) == pytest.approx(2 * to_linear(red[0, 0, 1]), rel=0.03)
    assert not red[0, 0, 2]
    dark = tone_mapped(np.full((1, 1, 3), 0.01, np.float16), np.ones(3), white)
    assert to_linear(dark[0, 0, 0]) == pytest.approx(0.01, rel=0.04)  # an 8-bit step is 3 %
    np.testing.assert_array_equal(
        tone_mapped(np.array([[[np.inf, 0, 0], [np.nan, 0, 0]]], np.float16), np.ones(3), white)[0, :, 0], [255, 0]
    )
    twice = tone_mapped(np.full((1, 1, 3), 0.4, np.float16), np.full(3, 2.0), white)
    assert np.abs(twice.astype(int) - tone_mapped(np.full((1, 1, 3), 0.8, np.float16), np.ones(3), white)).max() <= 1


def test_outlines_are_redrawn_by_the_pictures_whatever_maps_their_tones(tmp_path: Path) -> None:
    """Masks are made before tones are mapped, of pictures that are clipped at white."""
    on = "effects.outline_redrawing=on"
    mapped, clipped = in_linear_light(tmp_path, 6.0, on), in_linear_light(tmp_path, 6.0, on, "effects.tone_mapping=off")
    for p in (mapped, clipped):
        p.run(selection=FRAMES, expect_failure=True)
    for view in (0, 1):
        masks = [Results(p.context()).read("frames/mask", range(2), view) for p in (mapped, clipped)]
        np.testing.assert_array_equal(*masks)
        assert (masks[0] != filmed(views=3)["mask"][:, view]).any()
