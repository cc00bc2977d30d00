"""BlazePose's flow with made networks, and with the official ones where they were fetched."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from posegaussian.stages.estimators import blazepose
from posegaussian.stages.estimators.anchors import anchors
from posegaussian.stages.estimators.blazepose import COCO17, JOINTS, LEAST_PRESENCE, BlazePose, distance, distinct
from posegaussian.stages.estimators.blazepose_files import model_files
from posegaussian.stages.estimators.interface import Found
from posegaussian.stages.imaging.regions import region_of, to_own
from posegaussian.storage.model.errors import ConfigError
from posegaussian.storage.model.joint_sets import joint_set

SIDE = 256
PICTURE = np.stack([*np.mgrid[:SIDE, :SIDE][::-1], np.zeros((SIDE, SIDE), int)], axis=-1).astype(np.uint8)
"""Each pixel says its own column and row, so that a network can tell where its crop was cut."""
BODIES = [np.random.default_rng(s).uniform(-30, 30, (39, 2)) + c for s, c in ((0, [90.0, 110.0]), (1, [175.0, 150.0]))]
for one, c in zip(BODIES, ([90.0, 110.0], [175.0, 150.0]), strict=True):
    one[33], one[34] = c, (c[0] + 8, c[1] - 38)


def cut_at(values: np.ndarray) -> np.ndarray:
    """[3, 2] affine from a crop's cells (column, row, 1) to the picture's px, read from the crop itself (0..255)."""
    n = len(values)
    rows, cols = np.mgrid[:n, :n] + 0.5
    inner = ((values[..., :2] > 2) & (values[..., :2] < 253)).all(-1)
    design = np.stack([cols[inner], rows[inner], np.ones(inner.sum())], 1)
    return np.linalg.lstsq(design, values[inner][:, :2] + 0.5, rcond=None)[0]


def in_crop(points: np.ndarray, affine: np.ndarray) -> np.ndarray:
    return (points - affine[2]) @ np.linalg.inv(affine[:2])


class Detector:
    """Sees every body wherever its input was cut; `off` shifts what it says, px of the picture."""

    off = 0.0

    def __call__(self, values: np.ndarray) -> list[np.ndarray]:
        affine = cut_at((values + 1) * 127.5)
        raw, logits = np.zeros((2254, 12), np.float32), np.full((2254, 1), -1e4, np.float32)
        for k, body in enumerate(BODIES):
            points = in_crop(body[[33, 34, 33, 34]] + self.off, affine)
            a = anchors()[100 * k] * 224
            raw[100 * k] = np.concatenate([points[1] - a, [20, 20], (points - a).ravel()])
            logits[100 * k] = 3 - k
        return [raw, logits]


class Landmarks:
    """Knows the bodies: says the one next to the middle of its crop; the second one's presence is the larger."""

    def __call__(self, values: np.ndarray) -> list[np.ndarray]:
        affine = cut_at(values * 255)
        middle = np.array([128, 128, 1]) @ affine
        which = int(np.argmin([np.linalg.norm(b[33] - middle) for b in BODIES]))
        raw = np.zeros((39, 5), np.float32)
        raw[:, :2], raw[:, 3:] = in_crop(BODIES[which], affine), 20
        heat = np.full((64, 64, 39), -20, np.float32)
        heat[5, 5] = 20
        return [
            raw.ravel(),
            np.array([0.9 + 0.05 * which], np.float32),
            np.full((256, 256, 1), 20, np.float32),
            heat,
            np.zeros(117, np.float32),
        ]


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> BlazePose:
    monkeypatch.setattr(blazepose, "check_files", lambda files: None)
    monkeypatch.setattr(
        blazepose, "LiteRTNetwork", lambda file: Detector() if file.stem == "pose_detection" else Landmarks()
    )
    return BlazePose(
        {n: tmp_path / f"{n}.tflite" for n in ("pose_detection", "pose_landmark_full", "selfie_segmentation")}
    )


