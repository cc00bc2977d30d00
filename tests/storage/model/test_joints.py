"""Laws of the joint sets: flips are involutions, limbs connect, maps agree by name and round-trip."""

from __future__ import annotations

import numpy as np
import pytest

from posegaussian.storage.model.errors import SourceError
from posegaussian.storage.model.joint_sets import BODY_25, COCO17, JOINT_SETS, TRC21, joint_map, joint_set, to_set

IDS = list(JOINT_SETS)
NO_JOINTS = {"blazepose39": {34, 35, 36, 37, 38}}
"""Points of a set that only place regions of interest: no limb ends there."""


def numbered(id: str) -> np.ndarray:
    """[2, J, 3] joints that carry their own index, all with score 0.5."""
    j = np.arange(len(JOINT_SETS[id]), dtype=np.float64)
    return np.stack([np.stack([j, 100 + j, np.full(len(j), 0.5)], axis=-1)] * 2)


@pytest.mark.parametrize("id", IDS)
def test_names_are_unique_and_flips_are_involutions_that_swap_sides(id: str) -> None:
    s = JOINT_SETS[id]
    assert s.id == id
    assert len(set(s.names)) == len(s.names) == len(s.flips)
    assert len(set(s.places)) == len(s.names)
    for i, f in enumerate(s.flips):
        assert s.flips[f] == i
        if s.names[i][0] in "LR":
            assert s.names[f][1:] == s.names[i][1:]
            assert {s.names[f][0], s.names[i][0]} == {"L", "R"}
        else:
            assert f == i


@pytest.mark.parametrize("id", IDS)
def test_limbs_connect_existing_joints_once_and_are_symmetric(id: str) -> None:
    s = JOINT_SETS[id]
    pairs = {frozenset(p) for p in s.limbs}
    assert len(pairs) == len(s.limbs)
    assert all(len(p) == 2 and max(p) < len(s) for p in pairs)
    assert {frozenset(s.flips[i] for i in p) for p in pairs} == pairs
    reached = {0}  # every joint hangs on the skeleton
    for _ in s.names:
        reached |= {j for p in pairs if p & reached for j in p}
    assert reached == set(range(len(s))) - NO_JOINTS.get(id, set())


@pytest.mark.parametrize("source", IDS)
@pytest.mark.parametrize("target", IDS)
def test_maps_keep_places_and_flips(source: str, target: str) -> None:
    a, b = JOINT_SETS[source], JOINT_SETS[target]
    index = joint_map(source, target)
    for t, s in enumerate(index):
        assert (s < 0) == (b.places[t] not in a.places)
        if s >= 0:
            assert a.places[s] == b.places[t]
            assert index[b.flips[t]] == a.flips[s]
    x = numbered(source)
    there = to_set(x, source, target)
    back = to_set(there, target, source)
    kept = joint_map(target, source) >= 0
    np.testing.assert_array_equal(back[:, kept], x[:, kept])
    assert not back[:, ~kept].any()


def test_coco_is_complete_from_the_sets_that_have_a_face_and_a_detectors_hips() -> None:
    complete = {id for id in IDS if (joint_map(id, "coco17") >= 0).all()}
    assert complete == {"coco17", "body_25", "body_25b", "blazepose33", "blazepose39", "halpe26", "panoptic19"}


def lacking(source: str, target: str) -> set[str]:
    return {JOINT_SETS[target].names[j] for j in np.flatnonzero(joint_map(source, target) < 0)}


def test_what_coco_lacks_from_skeletons() -> None:
    face = {"Nose", "LEye", "REye", "LEar", "REar"}
    assert lacking("h36m17", "coco17") == face
    assert lacking("smpl24", "coco17") == face | {"LHip", "RHip"}  # joint centres of a body model lie deeper
    assert lacking("trc21", "coco17") == face - {"Nose"}


def test_known_joints_land_where_they_should() -> None:
    coco = to_set(numbered("body_25"), "body_25", "coco17")[0]
    assert coco[COCO17.names.index("RAnkle"), 0] == 11
    assert coco[COCO17.names.index("LEar"), 0] == 18
    for id in ("body_25b", "halpe26"):
        assert to_set(numbered(id), id, "coco17")[0, :, 0].tolist() == list(range(17))
    # MediaPipe's numbers of COCO's joints (https://ai.google.dev/edge/mediapipe/solutions/vision/pose_landmarker)
    assert joint_map("blazepose33", "coco17").tolist() == [
        0,
        2,
        5,
        7,
        8,
        11,
        12,
        13,
        14,
        15,
        16,
        23,
        24,
        25,
        26,
        27,
        28,
    ]
    assert joint_map("blazepose39", "blazepose33").tolist() == list(range(33))
    assert joint_map("h36m17", "coco17")[5:].tolist() == [11, 14, 12, 15, 13, 16, 4, 1, 5, 2, 6, 3]
    assert joint_map("smpl24", "coco17")[[5, 6, 9, 10, 13, 16]].tolist() == [16, 17, 20, 21, 4, 8]


# Every place between and above the shoulders and hips, by the sets that share it.
# A name alone, Neck or Head, says little.
SHARED = {
    "MidHip": {
        "body_25": "MidHip",
        "blazepose39": "MidHip",
        "h36m17": "Hip",
        "halpe26": "Hip",
        "panoptic19": "BodyCenter",
    },
    "HeadTop": {"body_25b": "HeadTop", "trc21": "Head", "h36m17": "Head", "halpe26": "Head"},
    "UpperNeck": {"body_25b": "UpperNeck", "trc21": "Neck"},
    "Neck": {"body_25": "Neck"},
    "HalpeNeck": {"halpe26": "Neck"},
    "PanopticNeck": {"panoptic19": "Neck"},
    "SmplNeck": {"smpl24": "Neck"},
    "SmplHead": {"smpl24": "Head"},
    "Thorax": {"h36m17": "Thorax"},
    "NeckNose": {"h36m17": "NeckNose"},
    "Pelvis": {"smpl24": "Pelvis"},
    "LBigToe": dict.fromkeys(("body_25", "body_25b", "trc21", "halpe26"), "LBigToe"),
    "LFootIndex": {"blazepose33": "LFootIndex", "blazepose39": "LFootIndex"},
    "LFoot": {"smpl24": "LFoot"},
}


@pytest.mark.parametrize("place", SHARED)
def test_only_the_same_place_of_a_body_is_the_same_joint(place: str) -> None:
    found = {id: s.names[s.places.index(place)] for id, s in JOINT_SETS.items() if place in s.places}
    assert found == SHARED[place]


def test_a_neck_is_not_every_neck() -> None:
    trc = to_set(numbered("trc21"), "trc21", "body_25b")[0]
    assert trc[17, 0] == TRC21.names.index("Neck")
    assert trc[18, 0] == TRC21.names.index("Head")
    from_trc = to_set(numbered("trc21"), "trc21", "body_25")[0]
    assert from_trc[BODY_25.names.index("Neck"), 2] == 0
    assert from_trc[BODY_25.names.index("MidHip"), 2] == 0
    assert (to_set(numbered("trc21"), "trc21", "coco17")[0, 1:5, 2] == 0).all()  # no eyes, no ears


def test_unknown_ids_and_wrong_counts_are_named() -> None:
    with pytest.raises(SourceError, match=r"body_26.*coco17.*body_25b"):
        joint_set("body_26")
    with pytest.raises(ValueError, match="24 joints given for body_25, which has 25"):
        to_set(np.zeros((24, 3)), "body_25", "coco17")
