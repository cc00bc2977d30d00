"""The effects a scene may call for, in the order in which they act."""

from __future__ import annotations

from posegaussian.stages.simulator.effects.ambient_occlusion import EFFECT as AMBIENT_OCCLUSION
from posegaussian.stages.simulator.effects.background_room import EFFECT as BACKGROUND_ROOM
from posegaussian.stages.simulator.effects.base import SceneEffect
from posegaussian.stages.simulator.effects.calibration_error import EFFECT as CALIBRATION_ERROR
from posegaussian.stages.simulator.effects.camera_gain import EFFECT as CAMERA_GAIN
from posegaussian.stages.simulator.effects.cast_shadow import EFFECT as CAST_SHADOW
from posegaussian.stages.simulator.effects.cloth_motion import EFFECT as CLOTH_MOTION
from posegaussian.stages.simulator.effects.depth_of_field import EFFECT as DEPTH_OF_FIELD
from posegaussian.stages.simulator.effects.dropped_frames import EFFECT as DROPPED_FRAMES
from posegaussian.stages.simulator.effects.joint_noise import EFFECT as JOINT_NOISE
from posegaussian.stages.simulator.effects.jpeg import EFFECT as JPEG
from posegaussian.stages.simulator.effects.lens_distortion import EFFECT as LENS_DISTORTION
from posegaussian.stages.simulator.effects.mask_error import EFFECT as MASK_ERROR
from posegaussian.stages.simulator.effects.motion_blur import EFFECT as MOTION_BLUR
from posegaussian.stages.simulator.effects.occluding_object import EFFECT as OCCLUDING_OBJECT
from posegaussian.stages.simulator.effects.rolling_shutter import EFFECT as ROLLING_SHUTTER
from posegaussian.stages.simulator.effects.second_person import EFFECT as SECOND_PERSON
from posegaussian.stages.simulator.effects.sensor_noise import EFFECT as SENSOR_NOISE
from posegaussian.stages.simulator.effects.soft_matte import EFFECT as SOFT_MATTE
from posegaussian.stages.simulator.effects.specular import EFFECT as SPECULAR
from posegaussian.stages.simulator.effects.time_offset import EFFECT as TIME_OFFSET
from posegaussian.stages.simulator.effects.vignetting import EFFECT as VIGNETTING

EFFECTS: tuple[SceneEffect, ...] = (
    LENS_DISTORTION,
    CALIBRATION_ERROR,
    DROPPED_FRAMES,
    TIME_OFFSET,
    OCCLUDING_OBJECT,
    SECOND_PERSON,
    CLOTH_MOTION,
    MOTION_BLUR,
    ROLLING_SHUTTER,
    AMBIENT_OCCLUSION,
    CAST_SHADOW,
    SPECULAR,
    BACKGROUND_ROOM,
    DEPTH_OF_FIELD,
    VIGNETTING,
    CAMERA_GAIN,
    SENSOR_NOISE,
    JPEG,
    MASK_ERROR,
    SOFT_MATTE,
    JOINT_NOISE,
)
