"""Guards of D5 and L1-L10: measures, losses, heads and steps of training."""

from __future__ import annotations

from tests.mutations.guard import guards_of

SSIM, MS_SSIM, PSNR, LPIPS = (f"stages/metrics/measures/{n}.py" for n in ("ssim", "ms_ssim", "psnr", "lpips_network"))
HEADS, LOSSES = "stages/network/model/heads.py", "stages/network/losses.py"

GUARDS = (
    guards_of("L1")(SSIM, "np.atleast_3d(p.astype(np.float64))", "np.atleast_3d(p.astype(np.float32))"),
    guards_of("L1b")(
        MS_SSIM,
        "np.maximum(full if scale == len(WEIGHTS) - 1 else contrast, 0) ** weight",
        "(full if scale == len(WEIGHTS) - 1 else contrast) ** weight",
    ),
    guards_of("L2")(PSNR, "return cap if mse == 0 else min(cap,", "return min(np.inf,"),
    guards_of("L3")(LPIPS, "/ data_range * 2 - 1", "/ data_range"),
    guards_of("L3")(LPIPS, "/ data_range * 2 - 1", "/ 255 * 2 - 1"),
    guards_of("L4")(SSIM, "(0.01 * data_range) ** 2, (0.03 * data_range) ** 2", "2.55**2, 7.65**2"),
    guards_of("L4")(PSNR, "data_range**2 / mse", "255**2 / mse"),
    guards_of("L7")(ERROR := "stages/metrics/depth_error.py", "foreground(mask) & (truth > 0)", "foreground(mask)"),
    guards_of("L7")(ERROR, " / ratio\n", "\n"),
    guards_of("D5")(LOSSES, "mu ** (last - t)", "mu ** (15 / last * (last - t))"),
    guards_of("L5")(
        HEADS, "softplus(limited(x)) / math.log(2)\n\n\ndef unit", "softplus(x) / math.log(2)\n\n\ndef unit"
    ),
    guards_of("L6")(HEADS, "torch.where(product < 0, -learned, learned)", "learned"),
    guards_of("L6b")(HEADS, "    return torch.sigmoid(limited(x))", "    return torch.sigmoid(x)"),
    guards_of("L8")(
        HEADS,
        "with torch.autocast(features.device.type, enabled=False):",
        "with torch.autocast(features.device.type, torch.bfloat16):",
    ),
    guards_of("L9")(
        "stages/network/model/encoders.py",
        'nn.GroupNorm(channels // GROUP, channels) if kind == "group"',
        'nn.BatchNorm2d(channels) if kind == "group"',
    ),
    guards_of("L10")(
        "stages/training/trainer.py",
        "if np.isfinite(norm) and bool(torch.isfinite(terms.total.detach())):",
        "if True:",
    ),
)
