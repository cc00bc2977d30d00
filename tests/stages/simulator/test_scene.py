"""Scenes, their cameras, and the laws of the take: what is off does not exist, order and threads change nothing."""

import dataclasses
import importlib
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest

from posegaussian.stages.contract.declaration import resolve
from posegaussian.stages.geometry.projection import project, unproject
from posegaussian.stages.simulator import setup, take
from posegaussian.stages.simulator.effects import registry
from posegaussian.stages.simulator.effects.registry import EFFECTS
from posegaussian.stages.simulator.rigs import make_rig
from posegaussian.stages.simulator.scene import Scene, faults
from posegaussian.stages.simulator.setup import stage
from posegaussian.stages.simulator.take import OF_CAMERAS, Shot
from posegaussian.storage.model.cameras import Rig
from posegaussian.storage.model.errors import ConfigError

EVERYTHING: dict[str, Any] = {
    "lens_distortion": {"k1": -0.1}, "calibration_error": {"pixels": 0.5}, "dropped_frames": {"share": 0.3},
    "time_offset": "on", "occluding_object": {"position": [1.0, 0.05]}, "second_person": "on",
    "cloth_motion": "on", "motion_blur": {"moments": 2, "switch": "on"}, "rolling_shutter": "on",
    "ambient_occlusion": {"directions": 8}, "cast_shadow": "on", "specular": "on",
    "background_room": "on", "depth_of_field": {"aperture": 0.5, "switch": "on"}, "vignetting": "on",
    "camera_gain": "on", "sensor_noise": "on", "jpeg": "on",
    "mask_error": {"grow": 1, "wobble": 1, "holes": 1}, "soft_matte": "on", "joint_noise": "on",
}  # fmt: skip


def scene(**changes: Any) -> Scene:
    base = {"seed": 4, "frames": 4, "motion": "kick", "rig": {"cameras": 3, "size": [48, 64]}, "held_out": 1}
    return Scene.model_validate({**base, **changes})


def same(a: Shot, b: Shot) -> bool:
    return all(np.array_equal(getattr(a, f.name), getattr(b, f.name)) for f in dataclasses.fields(Shot))


def test_every_effect_is_in_this_test() -> None:
    assert list(EVERYTHING) == [e.name for e in EFFECTS]


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda e: e.name)
def test_an_effect_says_what_it_does_in_what_unit_and_where(effect: Any) -> None:
    assert effect.effect.summary.endswith(".")
    assert effect.effect.unit
    assert effect.effect.measure
    module = importlib.import_module(effect.apply.partition(":")[0])
    assert module.__name__.endswith(effect.name)
    assert module.__doc__.endswith(".")
    assert callable(resolve(effect.apply))
    assert {"switch"} < set(effect.params.model_fields)


@pytest.fixture(scope="module")
def plain() -> Shot:
    return stage(scene()).take.shoot(1, 0)


@pytest.mark.parametrize("name", [e.name for e in EFFECTS])
def test_an_effect_changes_something_and_one_that_is_off_changes_and_computes_nothing(
    name: str, plain: Shot, monkeypatch: pytest.MonkeyPatch
) -> None:
    bare = stage(scene())
    on = stage(scene(effects={name: EVERYTHING[name]}))
    decision = {r.effect.name: r.decision for r in on.rulings}[name]
    assert decision.on, decision.reason
    shot = on.take.shoot(1, 0)
    changed = not same(shot, plain)
    written = any(
        not np.array_equal(getattr(on.written, k), getattr(bare.written, k)) for k in ("world_to_camera", "distortion")
    ) or not np.array_equal(on.valid, bare.valid)
    assert changed or written
    called: list[str] = []
    for module in (take, setup):
        monkeypatch.setattr(module, "resolve", lambda dotted: called.append(dotted) or resolve(dotted))
    off = stage(scene(effects={name: "off"}))
    assert same(off.take.shoot(1, 0), plain), "a scene without the effect, bit by bit"
    assert called == []
    assert off.take.calls == {}


def test_without_an_effect_in_the_registry_the_others_give_the_same_bytes(monkeypatch: pytest.MonkeyPatch) -> None:
    """A scene with half of the effects, and the same scene in a program that does not know the other half."""
    names = [e.name for e in EFFECTS][::2]
    effects = {n: EVERYTHING[n] for n in names}
    with_all = stage(scene(effects=effects))
    monkeypatch.setattr(setup, "EFFECTS", tuple(e for e in registry.EFFECTS if e.name in names))
    with_half = stage(scene(effects=effects))
    np.testing.assert_array_equal(with_all.valid, with_half.valid)
    assert same(with_all.take.shoot(2, 0), with_half.take.shoot(2, 0))


