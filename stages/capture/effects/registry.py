"""The effects a scene may call for, in the order in which they act."""

from __future__ import annotations

from stages.capture.effects.ambient_occlusion import EFFECT as AMBIENT_OCCLUSION
from stages.capture.effects.background_room import EFFECT as BACKGROUND_ROOM
from stages.capture.effects.base import SceneEffect
from stages.capture.effects.calibration_error import EFFECT as CALIBRATION_ERROR
from stages.capture.effects.camera_gain import EFFECT as CAMERA_GAIN
from stages.capture.effects.cast_shadow import EFFECT as CAST_SHADOW
from stages.capture.effects.cloth_motion import EFFECT as CLOTH_MOTION
from stages.capture.effects.depth_of_field import EFFECT as DEPTH_OF_FIELD
from stages.capture.effects.dropped_frames import EFFECT as DROPPED_FRAMES
from stages.capture.effects.joint_noise import EFFECT as JOINT_NOISE
from stages.capture.effects.jpeg import EFFECT as JPEG
from stages.capture.effects.lens_distortion import EFFECT as LENS_DISTORTION
from stages.capture.effects.mask_error import EFFECT as MASK_ERROR
from stages.capture.effects.motion_blur import EFFECT as MOTION_BLUR
from stages.capture.effects.occluding_object import EFFECT as OCCLUDING_OBJECT
from stages.capture.effects.rolling_shutter import EFFECT as ROLLING_SHUTTER
from stages.capture.effects.second_person import EFFECT as SECOND_PERSON
from stages.capture.effects.sensor_noise import EFFECT as SENSOR_NOISE
from stages.capture.effects.specular import EFFECT as SPECULAR
from stages.capture.effects.time_offset import EFFECT as TIME_OFFSET
from stages.capture.effects.vignetting import EFFECT as VIGNETTING

EFFECTS: tuple[SceneEffect, ...] = (
    LENS_DISTORTION, CALIBRATION_ERROR, DROPPED_FRAMES, TIME_OFFSET, OCCLUDING_OBJECT, SECOND_PERSON, CLOTH_MOTION, MOTION_BLUR, ROLLING_SHUTTER,
    AMBIENT_OCCLUSION, CAST_SHADOW, SPECULAR, BACKGROUND_ROOM, DEPTH_OF_FIELD, VIGNETTING, CAMERA_GAIN, SENSOR_NOISE, JPEG, MASK_ERROR, JOINT_NOISE,
)  # fmt: skip
