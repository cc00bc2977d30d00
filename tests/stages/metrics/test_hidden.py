"""Pixels in which the subject stands behind something count for nothing, and are said."""

from __future__ import annotations

import numpy as np
import pytest

from posegaussian.stages.camera_paths.paths import make_path
from posegaussian.stages.contract.declaration import resolve
from posegaussian.stages.contract.io import Block, Views
from posegaussian.stages.contract.judged import GIVEN_MATTE, PERSON_MATTE, PLATE_MATTE
from posegaussian.stages.metrics.params import MetricsParams
from posegaussian.stages.metrics.run import LEFT_OUT, measure
from posegaussian.stages.registry import stage
from posegaussian.stages.simulator.subjects.capsule_person import PersonCapture, capture_person
from tests.support.memory_inputs import MemoryInputs

HELD_OUT, SIZE = 3, 128


@pytest.fixture(scope="module")
def person() -> PersonCapture:
    return capture_person(views=8, size=SIZE, frames=1)


def metrics(person: PersonCapture, post: bool, facts: frozenset[str] = frozenset()) -> Block:
    """Of a rendering that is the person as filmed without a post, a little off."""
    views = Views(person.rig.names, tuple(v for v in range(len(person.rig)) if v != HELD_OUT), (HELD_OUT,))
    mask, noise = person.mask.copy(), np.random.default_rng(0).integers(0, 9, (1, 1, SIZE, SIZE, 3))
    if post:
        middle = int(np.median(np.nonzero(mask[0, HELD_OUT])[1]))
        mask[0, HELD_OUT, :, middle - 4 : middle + 4] = 0
    rendered = np.clip(person.color[:, [HELD_OUT]].astype(int) + noise, 0, 255).astype(np.uint8)
    arrays = {"frames/color": person.color, "frames/mask": mask, "rendering/{path}/color": rendered}
    path = make_path("held_out", person.rig, views, np.arange(1))
    inputs = MemoryInputs(
        stage("metrics"), MetricsParams(), arrays, person.rig, views, range(1), 1, path=path, facts=facts
    )
    (block,) = resolve(stage("metrics").run)(inputs, MetricsParams())
    return block


def values(block: Block, measure: str) -> dict[str, float]:
    rows = zip(*(block.data[k] for k in ("region", "measure", "value")), strict=True)
    return {region: value for region, name, value in rows if name == measure}


def test_a_post_before_a_held_out_camera_costs_nothing(person: PersonCapture) -> None:
    """What the camera cannot see of the subject is no error of the rendering: noise is what it was, to 0.5 dB, since
    other pixels are counted and a narrow rim of the post remains."""
    clean, behind = metrics(person, post=False), metrics(person, post=True)
    assert values(behind, "psnr")["full"] == pytest.approx(values(clean, "psnr")["full"], abs=0.5)
    assert not clean.notes
    assert not any(LEFT_OUT in d for d in clean.data["definition"])
    (note,) = behind.notes
    assert note.startswith(f"{person.rig.names[HELD_OUT]}: the subject stands behind something in 1 of 1 frames")
    assert all(d.endswith(LEFT_OUT) for d in behind.data["definition"] if d is not None)


@pytest.mark.parametrize("fact", [PERSON_MATTE, PLATE_MATTE])
def test_of_a_matte_made_here_it_is_said_that_it_may_be_wrong(person: PersonCapture, fact: str) -> None:
    """What it lacks is left out as of a mask that came with the capture: nobody knows what is drawn there rightly."""
    (note,) = metrics(person, post=True, facts=frozenset({fact})).notes
    (given,) = metrics(person, post=True, facts=frozenset({GIVEN_MATTE})).notes
    assert "its matte lacks something of the subject in 1 of 1 frames" in note
    assert "or the matte is wrong" in note
    assert "wrong" not in given
    assert values(metrics(person, True, frozenset({fact})), "psnr") == values(metrics(person, True), "psnr")


def test_what_is_not_visible_changes_no_measure_of_pixels() -> None:
    random = np.random.default_rng(1)
    truth, rendered = (random.integers(0, 256, (24, 24, 3), np.uint8) for _ in range(2))
    mask, visible = np.full((24, 24), 255, np.uint8), np.ones((24, 24), bool)
    visible[:, 8:14] = False
    other = np.where(visible[..., None], rendered, 255 - rendered)
    params = MetricsParams(measures=["psnr", "ssim"])
    first, second = (measure(r, truth, mask, params, visible) for r in (rendered, other))
    assert first == second
    assert first != measure(rendered, truth, mask, params)
    everything = measure(rendered, truth, mask, params, np.ones((24, 24), bool))
    for key, value in measure(rendered, truth, mask, params).items():
        assert everything[key] == pytest.approx(value, rel=1e-12)
