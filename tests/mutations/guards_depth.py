"""Guards of R1, R2 and D1-D15: rectified pairs, depth maps, matching and masks."""

from __future__ import annotations

from tests.mutations.guard import guards_of

RECTIFICATION, PAIRS = "stages/geometry/rectification.py", "stages/geometry/pairs.py"
PICTURES, LIFT, ERROR = "storage/readers/images.py", "stages/rendering/lift.py", "stages/metrics/depth_error.py"
SGBM, SAMPLING = "stages/matching/sgbm.py", "stages/matching/sampling.py"

GUARDS = (
    guards_of("R1")(RECTIFICATION, "z = forward - (forward @ x) * x", "z = forward"),
    guards_of("R1")(RECTIFICATION, "    x = along / baseline", "    x = np.cross(rotations[0, 1], rotations[0, 2])"),
    guards_of("R2")(
        RECTIFICATION,
        "intrinsics[:, 0, 2] = size / 2 - focal * seen[:, 0] / seen[:, 2]",
        "intrinsics[:, 0, 2] = rig.size[pair][:, 0] / 2",
    ),
    guards_of("R2")(PAIRS, "MAX_ANGLE = 105.0", "MAX_ANGLE = 180.0"),
    guards_of("D1")(PICTURES, 'np.dtype(np.float32): "float"', 'np.dtype(np.float32): "half"'),
    guards_of("D1")(PICTURES, "if values.dtype != np.float32:\n        raise", "if False:\n        raise"),
    guards_of("D2")(
        "stages/depth/stage.py",
        '("frame", "view", "y", "x"),\n            "float32",',
        '("frame", "view", "y", "x"),\n            "float16",',
    ),
    guards_of("D3")(LIFT, "(positive(depth) & positive(face_on))", "positive(face_on)"),
    guards_of("D3")(
        LIFT,
        "finite = torch.isfinite(depth.detach().reshape(-1)[index])",
        "finite = torch.ones(len(index), dtype=torch.bool)",
    ),
    guards_of("D4")(ERROR, "if not measured.any():", "if False:"),
    guards_of("D4")(SGBM, "if not len(pixels):", "if False:"),
    guards_of("D9")(SAMPLING, "out[i, j] = total / weights if", "out[i, j] = total if"),
    guards_of("D10")(
        ERROR,
        "measured = foreground(mask) & (truth > 0)",
        "measured = foreground(mask) & (truth > rig.intrinsics[view, 0, 0] * 2 / 512)",
    ),
    guards_of("D11")(
        "stages/geometry/projection.py",
        "return points_from_integer_centres(np.stack([columns, rows], axis=-1))",
        "return np.stack([columns, rows], axis=-1)",
    ),
    guards_of("D12")("stages/silhouettes/hull.py", "    own = foreground(mask)\n", "    own = mask > 168\n"),
    guards_of("D13")(SGBM, "rows, columns = np.nonzero(mask)", "rows, columns = np.nonzero(mask >= 0)"),
    guards_of("D14")(
        "stages/depth/params.py",
        "consistency: float = setting(\n        1.5,",
        "consistency: float = setting(\n        1e9,",
    ),
    guards_of("D14")(
        SAMPLING,
        "out[i, j] = min(out[i, j], focal_baseline * abs(1 / other[r, c] - 1 / w))",
        "out[i, j] = 0",
    ),
    guards_of("D15")(
        "stages/geometry/projection.py",
        "np.meshgrid(np.arange(size[0]), np.arange(size[1]))",
        "np.meshgrid(np.arange(size[0]), np.arange(size[0]))",
    ),
)
