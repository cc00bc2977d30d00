"""Which joint set a number of joints means."""

from __future__ import annotations

from pathlib import Path

import pytest

from posegaussian.storage.importers.joint_streams import guess_joint_set
from posegaussian.storage.model.errors import SourceError

WHERE = Path("walk/cam1.json")


@pytest.mark.parametrize(
    ("joints", "hint", "id"),
    [
        (17, "keypoints", "coco17"),
        (17, "lifted_H36M", "h36m17"),
        (25, "openpose", "body_25"),
        (25, "openpose_body25b", "body_25b"),
        (33, "25b", "blazepose33"),
        (26, "", "halpe26"),
        (24, "h36m", "smpl24"),
    ],
)
def test_joints_are_counted_and_a_hint_decides_between_two(joints: int, hint: str, id: str) -> None:
    assert guess_joint_set(joints, None, hint, WHERE) == id


def test_what_is_given_must_fit() -> None:
    assert guess_joint_set(17, "h36m17", "", WHERE) == "h36m17"
    with pytest.raises(SourceError, match="holds 17 joints a person; joint_set halpe26 has 26"):
        guess_joint_set(17, "halpe26", "", WHERE)
    with pytest.raises(
        SourceError, match=r"holds 18 joints a person, which no known joint set has \(coco17: 17, .*panoptic19: 19\)"
    ):
        guess_joint_set(18, None, "", WHERE)
