"""The kernel: every view, declared shapes, zeros where a view is no source, partitions that change nothing."""

import numpy as np
import pytest

from posegaussian.stages.contract.declaration import resolve
from posegaussian.stages.contract.facts import Facts
from posegaussian.stages.contract.io import Block
from posegaussian.stages.frames.facts import NOISE_AVERAGING
from posegaussian.stages.gaussians.params import GaussiansParams
from posegaussian.stages.gaussians.run import check, prior
from posegaussian.stages.network.params import depth_array
from posegaussian.stages.registry import stage
from posegaussian.stages.simulator.subjects.capsule_person import PersonCapture, capture_person
from tests.support.memory_inputs import run_stage


@pytest.fixture(scope="module")
def person() -> PersonCapture:
    return capture_person(views=3, size=32, frames=3, held_out=1)


def maps(c: PersonCapture, length: int | None = None) -> dict[str, np.ndarray]:
    arrays = {"depth/depth": c.depth, "depth/confidence": (c.depth > 0).astype(np.float16), "frames/mask": c.mask}
    return run_stage(stage("gaussians"), GaussiansParams(), arrays, c.rig, c.views, len(c.depth), length)


def test_all_views_are_written_and_only_sources_hold_gaussians(person: PersonCapture) -> None:
    out = maps(person)
    for name, channels in (("scale", 3), ("rotation", 3), ("opacity", 2), ("confidence", 1)):
        data = out[f"gaussians/{name}"]
        assert data.shape == (3, 4, channels, 32, 32)
        assert np.isfinite(data).all()
        assert not data[:, 3].any()
    assert not out["gaussians/confidence"].any()
    seen = (person.depth[:, :3] > 0) & (person.mask[:, :3] > 0)
    assert ((out["gaussians/opacity"][:, :3, 0] > 0) == seen).all()


def test_the_part_that_holds_somebody_is_lifted_as_in_the_whole_picture(person: PersonCapture) -> None:
    out = maps(person)
    for view in range(3):
        depth, sure, mask = person.depth[0, view], (person.depth[0, view] > 0).astype(np.float16), person.mask[0, view]
        assert not depth[:, 0].any(), "the person does not begin at the picture's corner"
        whole = prior(depth, sure, mask, person.rig.intrinsics[view], GaussiansParams())
        for name, data in zip(("scale", "rotation", "opacity"), whole, strict=True):
            # rays are the same but for the rounding of a principal point that is moved
            np.testing.assert_allclose(out[f"gaussians/{name}"][0, view], data.astype(np.float16), rtol=2e-3, atol=1e-6)


def test_partitions_change_nothing(person: PersonCapture) -> None:
    whole = maps(person)
    for length in (1, 2):
        cut = maps(person, length)
        assert all(np.array_equal(cut[name], whole[name]) for name in whole)


def test_depth_of_a_subject_at_rest_is_averaged_whatever_the_partition(person: PersonCapture) -> None:
    """While the effect is on: a frame's own error goes, and other stages lift from what is written here."""
    depth = np.repeat(person.depth[:1], 9, axis=0)
    depth[4] *= np.float32(1.3)
    arrays = {
        "depth/depth": depth,
        "depth/confidence": (depth > 0).astype(np.float16),
        "frames/mask": np.repeat(person.mask[:1], 9, axis=0),
        "frames/color": np.repeat(person.color[:1], 9, axis=0),
        "survey/unrest": np.full((4, 4), 2.0),
    }
    found = [
        run_stage(
            stage("gaussians"), GaussiansParams(), arrays, person.rig, person.views, 9, length,
            effects=frozenset({NOISE_AVERAGING}),
        )
        for length in (None, 2)
    ]  # fmt: skip
    assert all(np.array_equal(found[0][name], found[1][name]) for name in found[0])
    # it lies on another surface, as far as its own frame alone can tell
    np.testing.assert_allclose(found[0]["gaussians/depth"][:, :3], depth[:1, :3].repeat(9, axis=0), rtol=1e-6)
    assert not found[0]["gaussians/depth"][:, 3].any()
    assert depth_array(Facts(frozenset({NOISE_AVERAGING}))) == "gaussians/depth"
    assert "gaussians/depth" not in maps(person)


def test_check_names_what_is_impossible(person: PersonCapture) -> None:
    assert resolve(stage("gaussians").check or "") is check
    params = GaussiansParams()
    for name, data in maps(person).items():
        assert check(Block(name, data[:, 0], 0), params) == []
    zeros = np.zeros((1, 3, 2, 2), np.float16)
    with pytest.raises(ValueError, match="not finite"):
        check(Block("gaussians/scale", zeros + np.nan, 1), params)
    with pytest.raises(ValueError, match="bound 0 m"):
        check(Block("gaussians/scale", zeros - 1, 1), params)
    with pytest.raises(ValueError, match="normal of length"):
        check(Block("gaussians/rotation", zeros + 1, 1), params)
    with pytest.raises(ValueError, match=r"bounds 0\.\.1"):
        check(Block("gaussians/opacity", zeros + 2, 1), params)
