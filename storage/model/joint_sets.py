"""Joint sets: which joints a detector names, in which order, how they are linked,
and how one set is read as another."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from posegaussian.storage.model.errors import SourceError


@dataclass(frozen=True)
class JointSet:
    """The joints of one detector or data set, in its order."""

    id: str
    """Key in `JOINT_SETS`; also the attribute `joint_set` of stored joints."""
    names: tuple[str, ...]
    """Unique joint names in file order; a leading L or R is the subject's own left or right."""
    limbs: tuple[tuple[int, int], ...]
    """Pairs of joint indices that a bone connects."""
    flips: tuple[int, ...]
    """[J] index of each joint's mirror image; a joint on the body's midline is its own."""
    anatomy: Mapping[str, str] = field(default_factory=dict)
    """Place of those joints whose name means something else in another set:
    two joints are the same where their places are."""

    def __len__(self) -> int:
        return len(self.names)

    @property
    def places(self) -> tuple[str, ...]:
        """[J] unambiguous anatomical names, by which sets are mapped onto each other."""
        return tuple(self.anatomy.get(n, n) for n in self.names)


def _mirror(name: str) -> str:
    """The other side's name: LKnee <-> RKnee; names of the midline, such as Nose, stay."""
    return {"L": "R", "R": "L"}.get(name[0], name[0]) + name[1:]


def _joint_set(id: str, names: str, limbs: str, anatomy: Mapping[str, str] | None = None) -> JointSet:
    """Build a set from names in order and limbs written `A-B`; `*A-*B` stands for both sides."""
    ordered = tuple(names.split())
    pairs = [p.replace("*", side) for p in limbs.split() for side in ("LR" if "*" in p else " ")]
    ends = [p.split("-") for p in pairs]
    return JointSet(
        id,
        ordered,
        tuple((ordered.index(a), ordered.index(b)) for a, b in ends),
        tuple(ordered.index(_mirror(n)) if _mirror(n) in ordered else i for i, n in enumerate(ordered)),
        MappingProxyType(dict(anatomy or {})),
    )


_ARMS_AND_LEGS = "*Shoulder-*Elbow *Elbow-*Wrist *Hip-*Knee *Knee-*Ankle"
_FACE = "Nose-*Eye *Eye-*Ear"
_FEET = "*Ankle-*Heel *Ankle-*BigToe *BigToe-*SmallToe"
_TORSO = "LShoulder-RShoulder LHip-RHip *Shoulder-*Hip"

COCO17 = _joint_set(
    "coco17",
    "Nose LEye REye LEar REar LShoulder RShoulder LElbow RElbow LWrist RWrist LHip RHip LKnee RKnee LAnkle RAnkle",
    f"{_FACE} *Ear-*Shoulder {_TORSO} {_ARMS_AND_LEGS}",
)
"""COCO person keypoints (https://cocodataset.org/#format-data)."""

BODY_25 = _joint_set(
    "body_25",
    "Nose Neck RShoulder RElbow RWrist LShoulder LElbow LWrist MidHip RHip RKnee RAnkle LHip LKnee LAnkle REye LEye"
    " REar LEar LBigToe LSmallToe LHeel RBigToe RSmallToe RHeel",
    f"{_FACE} Nose-Neck Neck-*Shoulder Neck-MidHip MidHip-*Hip {_ARMS_AND_LEGS} {_FEET}",
)
"""OpenPose BODY_25; its Neck lies between the shoulders."""

BODY_25B = _joint_set(
    "body_25b",
    "Nose LEye REye LEar REar LShoulder RShoulder LElbow RElbow LWrist RWrist LHip RHip LKnee RKnee LAnkle RAnkle"
    " UpperNeck HeadTop LBigToe LSmallToe LHeel RBigToe RSmallToe RHeel",
    f"{_FACE} Nose-UpperNeck UpperNeck-HeadTop UpperNeck-*Shoulder {_TORSO} {_ARMS_AND_LEGS} {_FEET}",
)
"""OpenPose BODY_25B (experimental models): COCO-17 first, then neck, head and feet;
its UpperNeck is the base of the skull."""

