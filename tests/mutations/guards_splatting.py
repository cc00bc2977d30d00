"""Guards of S1-S22: projecting Gaussians, blending them, and the bytes they become."""

from __future__ import annotations

from tests.mutations.guard import guards_of

DEFINITION, CPU = "stages/splatting/definition", "stages/splatting/cpu"
PROJECTION, COMPOSITE, TILES, BACKEND = (f"{CPU}/{n}.py" for n in ("projection", "composite", "tiles", "backend"))
BACKWARD, REFERENCE = f"{CPU}/projection_backward.py", f"{DEFINITION}/reference.py"
QUATERNIONS, BYTES = "stages/splatting/quaternions.py", "stages/rendering/run.py"
SANE = (
    PROJECTION,
    "sane = both(both(det < huge, hx < huge), both(hy < huge, both(u * zero == zero, v * zero == zero)))",
    "sane = zero == zero",
)
"""What keeps out whatever the projection made of it."""

GUARDS = (
    guards_of("S1")(PROJECTION, "z > spread(view, NEAR)", "z == z"),
    guards_of("S2")(PROJECTION, "near_x, near_y = _clamped(view, xz, yz)", "near_x, near_y = xz, yz"),
    guards_of("S3")(PROJECTION, "return a + low, b, c + low, fma(low, (a + c) + low, sharp)", "return a, b, c, sharp"),
    guards_of("S3")(PROJECTION, "thick = det > spread(view, VARIANCE_MIN) * (a + cc)", "thick = det > zero"),
    guards_of("S4")(PROJECTION, "o = o * _compensation(view, sharp, choose(thick, det, splat(1.0)))", "o = o + zero"),
    guards_of("S5")(PROJECTION, "sharp = _dot(n, n)", "sharp = a * c - b * b"),
    guards_of("S5")(f"{DEFINITION}/projection.py", "sharp = _dot(n, n)", "sharp = a * c - b * b"),
    guards_of("S6")(COMPOSITE, "fma(t, t, fma(p, p, lift))", "fma(t, t, lift - p * p)"),
    guards_of("S7")(COMPOSITE, "least(exp2_minus(e), cap) * before", "exp2_minus(e) * before"),
    guards_of("S7")(COMPOSITE, "opacity = least(raw, cap)", "opacity = raw"),
    guards_of("S8")(COMPOSITE, "q = choose(raw < cap,", "q = choose(raw < splat(0.98),"),
    guards_of("S8")(REFERENCE, ".clamp(max=cutoffs.alpha_max)", ".clamp(max=0.98)"),
    guards_of("S9")(
        f"{DEFINITION}/scene.py", "transmittance_stop: float = 0.9999e-4", "transmittance_stop: float = 1e-4"
    ),
    guards_of("S10")(
        COMPOSITE,
        "weight = choose(e <= reach, least(exp2_minus(e), cap) * before, zero)",
        "weight = least(exp2_minus(e), cap) * before",
        (PROJECTION, "z > spread(view, NEAR)), o >= spread(view, ALPHA_MIN))", "z > spread(view, NEAR)), finite)"),
        (PROJECTION, "both(both(x0 <= x1, y0 <= y1), o >= spread(view, ALPHA_MIN))", "both(x0 <= x1, y0 <= y1)"),
    ),
    guards_of("S11")(QUATERNIONS, " / torch.where(usable, largest, torch.ones_like(largest))", ""),
    guards_of("S11")(QUATERNIONS, "torch.where(usable[:, :, None], matrices, torch.nan)", "matrices"),
    guards_of("S12")(*SANE),
    guards_of("S13")(PROJECTION, "fma(m[0], zero, fma(m[1], zero, fma(m[2], zero, o * zero)))", "o * zero"),
    guards_of("S13")(PROJECTION, "fma(m[2], zero, o * zero)", "m[2] * zero"),
    guards_of("S13")(PROJECTION, "t = fma(s[0], zero, fma(s[1], zero, fma(s[2], zero, t)))", "t = t + zero", SANE),
    guards_of("S13")(PROJECTION, "t = fma(c[0], zero, fma(c[1], zero, fma(c[2], zero, t)))", "t = t + zero"),
    guards_of("S13")(
        PROJECTION,
        "t = fma(r[0], zero, fma(r[1], zero, fma(r[2], zero, fma(r[3], zero, fma(r[4], zero, t)))))",
        "t = t + zero",
        (PROJECTION, "t = fma(r[5], zero, fma(r[6], zero, fma(r[7], zero, fma(r[8], zero, t))))", "t = t + zero"),
        SANE,
    ),
    guards_of("S14")(
        COMPOSITE,
        "                    if x < width and y < height:",
        "                    if left + TILE_X <= width and top + TILE_Y <= height:",
    ),
    guards_of("S15")(
        TILES,
        "        for j in range(n):\n            k = np.uint64(at)",
        "        for j in range(n - 1, -1, -1):\n            k = np.uint64(at)",
    ),
    guards_of("S16")(COMPOSITE, "*(i % BLOCK_X + CENTRE for", "*(i % BLOCK_X for"),
    guards_of("S17")(BACKEND, "        k[0, 1],\n        cx,", "        k[0, 1],\n        w / 2,"),
    guards_of("S18")(
        "dags/export/background.py",
        "np.rint(color + rest)",
        "np.rint(color * (alpha / np.float32(255))[..., None] + rest)",
    ),
    guards_of("S18")(COMPOSITE, "np.float32(1.0) - abs(state[k * state_size + i])", "abs(state[k * state_size + i])"),
    guards_of("S19")(BYTES, ".clamp(0, 1)", ".clamp(max=1)"),
    guards_of("S20")(BACKEND, "[*range(0, whole, BLOCK), whole]", "_evenly(whole, task.threads, WIDTH)"),
    guards_of("S21")(BYTES, ".clamp(0, 1)", ".clamp(min=0)"),
    guards_of("S21")(BYTES, "torch.round(", "torch.floor("),
    guards_of("S22")(PROJECTION, "greatest(root(sharp / det), spread(view, COMPENSATION_MIN))", "root(sharp / det)"),
    guards_of("S22")(
        BACKWARD,
        "factor = choose(on, greatest(ratio, spread(view, COMPENSATION_MIN)), one)",
        "factor = choose(on, ratio, one)",
    ),
    guards_of("S22")(BACKWARD, "above = both(on, ratio > spread(view, COMPENSATION_MIN))", "above = on"),
    guards_of("S22")(PROJECTION, "o = o * _compensation(view, sharp, choose(thick, det, splat(1.0)))", "o = o + zero"),
)
