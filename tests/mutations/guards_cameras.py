"""Guards of K1-K6: camera paths and calibration files."""

from __future__ import annotations

from tests.mutations.guard import guards_of

PATHS, RAW = "stages/camera_paths/paths.py", "storage/importers/cameras.py"

GUARDS = (
    guards_of("K1")(
        PATHS,
        "_between(xa, xb, float(s)) - rotation @ subject",
        "(1 - s) * rig.world_to_camera[a, :3, 3] + s * rig.world_to_camera[b, :3, 3]",
    ),
    guards_of("K2")(PATHS, "if np.pi - angle > HALF_TURN:", "if True:"),
    guards_of("K3")("storage/model/cameras.py", 'return -np.einsum("vji,vj->vi"', 'return -np.einsum("vij,vj->vi"'),
    guards_of("K4")(
        RAW,
        "distortion[v, : min(DISTORTION, c.distortion.size)] = c.distortion[:DISTORTION]",
        "distortion[v, : min(5, c.distortion.size)] = c.distortion[:5]",
    ),
    guards_of("K5")(
        RAW, "exact = np.stack([rigid(m[:3, :3], m[:3, 3]) for m in world_to_camera])", "exact = world_to_camera"
    ),
    guards_of("K6")(
        "storage/importers/common.py",
        "scale = w / cw if cw >= ch else h / ch\n    if max",
        "scale = 1.0\n    if max",
    ),
    guards_of("K6")(
        "storage/importers/letterbox.py",
        "scale=scale, offset=((calibrated[0] - scale * captured[0]) / 2,",
        "scale=1.0, offset=((calibrated[0] - scale * captured[0]) / 2,",
    ),
)