TRC21 = _joint_set(
    "trc21",
    "RHip RKnee RAnkle RBigToe RSmallToe RHeel LHip LKnee LAnkle LBigToe LSmallToe LHeel Neck Head Nose RShoulder"
    " RElbow RWrist LShoulder LElbow LWrist",
    f"Nose-Neck Neck-Head Neck-*Shoulder {_TORSO} {_ARMS_AND_LEGS} {_FEET}",
    anatomy={"Neck": "UpperNeck", "Head": "HeadTop"},
)
"""The 21 markers that pose2sim writes to TRC files from BODY_25B;
its Neck is BODY_25B's UpperNeck, not BODY_25's Neck."""

_BLAZEPOSE_NAMES = (
    "Nose LEyeInner LEye LEyeOuter REyeInner REye REyeOuter LEar REar LMouth RMouth LShoulder RShoulder LElbow RElbow"
    " LWrist RWrist LPinky RPinky LIndex RIndex LThumb RThumb LHip RHip LKnee RKnee LAnkle RAnkle LHeel RHeel"
    " LFootIndex RFootIndex"
)
_BLAZEPOSE_LIMBS = (
    f"Nose-*EyeInner *EyeInner-*Eye *Eye-*EyeOuter *EyeOuter-*Ear *Ear-*Shoulder Nose-*Mouth LMouth-RMouth {_TORSO}"
    f" {_ARMS_AND_LEGS} *Wrist-*Pinky *Wrist-*Index *Wrist-*Thumb *Pinky-*Index *Ankle-*Heel *Heel-*FootIndex"
    " *Ankle-*FootIndex"
)

BLAZEPOSE33 = _joint_set("blazepose33", _BLAZEPOSE_NAMES, _BLAZEPOSE_LIMBS)
"""MediaPipe's pose landmarks (https://ai.google.dev/edge/mediapipe/solutions/vision/pose_landmarker).

Its hands are knuckles, its mouth points the corners of the mouth. FootIndex is the tip of the second toe: no BigToe."""

BLAZEPOSE39 = _joint_set(
    "blazepose39",
    f"{_BLAZEPOSE_NAMES} MidHip BodyCircle LPalm LHandRoot RPalm RHandRoot",
    f"{_BLAZEPOSE_LIMBS} MidHip-*Hip",
)
"""All points of MediaPipe's landmark model: BLAZEPOSE33, then six that only place regions of interest.

MidHip is the middle of a circle around the whole body and BodyCircle a point on it, above the head along the body's
axis (https://arxiv.org/abs/2006.10204, section 2.2). The last four are undocumented; on real pictures each HandRoot
lies within a pixel of the wrist and each Palm between the knuckles of pinky and index. BodyCircle and the four are
no joints: no limb ends there and no other set has them."""

H36M17 = _joint_set(
    "h36m17",
    "Hip RHip RKnee RAnkle LHip LKnee LAnkle Spine Thorax NeckNose Head LShoulder LElbow LWrist RShoulder RElbow"
    " RWrist",
    "Hip-*Hip *Hip-*Knee *Knee-*Ankle Hip-Spine Spine-Thorax Thorax-NeckNose NeckNose-Head Thorax-*Shoulder"
    " *Shoulder-*Elbow *Elbow-*Wrist",
    anatomy={"Hip": "MidHip", "Head": "HeadTop"},
)
"""The 17 joints of Human3.6M that move (http://vision.imar.ro/human3.6m), in the order of its 3D pose estimators.

Its Hip is midway between the hip joints, its Head the crown. Thorax is a joint of the motion capture's spine and not
the middle of the shoulders, NeckNose lies between throat and nose: neither is a Neck of another set."""

