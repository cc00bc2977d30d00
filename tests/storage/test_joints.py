"""Laws of the joint sets: flips are involutions, limbs connect, maps agree by name and round-trip."""

from __future__ import annotations

import numpy as np
import pytest

from storage.errors import SourceError
from storage.joints import BODY_25, COCO17, JOINT_SETS, TRC21, joint_map, joint_set, to_set

IDS = list(JOINT_SETS)


def numbered(id: str) -> np.ndarray:
    """[2, J, 3] joints that carry their own index, all with score 0.5."""
    j = np.arange(len(JOINT_SETS[id]), dtype=np.float64)
    return np.stack([np.stack([j, 100 + j, np.full(len(j), 0.5)], axis=-1)] * 2)


@pytest.mark.parametrize("id", IDS)
def test_names_are_unique_and_flips_are_involutions_that_swap_sides(id: str) -> None:
    s = JOINT_SETS[id]
    assert s.id == id
    assert len(set(s.names)) == len(s.names) == len(s.flips)
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
    assert reached == set(range(len(s)))


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


def test_coco_from_openpose_is_complete_and_known_joints_land_where_they_should() -> None:
    for id in ("body_25", "body_25b"):
        assert (to_set(numbered(id), id, "coco17")[..., 2] == 0.5).all()
    coco = to_set(numbered("body_25"), "body_25", "coco17")[0]
    assert coco[COCO17.names.index("RAnkle"), 0] == 11
    assert coco[COCO17.names.index("LEar"), 0] == 18
    assert to_set(numbered("body_25b"), "body_25b", "coco17")[0, :, 0].tolist() == list(range(17))


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