def test_order_and_threads_change_no_byte() -> None:
    wanted = [(0, 1), (3, 0), (2, 3)]
    first = stage(scene(effects=EVERYTHING)).take
    forwards = [first.shoot(*w) for w in wanted]
    second = stage(scene(effects=EVERYTHING)).take
    backwards = [second.shoot(*w) for w in wanted[::-1]][::-1]
    third = stage(scene(effects=EVERYTHING)).take
    third.prepare()
    with ThreadPoolExecutor(2) as pool:
        threaded = list(pool.map(lambda w: third.shoot(*w), wanted))
    for a, b, c in zip(forwards, backwards, threaded, strict=True):
        assert same(a, b)
        assert same(a, c)


def test_held_out_cameras_are_rulers() -> None:
    """Their lens, shutter, sensor and labels are perfect; what happens in the scene they see as all others do."""
    spoilt = {e.name: EVERYTHING[e.name] for e in EFFECTS if e.phase in {*OF_CAMERAS, "rig", "calibration", "times"}}
    clean, dirty = stage(scene()), stage(scene(effects=spoilt))
    assert clean.sources == dirty.sources == 3
    assert same(clean.take.shoot(2, 3), dirty.take.shoot(2, 3))
    assert not same(clean.take.shoot(2, 2), dirty.take.shoot(2, 2))
    for key in ("intrinsics", "distortion", "world_to_camera"):
        np.testing.assert_array_equal(getattr(clean.written, key)[3], getattr(dirty.written, key)[3])


def test_truth_agrees_with_itself(plain: Shot) -> None:
    staged = stage(scene(rig={"cameras": 4, "size": [160, 200]}, motion="crossed_arms", held_out=0))
    rig, shots = staged.take.rig, [staged.take.shoot(1, v) for v in range(4)]
    for v, s in enumerate(shots):
        # a gap between two fingers may pass between the four samples and show at the pixel's centre,
        # or the other way round
        assert ((s.true_mask == 255) & (s.depth == 0)).sum() + ((s.true_mask == 0) & (s.depth > 0)).sum() <= 4
        assert (s.color.max(axis=-1) <= s.true_mask.astype(int) + 1).all(), "premultiplied on black"
        lengths = np.linalg.norm(s.normal, axis=-1)
        np.testing.assert_allclose(lengths[s.depth > 0], 1.0, atol=1e-5)
        ray = (
            np.concatenate(
                [np.stack(np.meshgrid(np.arange(160) + 0.5, np.arange(200) + 0.5), axis=-1), np.ones((200, 160, 1))],
                axis=-1,
            )
            @ np.linalg.inv(rig.intrinsics[v]).T
        )
        assert (np.sum(s.normal * ray, axis=-1)[s.depth > 0] < 1e-6).all(), "a surface seen faces the camera"
        assert s.true_joints2d is not None
        assert s.joints3d is not None
        np.testing.assert_allclose(
            project(s.joints3d, rig.intrinsics[v], rig.world_to_camera[v])[0], s.true_joints2d[:, :2]
        )
    front, behind = shots[0].true_joints2d, shots[2].true_joints2d
    assert front is not None
    assert behind is not None
    assert front[:3, 2].all(), "nose and eyes are seen from the front"
    assert not behind[:3, 2].any(), "and not from behind"
    points = unproject(shots[0].depth, rig.intrinsics[0], rig.world_to_camera[0])[shots[0].depth > 0]
    uv, z = project(points, rig.intrinsics[1], rig.world_to_camera[1])
    surface = shots[1].depth[np.clip(uv[:, 1].astype(int), 0, 199), np.clip(uv[:, 0].astype(int), 0, 159)]
    # nothing lies in front of what the neighbour sees; a pixel is 10 mm, on a slanted surface some times that
    assert (z > surface - 0.08)[surface > 0].mean() > 0.98


def test_the_person_fills_the_share_of_the_picture_that_is_asked_for() -> None:
    for seed in (1, 9001):
        s = stage(
            scene(seed=seed, motion="stand", rig={"cameras": 1, "size": [200, 400], "fill": 0.88}, held_out=0)
        ).take.shoot(0, 0)
        rows = np.nonzero(s.true_mask.max(axis=1) > 127)[0]
        # the share holds at the subject's axis; toes and hair reach towards the camera
        assert 0.86 < (rows[-1] - rows[0] + 1) / 400 < 0.96


