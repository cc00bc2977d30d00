"""Guards of D2b-D12b: the matching network's correlation, coordinates and coding of depth."""

from __future__ import annotations

from tests.mutations.guard import guards_of

CORRELATION, CODING, REFINE, UPDATE = (
    f"stages/network/model/{n}.py" for n in ("correlation", "disparity", "refine", "update")
)

GUARDS = (
    guards_of("D2b")(
        CORRELATION, "disparity = disparity.to(exact(disparity.dtype))", "disparity = disparity.bfloat16()"
    ),
    guards_of("D2b")(CORRELATION, "disparity = disparity.to(exact(disparity.dtype))", "disparity = disparity + 0"),
    guards_of("D3b")(CODING, "torch.minimum(torch.maximum(inverse, 1 / far), 1 / near)", "inverse"),
    guards_of("D3b")(
        CODING, "torch.minimum(torch.maximum(inverse, 1 / far), 1 / near)", "torch.minimum(inverse, 1 / near)"
    ),
    guards_of("D3b")(
        CODING, "torch.minimum(torch.maximum(inverse, 1 / far), 1 / near)", "torch.maximum(inverse, 1 / far)"
    ),
    guards_of("D10b")(
        REFINE,
        "disparity = coding.limit(disparity + delta.to(disparity.dtype), self.factor)",
        "disparity = disparity + delta.to(disparity.dtype)",
    ),
    guards_of("D10b")(CODING, "known = torch.isfinite(disparity)\n", "known = ~torch.isnan(disparity)\n"),
    guards_of("D10b")(CODING, "known = torch.isfinite(disparity)\n", "known = ~torch.isinf(disparity)\n"),
    guards_of("D6")(CORRELATION, "first.to(dtype) / math.sqrt(channels)", "first.to(dtype)"),
    guards_of("D6")(
        CORRELATION, "dtype = torch.promote_types(exact(first.dtype), second.dtype)", "dtype = second.dtype"
    ),
    guards_of("D6")(
        CORRELATION,
        "with torch.autocast(first.device.type, enabled=False):",
        "with torch.autocast(first.device.type, torch.float16):",
    ),
    guards_of("D7")(CORRELATION, "second.shape[3], levels) <= budget:", "second.shape[3], levels) > 0:"),
    guards_of("D8")(CORRELATION, "(1, size), ceil_mode=True)", "(1, size))"),
    guards_of("D9b")(CORRELATION, "index.clamp(0, width - 1)) * inside", "index.clamp(0, width - 1))"),
    guards_of("D12b")(UPDATE, 'mode="replicate"', 'mode="constant"'),
    guards_of("D11b")(CORRELATION, "((columns - (2**level - 1) / 2) / 2**level)", "(columns / 2**level)"),
)