HALPE26 = _joint_set(
    "halpe26",
    "Nose LEye REye LEar REar LShoulder RShoulder LElbow RElbow LWrist RWrist LHip RHip LKnee RKnee LAnkle RAnkle Head"
    " Neck Hip LBigToe RBigToe LSmallToe RSmallToe LHeel RHeel",
    f"{_FACE} Nose-Neck Neck-Head Neck-*Shoulder Neck-Hip Hip-*Hip {_ARMS_AND_LEGS} {_FEET}",
    anatomy={"Head": "HeadTop", "Hip": "MidHip", "Neck": "HalpeNeck"},
)
"""The body of Halpe (https://github.com/Fang-Haoshu/Halpe-FullBody), which AlphaPose and RTMPose detect: COCO-17 first.

Its Head is the crown. Its detectors learn the Neck from sets that put it at the base of the skull, at the throat or
between the shoulders, so it is no other set's."""

SMPL24 = _joint_set(
    "smpl24",
    "Pelvis LHip RHip Spine1 LKnee RKnee Spine2 LAnkle RAnkle Spine3 LFoot RFoot Neck LCollar RCollar Head LShoulder"
    " RShoulder LElbow RElbow LWrist RWrist LHand RHand",
    "Pelvis-*Hip *Hip-*Knee *Knee-*Ankle *Ankle-*Foot Pelvis-Spine1 Spine1-Spine2 Spine2-Spine3 Spine3-Neck Neck-Head"
    " Spine3-*Collar *Collar-*Shoulder *Shoulder-*Elbow *Elbow-*Wrist *Wrist-*Hand",
    anatomy={"LHip": "SmplLHip", "RHip": "SmplRHip", "Neck": "SmplNeck", "Head": "SmplHead"},
)
"""The skeleton of the body model SMPL (https://smpl.is.tue.mpg.de).

Its hips are centimetres closer together than those that detectors learn, its Pelvis lies above the line between
them, its Neck within the spine and its Head where the skull turns: these are no other set's. Knees, ankles,
shoulders, elbows and wrists are the same joints."""

PANOPTIC19 = _joint_set(
    "panoptic19",
    "Neck Nose BodyCenter LShoulder LElbow LWrist LHip LKnee LAnkle RShoulder RElbow RWrist RHip RKnee RAnkle LEye LEar"
    " REye REar",
    f"{_FACE} Nose-Neck Neck-*Shoulder Neck-BodyCenter BodyCenter-*Hip {_ARMS_AND_LEGS}",
    anatomy={"Neck": "PanopticNeck", "BodyCenter": "MidHip"},
)
"""coco19 of CMU Panoptic (https://github.com/CMU-Perceptual-Computing-Lab/panoptic-toolbox), left before right.

Its BodyCenter is the middle of the hips; where on the neck its Neck lies is not documented, so it is no other set's."""

JOINT_SETS: Mapping[str, JointSet] = MappingProxyType(
    {s.id: s for s in (COCO17, BODY_25, BODY_25B, TRC21, BLAZEPOSE33, BLAZEPOSE39, H36M17, HALPE26, SMPL24, PANOPTIC19)}
)
"""All known joint sets by id."""


def joint_set(id: str) -> JointSet:
    """The joint set of that id; SourceError names the known ones."""
    if id not in JOINT_SETS:
        raise SourceError(f"unknown joint set {id!r}; known are {', '.join(JOINT_SETS)}")
    return JOINT_SETS[id]


def joint_map(source: str, target: str) -> np.ndarray:
    """[J_target] int: index in `source` of each joint of `target`, -1 where the source has no such joint.

    Raises SourceError for an unknown id.
    """
    places = {p: i for i, p in enumerate(joint_set(source).places)}
    return np.array([places.get(p, -1) for p in joint_set(target).places], dtype=np.int64)


def to_set(joints: np.ndarray, source: str, target: str) -> np.ndarray:
    """Joints [..., J_source, C] of one set -> [..., J_target, C] of another, by anatomical name; the last column is the
    score.

    Exact where both sets have the joint; a joint the source lacks is all zeros, its score too. Nothing is derived (no
    MidHip from two hips). Raises SourceError for an unknown id and ValueError when J does not fit the source set.
    """
    if joints.shape[-2] != len(joint_set(source)):
        raise ValueError(f"{joints.shape[-2]} joints given for {source}, which has {len(joint_set(source))}")
    index = joint_map(source, target)
    return np.where((index >= 0)[:, None], joints[..., index, :], np.zeros((), joints.dtype))