def rig_of(**given: Any) -> tuple[Rig, int]:
    held_out = given.pop("held_out", 0)
    return make_rig(scene(rig=given, held_out=held_out), (0.0, 1.7))


def test_rigs() -> None:
    target = np.array([0.0, 0.0, 0.85])
    for given in (
        {},
        {"kind": "arc", "span": 90},
        {"kind": "dome", "rings": 2},
        {"kind": "stereo"},
        {"kind": "thuman", "cameras": 6},
    ):
        rig, sources = rig_of(**given, held_out=2)
        rig.check()
        assert sources == (6 if given.get("kind") == "thuman" else 8)
        assert len(rig) == sources + 2
        for v in range(len(rig)):
            uv, z = project(target, rig.intrinsics[v], rig.world_to_camera[v])
            np.testing.assert_allclose(uv, rig.size[v] / 2, atol=1e-9)
            assert z > 0
    ring, _ = rig_of(cameras=8, radius=3.0, height=1.0, held_out=8)
    angle = np.rad2deg(np.arctan2(ring.centres[:, 1], ring.centres[:, 0])) % 360
    np.testing.assert_allclose(np.sort(angle), np.arange(16) * 22.5, atol=1e-9)
    np.testing.assert_allclose(np.hypot(*ring.centres[:, :2].T), 3.0)
    pair, _ = rig_of(kind="stereo", cameras=2, baseline=0.4, held_out=1)
    assert np.linalg.norm(pair.centres[0] - pair.centres[1]) == pytest.approx(0.4)
    assert pair.centres[2, 1] == pytest.approx(0.0, abs=1e-12)
    rolled, _ = rig_of(cameras=1, roll=90.0)
    uv, _ = project(np.array([0.0, 0.0, 1.3]), rolled.intrinsics[0], rolled.world_to_camera[0])
    np.testing.assert_allclose(uv[1], 256.0, atol=20.0)
    assert uv[0] < 240, "rolled clockwise, up is to the left of the picture"
    still, moved = rig_of(cameras=4)[0], rig_of(cameras=4, jitter=0.1)[0]
    away = np.linalg.norm(still.centres - moved.centres, axis=1)
    assert (away > 0.01).all()
    assert away.max() < 0.5


@pytest.mark.parametrize(
    ("given", "gaps"),
    [
        ({"cameras": 5}, 5),
        ({"kind": "thuman", "cameras": 6}, 6),
        ({"kind": "arc", "cameras": 4, "span": 90}, 3),
        ({"kind": "arc", "cameras": 1}, 0),
        ({"kind": "stereo", "cameras": 6}, 3),
        ({"kind": "dome", "cameras": 8, "rings": 2}, 8),
        ({"kind": "dome", "cameras": 11, "rings": 3, "start": 20}, 11),
        ({"kind": "dome", "cameras": 4, "rings": 3}, 2),
        ({"kind": "dome", "cameras": 2, "rings": 3}, 0),
    ],
)
def test_held_out_cameras_stand_midway_between_neighbours_and_no_two_in_one_gap(
    given: dict[str, Any], gaps: int
) -> None:
    assert not faults(scene(rig=given, held_out=gaps))
    ((place, told),) = faults(scene(rig=given, held_out=gaps + 1))
    assert place == ("held_out",)
    assert f"which has {gaps} gaps; at most one a gap" in told
    for count in range(1, gaps + 1):
        rig, sources = rig_of(**given, held_out=count)
        held = rig.centres[sources:]
        assert len(np.unique(held.round(6), axis=0)) == count
        for centre in held:
            beside = rig.centres[:sources][np.abs(rig.centres[:sources, 2] - centre[2]) < 1e-9]
            away = np.sort(np.linalg.norm(beside - centre, axis=1))
            assert away[0] == pytest.approx(away[1]), "as far from one neighbour as from the other"
            if len(away) > 2 and given.get("kind") != "stereo":
                assert away[0] < away[2] - 1e-6