def test_two_people_come_out_as_two_sorted_by_presence(made: BlazePose) -> None:
    found = made.find(PICTURE, 4)
    assert len(found) == 2
    assert np.allclose(found.presence, [0.95, 0.9])
    for person, body in zip(found.joints, BODIES[::-1], strict=True):
        # the crop's values are whole numbers; over the crop that averages out to a few hundredths of a pixel
        assert np.abs(person[:, :2] - body[:JOINTS]).max() < 0.1
    assert np.allclose(found.joints[1, :, 2], 0.9)
    assert len(made.find(PICTURE, 1)) == 1
    assert found.person.min() == 255
    assert np.allclose(found.heatmaps[:, :, :7, :7].astype(float).sum((2, 3)), 1, atol=0.3)


def test_a_region_settles_on_the_body_s_own_whatever_was_detected(
    made: BlazePose, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Detector, "off", 9.0)
    found = made.find(PICTURE, 4)
    for region, body in zip(found.region, BODIES[::-1], strict=True):
        assert distance(region.astype(float), region_of(body[33], body[34])) < 0.02


def test_looking_needs_no_detector_and_keeps_the_regions(made: BlazePose) -> None:
    regions = np.array([[95, 120, 100, 0.5], [170, 150, 160, -1.0]])
    found = made.look(PICTURE, regions)
    assert np.allclose(found.region, regions)
    for person, body in zip(found.joints, BODIES, strict=True):
        assert np.abs(person[:, :2] - body[:JOINTS]).max() < 0.1


def test_an_empty_region_is_nobody(made: BlazePose, monkeypatch: pytest.MonkeyPatch) -> None:
    plain = Landmarks.__call__
    monkeypatch.setattr(
        Landmarks,
        "__call__",
        lambda self, values: [
            o if i != 1 else np.array([LEAST_PRESENCE - 0.01], np.float32) for i, o in enumerate(plain(self, values))
        ],
    )
    found = made.find(PICTURE, 4)
    assert found.joints.shape == (0, JOINTS, 3)
    assert found.heatmaps.shape == (0, 17, 64, 64)


def test_a_joint_outside_the_picture_has_no_score(made: BlazePose, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.modules[__name__], "BODIES", [BODIES[0] - [75.0, 0], BODIES[1]])
    joints = made.look(PICTURE, np.array([[20.0, 110, 100, 0]])).joints[0]
    outside = BODIES[0][:JOINTS, 0] < -0.2
    assert outside.any()
    assert (joints[outside, 2] == 0).all()
    assert (joints[BODIES[0][:JOINTS, 0] > 0.2, 2] > 0).all()


def test_the_same_body_twice_is_one_even_upside_down() -> None:
    body = np.random.default_rng(0).uniform(0, 100, (33, 2))
    joints = np.zeros((4, 33, 3), np.float32)
    joints[..., :2] = body, body + 3, body + np.array([90, 0]), 50 + 0.4 * (50 - body)
    regions = np.array([[50, 50, 150, 0], [53, 53, 150, 0], [140, 50, 150, 0], [55, 60, 90, 3]], np.float32)
    people = Found(
        joints,
        regions,
        np.zeros((4, 17, 64, 64), np.float16),
        np.zeros((4, 256, 256), np.uint8),
        np.ones(4, np.float32),
    )
    assert distinct(people) == [0, 2]


def test_zooms_show_the_detector_more_places(made: BlazePose, monkeypatch: pytest.MonkeyPatch) -> None:
    shown: list[tuple[float, ...]] = []
    monkeypatch.setattr(
        BlazePose,
        "_detect_in",
        lambda self, picture, place: shown.append(tuple(place)) or (np.zeros((0, 4)), np.zeros(0)),
    )
    for zoom, count in ((0, 1), (1, 1 + 3), (2, 1 + 3 + 3 * 7)):
        shown.clear()
        made._zoom = zoom
        assert len(made.find(np.zeros((1920, 1080, 3), np.uint8), 1)) == 0
        assert len(shown) == count