def test_jitter_of_listed_cameras_moves_them_and_leaves_where_they_look() -> None:
    cameras = [
        {"name": "a", "position": [3.0, 0.0, 1.0], "look_at": [0.0, 1.0, 1.4], "up": [0.0, 1.0, 0.2], "roll": 20.0},
        {"name": "b", "position": [0.0, 3.0, 1.0]},
    ]
    still, moved = (rig_of(kind="list", cameras=cameras, jitter=jitter)[0] for jitter in (0.0, 0.05))
    assert (np.linalg.norm(still.centres - moved.centres, axis=1) > 0.01).all()
    for v, at in enumerate(([0.0, 1.0, 1.4], [0.0, 0.0, 0.85])):
        uv, z = project(np.array(at), moved.intrinsics[v], moved.world_to_camera[v])
        np.testing.assert_allclose(uv, moved.size[v] / 2, atol=1e-9)
        assert z > 0
        turn = still.rotations[v] @ moved.rotations[v].T
        assert np.degrees(np.arccos((np.trace(turn) - 1) / 2)) < 10, "up and roll are kept"


def test_a_camera_that_looks_at_where_it_stands_is_told_and_any_other_direction_is_one() -> None:
    cameras = [{"name": "a", "position": [3, 0, 1], "look_at": [3, 0, 1]}, {"name": "b", "position": [3, 1, 1]}]
    told = "camera a looks at where it stands, (3.0, 0.0, 1.0); name another look_at"
    assert faults(scene(rig={"kind": "list", "cameras": cameras}, held_out=0)) == [(("rig", "cameras", 0), told)]
    assert faults(scene(held_out=cameras)) == [(("held_out", 0), told)]
    with pytest.raises(ConfigError, match=r"camera c stands at \(0\.0, 0\.0, 0\.85\), the middle of the subject"):
        rig_of(kind="list", cameras=[{"name": "c", "position": [0, 0, 0.85]}])
    for up in ([0, 0, 1], [0, 1, 0], [1, 0, 0], [1, 1, 0]):
        for along in ([0, 0, 1], [0, 1, 0], [1, 0, 0], [1, 1, 0]):
            camera = {"name": "d", "position": [3.0 * a for a in along], "look_at": [0, 0, 0], "up": up}
            rig_of(kind="list", cameras=[camera])[0].check()


@pytest.mark.parametrize("last", [{"kind": "arc", "span": 40}, {"kind": "stereo", "baseline": 1.2}])
def test_a_tilted_rig_still_looks_at_the_subject_and_its_baselines_turn(last: dict[str, Any]) -> None:
    other = 3 if last["kind"] == "arc" else 1

    def baselines(**held: float) -> np.ndarray:
        rig, _ = rig_of(cameras=4, height=0.85, start=30.0, held_out=1, **last, **held)
        for v in range(len(rig)):
            uv, _ = project(np.array([0.0, 0.0, 0.85]), rig.intrinsics[v], rig.world_to_camera[v])
            np.testing.assert_allclose(uv, rig.size[v] / 2, atol=1e-9)
        off = np.linalg.norm(rig.centres - [0, 0, 0.85], axis=1)
        np.testing.assert_allclose(off[:4], 2.6, rtol=1e-9)
        return rig.rotations[0] @ (rig.centres[other] - rig.centres[0])

    upright = baselines()
    assert upright[1] == pytest.approx(0, abs=1e-12)
    for tilt in (45.0, 90.0, -90.0):
        level, rolled = baselines(tilt=tilt), baselines(tilt=tilt, roll=tilt)
        assert np.linalg.norm(level) == pytest.approx(np.linalg.norm(upright))
        # Pictures turned with the rig see the baseline where an upright rig has it, but for up being elsewhere now.
        assert abs(level[1]) > 5 * abs(rolled[1])
        assert rolled[0] > 0


def test_each_camera_is_rolled_by_its_own_angle_and_nothing_else_changes() -> None:
    level, rolled = rig_of(cameras=8)[0], rig_of(cameras=8, roll=5.0, roll_spread=40.0)[0]
    np.testing.assert_allclose(rolled.centres, level.centres, atol=1e-12)
    np.testing.assert_allclose(rolled.rotations[:, 2], level.rotations[:, 2], atol=1e-12)
    relative = rolled.rotations @ level.rotations.transpose(0, 2, 1)
    angles = np.degrees(np.arctan2(relative[:, 0, 1], relative[:, 0, 0]))
    assert (np.abs(angles - 5) <= 40).all()
    assert np.ptp(angles) > 20, "no two alike"
    np.testing.assert_array_equal(rolled.rotations[:4], rig_of(cameras=8, roll=5.0, roll_spread=40.0)[0].rotations[:4])