def test_how_far_regions_are_apart() -> None:
    a = np.array([10.0, 20, 50, 3.1])
    assert distance(a, a) == 0
    assert np.isclose(distance(a, np.array([15.0, 20, 50, 3.1])), 0.1)
    assert np.isclose(distance(a, np.array([10.0, 20, 60, 3.1])), 0.1)
    # 3.1 and -3.1 rad are 0.083 apart, not 6.2
    assert np.isclose(distance(a, np.array([10.0, 20, 50, -3.1])), (2 * np.pi - 6.2) / 2)


def test_without_models_the_command_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("POSEGAUSSIAN_MODELS", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    with pytest.raises(ConfigError, match="posegaussian models fetch blazepose"):
        BlazePose()


def test_without_litert_the_command_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(blazepose, "check_files", lambda files: None)
    monkeypatch.setitem(sys.modules, "ai_edge_litert", None)
    monkeypatch.setitem(sys.modules, "ai_edge_litert.interpreter", None)
    with pytest.raises(ConfigError, match="pip install ai-edge-litert"):
        BlazePose(
            {n: tmp_path / f"{n}.tflite" for n in ("pose_detection", "pose_landmark_full", "selfie_segmentation")}
        )


def test_importing_it_does_not_import_litert() -> None:
    code = (
        "import sys, posegaussian.stages.estimators.blazepose, posegaussian.stages.estimators.onnx;"
        " print('ai_edge_litert' in sys.modules)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "PYTHONPATH": str(Path(blazepose.__file__).parents[3])},
    )
    assert done.stdout.strip() == "False"


def test_coco17_names_the_same_joints() -> None:
    blaze, coco = joint_set("blazepose33"), joint_set("coco17")
    assert len(blaze) == JOINTS
    assert [blaze.places[i] for i in COCO17] == list(coco.places)


fetched = pytest.mark.skipif(
    model_files() is None, reason="BlazePose's models are not here; `posegaussian models fetch blazepose` brings them"
)


@fetched
def test_a_picture_without_people_has_none() -> None:
    assert len(BlazePose().find(np.full((240, 320, 3), 90, np.uint8), 3)) == 0


@fetched
@pytest.mark.captures
def test_the_official_models_find_the_person_of_a_real_capture() -> None:
    import av

    video = Path(os.environ.get("POSEGAUSSIAN_CAPTURES", "../shared")) / "captures/balance/videos/cam04.mp4"
    if not video.is_file():
        pytest.skip(f"no {video}; set POSEGAUSSIAN_CAPTURES")
    with av.open(str(video)) as container:
        picture = next(container.decode(video=0)).to_ndarray(format="rgb24")
    estimator = BlazePose()
    found = estimator.find(picture, 3)
    assert len(found) == 1
    joints = found.joints[0]
    # read from the picture by eye: shoulders, elbows, wrists, left before right
    seen = {11: (185, 710), 12: (385, 690), 13: (195, 890), 14: (485, 835), 15: (230, 1010), 16: (600, 885)}
    # 3 % of the person's height in the picture: what a joint under skin is uncertain by, and the model beside that
    assert max(np.hypot(*(joints[j, :2] - p)) for j, p in seen.items()) < 30
    peaks = found.heatmaps[0].reshape(17, -1).argmax(1)
    at = np.stack([peaks % 64, peaks // 64], 1) + 0.5
    own = to_own(joints[COCO17, :2], found.region[0].astype(float)) * 64
    sure = found.heatmaps[0].reshape(17, -1).max(1) > 0.7
    assert sure.sum() >= 10
    assert np.abs(own - at)[sure].max() < 3
    inside = to_own(joints[[11, 12, 23, 24], :2], found.region[0].astype(float)) * 256
    assert (found.person[0][inside[:, 1].astype(int), inside[:, 0].astype(int)] > 127).all()
    again = estimator.look(picture, found.region)
    assert again.joints.tobytes() == found.joints.tobytes()
    assert again.person.tobytes() == found.person.tobytes()
