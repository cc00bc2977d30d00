"""Frozen: the plain torch rasterizer this project had first, to measure the compiled one against. Never made faster.

float32, vectorised over tiles, differentiated by autograd: tiles of 4 px (four times faster than tiles of 16 on
pixel-sized Gaussians, both forward and backward, so it is no straw man), lists by a stable sort, finished tiles laid
aside, memory bounded. Colour and alpha only. What it computes is what stages/splatting/definition/reference.py
computes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch

PIXEL_CENTRE = 0.5
NEAR, FRUSTUM_MARGIN, VARIANCE_MIN, ALPHA_MIN, ALPHA_MAX, TRANSMITTANCE_STOP = (
    0.01,
    0.3,
    1e-10,
    1 / 255,
    0.99,
    0.9999e-4,
)
TILE = 4
"""Side of a tile, px. Small, because pixel-aligned Gaussians are: 0.17 s a 512 px picture, against 0.32 with 8 and
0.75 with 16."""
CHUNK = 8
"""Gaussians of a tile that are fetched at once; between chunks finished tiles are laid aside."""
BATCH_PIXELS = 2**15
"""Pixels composited together. torch splits elementwise work between threads above 2^15 elements, where its vector
code may hand over to scalar code that rounds `exp` differently; a GPU wants wide batches."""
BATCH_PAIRS = 2**22
"""(tile, Gaussian) pairs listed at once; a region with more is halved."""


@dataclass(frozen=True, eq=False)
class Projected:
    """The K Gaussians that can reach the picture, in the order of the input."""

    mean: torch.Tensor  # [K, 2]
    """Centres, px, our pixel centres."""
    whitening: torch.Tensor  # [K, 4]
    """Rows (p0, p1), (q0, q1): exponent(d) = ((p0 dx + p1 dy)^2 + (q0 dx + q1 dy)^2) / 2."""
    extent: torch.Tensor  # [K, 2]
    """Half width and height of the box outside which alpha < alpha_min, px; carries no gradient."""
    depth: torch.Tensor  # [K]
    """Distance along the optical axis, metres."""
    opacity: torch.Tensor  # [K]
    """Alpha at the centre."""
    color: torch.Tensor  # [K, 3]
    """As in the input."""
    masked: int
    """Gaussians left out because an input or their projection was not finite."""


def finite_rows(g: Any) -> torch.Tensor:
    """[N] bool: every attribute of the Gaussian is a finite number."""
    parts = (g.mean, g.rotation.flatten(1), g.scale, g.opacity[:, None], g.color)
    return torch.isfinite(torch.cat(parts, dim=1)).all(dim=1)


def _rows(g: Any, keep: torch.Tensor) -> Any:
    return type(g)(g.mean[keep], g.rotation[keep], g.scale[keep], g.opacity[keep], g.color[keep])


def project(gaussians: Any, camera: Any) -> Projected:
    """Project, cull and bound Gaussians; differentiable in every attribute of those that are kept.

    Culled: z <= near, opacity < alpha_min, a projection thinner than `variance_min`, a box that holds no pixel centre.
    Masked and counted: anything not finite, in the input or in its projection. What is left out is found without
    gradients and taken away before the arithmetic that has them, so that no NaN enters one.
    """
    with torch.no_grad():
        finite = torch.nonzero(finite_rows(gaussians))[:, 0]
        g = _rows(gaussians, finite)
        front = (_camera_axis(g.mean, camera, 2) > NEAR) & (g.opacity >= ALPHA_MIN)
        index, g = finite[front], _rows(g, front)
        s = _on_screen(g, camera)
        reach = 2 * torch.log((g.opacity / ALPHA_MIN).clamp(min=1.0))
        # float32 rounding at 8k px
        extent = torch.stack([torch.sqrt(reach * s.a), torch.sqrt(reach * s.c)], dim=1) + 0.01
        sane = torch.isfinite(s.det) & torch.isfinite(s.u) & torch.isfinite(s.v) & torch.isfinite(extent).all(dim=1)
        keep = sane & (s.det > VARIANCE_MIN * (s.a + s.c))
        keep &= (s.u + extent[:, 0] >= PIXEL_CENTRE) & (s.u - extent[:, 0] <= camera.width - 1 + PIXEL_CENTRE)
        keep &= (s.v + extent[:, 1] >= PIXEL_CENTRE) & (s.v - extent[:, 1] <= camera.height - 1 + PIXEL_CENTRE)
        masked = len(gaussians) - len(finite) + int((~sane).sum())
    g = _rows(gaussians, index[keep])
    s = _on_screen(g, camera)
    return Projected(
        torch.stack([s.u, s.v], dim=1), _whitening(s.a, s.b, s.c, s.det), extent[keep], s.z, g.opacity, g.color, masked
    )


class _Screen(NamedTuple):
    """Centres u, v px, depth z m, covariance [[a, b], [b, c]] px^2 and its determinant, each [N]."""

    u: torch.Tensor
    v: torch.Tensor
    z: torch.Tensor
    a: torch.Tensor
    b: torch.Tensor
    c: torch.Tensor
    det: torch.Tensor


def _on_screen(g: Any, camera: Any) -> _Screen:
    x, y, z = (_camera_axis(g.mean, camera, i) for i in range(3))
    k = camera.intrinsics
    u = float(k[0, 0]) * (x / z) + float(k[0, 1]) * (y / z) + float(k[0, 2])
    v = float(k[1, 1]) * (y / z) + float(k[1, 2])
    m0, m1 = _jacobian_rows(g, camera, x / z, y / z, z)
    a, b, c = _dot(m0, m0), _dot(m0, m1), _dot(m1, m1)
    n = torch.linalg.cross(m0, m1)
    det = _dot(n, n)
    return _Screen(u, v, z, a, b, c, det)


def _camera_axis(mean: torch.Tensor, camera: Any, i: int) -> torch.Tensor:
    """[N] one camera coordinate, written out: no matrix product whose summation order depends on threads."""
    r = camera.world_to_camera[i].tolist()
    return r[0] * mean[:, 0] + r[1] * mean[:, 1] + r[2] * mean[:, 2] + r[3]


def _dot(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    return a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1] + a[:, 2] * b[:, 2]


def _jacobian_rows(
    g: Any, camera: Any, xz: torch.Tensor, yz: torch.Tensor, z: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Rows [N, 3] of M = J W R S, px. The affine approximation is taken inside the widened frustum:
    limits from cx, cy."""
    k = camera.intrinsics
    fx, skew, cx, fy, cy = (float(k[i]) for i in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2)))
    margin_x, margin_y = FRUSTUM_MARGIN * 0.5 * camera.width / fx, FRUSTUM_MARGIN * 0.5 * camera.height / fy
    xz = xz.clamp(-cx / fx - margin_x, (camera.width - cx) / fx + margin_x)
    yz = yz.clamp(-cy / fy - margin_y, (camera.height - cy) / fy + margin_y)
    axes = g.rotation * g.scale[:, None, :]  # [N, 3 world, 3 axes]
    w = camera.world_to_camera[:3, :3].tolist()
    b = [w[i][0] * axes[:, 0] + w[i][1] * axes[:, 1] + w[i][2] * axes[:, 2] for i in range(3)]  # 3 x [N, 3 axes]
    dx = (b[0] - xz[:, None] * b[2]) / z[:, None]
    dy = (b[1] - yz[:, None] * b[2]) / z[:, None]
    return fx * dx + skew * dy, fy * dy


def _whitening(a: torch.Tensor, b: torch.Tensor, c: torch.Tensor, det: torch.Tensor) -> torch.Tensor:
    """[K, 4] square root of the conic of [[a, b], [b, c]], completing the square on the larger diagonal entry."""
    wide = a.detach() >= c.detach()
    pivot = torch.where(wide, a, c)
    first, slope = 1 / torch.sqrt(pivot), b / pivot
    second = torch.sqrt(pivot / det)
    zero = torch.zeros_like(first)
    return torch.stack(
        [
            torch.where(wide, first, zero),
            torch.where(wide, zero, first),
            torch.where(wide, -slope * second, second),
            torch.where(wide, second, -slope * second),
        ],
        dim=1,
    )


class _Region(NamedTuple):
    """A rectangle of tiles, half open."""

    x0: int
    y0: int
    x1: int
    y1: int

    @property
    def tiles(self) -> int:
        return (self.x1 - self.x0) * (self.y1 - self.y0)

    def halves(self) -> tuple[_Region, _Region]:
        if self.x1 - self.x0 >= self.y1 - self.y0:
            middle = (self.x0 + self.x1) // 2
            return self._replace(x1=middle), self._replace(x0=middle)
        middle = (self.y0 + self.y1) // 2
        return self._replace(y1=middle), self._replace(y0=middle)


def rasterize(gaussians: Any, camera: Any, tile: int = TILE) -> tuple[torch.Tensor, torch.Tensor]:
    """(color [h, w, 3], alpha [h, w]) of one camera."""
    p = project(gaussians, camera)
    features, boxes = _sorted_by_depth(p, camera, tile)
    across, down = -(-camera.width // tile), -(-camera.height // tile)
    picture = features.new_zeros((across * down, 4, tile * tile))
    parts, places = [features[:0, :4, None].expand(0, 4, tile * tile)], [torch.zeros(0, dtype=torch.int64)]
    for region, lists, starts, counts in _tile_lists(boxes, _Region(0, 0, across, down), tile):
        columns, rows = torch.arange(region.x0, region.x1), torch.arange(region.y0, region.y1)
        tiles = (rows[:, None] * across + columns).reshape(-1)  # [B]
        done, values = _composite(features, lists, starts, counts, _pixel_centres(tiles, across, tile, features))
        places.append(tiles[done])
        parts.append(values)
    picture = picture.index_put((torch.cat(places),), torch.cat(parts))
    picture = picture.reshape(down, across, 4, tile, tile).permute(0, 3, 1, 4, 2).reshape(down * tile, across * tile, 4)
    picture = picture[: camera.height, : camera.width]
    return picture[..., :3], picture[..., 3]


def _sorted_by_depth(p: Projected, camera: Any, tile: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Features [K, 10] = (u, v, whitening, opacity, color) by ascending depth, and tile boxes [K, 4] half open."""
    order = torch.argsort(p.depth.detach(), stable=True)
    features = torch.cat([p.mean, p.whitening, p.opacity[:, None], p.color], dim=1)[order]
    with torch.no_grad():
        mean, extent = p.mean[order], p.extent[order]
        limit = mean.new_tensor([camera.width, camera.height])
        # pixel index whose centre is inside
        first = torch.minimum(torch.ceil(mean - extent - PIXEL_CENTRE).clamp(min=0), limit).to(torch.int64)
        last = torch.minimum(torch.floor(mean + extent - PIXEL_CENTRE).clamp(min=-1), limit - 1).to(torch.int64)
        empty = (last < first).any(dim=1, keepdim=True)
        low, high = first // tile, last // tile + 1
        boxes = torch.cat([low, torch.where(empty, low, high)], dim=1)
    return features, boxes


def _tile_lists(
    boxes: torch.Tensor, region: _Region, tile: int
) -> Iterator[tuple[_Region, torch.Tensor, torch.Tensor, torch.Tensor]]:
    """Lists of Gaussians of every tile of the region, halving it until batches are small.

    Yields (region, lists [M] indices grouped by tile and by depth within it, starts [B], counts [B]).
    """
    x0, x1 = (boxes[:, i].clamp(region.x0, region.x1) for i in (0, 2))
    y0, y1 = (boxes[:, i].clamp(region.y0, region.y1) for i in (1, 3))
    n = (x1 - x0) * (y1 - y0)
    pairs = int(n.sum())
    if pairs == 0:
        return
    batch = BATCH_PIXELS
    if region.tiles > 1 and (pairs > BATCH_PAIRS or region.tiles * tile * tile > batch):
        touching = boxes[n > 0]
        index = torch.nonzero(n > 0)[:, 0]
        for half in region.halves():
            for leaf, lists, starts, counts in _tile_lists(touching, half, tile):
                yield leaf, index[lists], starts, counts
        return
    owner = torch.repeat_interleave(torch.arange(len(n), device=n.device), n)  # [M], ascending depth
    local = torch.arange(pairs, device=n.device) - torch.repeat_interleave(torch.cumsum(n, 0) - n, n)
    across = (x1 - x0)[owner]
    slot = (y0[owner] + local // across - region.y0) * (region.x1 - region.x0) + x0[owner] + local % across - region.x0
    counts = torch.bincount(slot, minlength=region.tiles)
    yield region, owner[torch.argsort(slot, stable=True)], torch.cumsum(counts, 0) - counts, counts


def _pixel_centres(
    tiles: torch.Tensor, across: int, tile: int, like: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Columns and rows [B, tile^2] of the pixel centres of each tile, px."""
    inside = torch.arange(tile * tile, device=tiles.device)
    x = (tiles % across)[:, None] * tile + inside % tile
    y = torch.div(tiles, across, rounding_mode="floor")[:, None] * tile + torch.div(inside, tile, rounding_mode="floor")
    return x.to(like.dtype) + PIXEL_CENTRE, y.to(like.dtype) + PIXEL_CENTRE


def _composite(
    features: torch.Tensor,
    lists: torch.Tensor,
    starts: torch.Tensor,
    counts: torch.Tensor,
    centres: tuple[torch.Tensor, torch.Tensor],
) -> tuple[torch.Tensor, torch.Tensor]:
    """Blend the listed Gaussians of B tiles of P pixels front to back.

    Returns (slots [B'], values [B', 4, P] = premultiplied colour, alpha): tiles in the order they were finished,
    a tile being finished when its list ends or when none of its pixels lets light through.
    """
    slots = torch.nonzero(counts)[:, 0]
    x, y = centres[0][slots], centres[1][slots]
    transmittance, total = torch.ones_like(x), x.new_zeros((len(x), 4, x.shape[1]))
    done, values, first = [], [], 0
    while len(slots):
        step = first + torch.arange(CHUNK, device=lists.device)
        listed = step < counts[slots, None]  # [B, CHUNK]
        g = features[lists[(starts[slots, None] + step).clamp(max=len(lists) - 1)]]  # [B, CHUNK, 10]
        for i in range(CHUNK):
            transmittance, total = _blend(g[:, i, :, None], listed[:, i, None], x, y, transmittance, total)
        first += CHUNK
        alive = (counts[slots] > first) & (transmittance.detach() > TRANSMITTANCE_STOP).any(dim=1)
        if not bool(alive.all()):
            done.append(slots[~alive])
            values.append(total[~alive])
            slots, x, y, transmittance, total = slots[alive], x[alive], y[alive], transmittance[alive], total[alive]
    return torch.cat(done), torch.cat(values)


def _blend(
    g: torch.Tensor,
    listed: torch.Tensor,
    x: torch.Tensor,
    y: torch.Tensor,
    transmittance: torch.Tensor,
    total: torch.Tensor,
) -> tuple[torch.Tensor, torch.Tensor]:
    """One Gaussian a tile, g [B, 10, 1], over its P pixels. The transmittance runs on past the stop: it never rises
    again, so that everything behind the first dropped Gaussian is dropped with it.
    """
    dx, dy = x - g[:, 0], y - g[:, 1]
    p, q = g[:, 2] * dx + g[:, 3] * dy, g[:, 4] * dx + g[:, 5] * dy
    alpha = (g[:, 6] * torch.exp(-0.5 * (p * p + q * q))).clamp(max=ALPHA_MAX)
    alpha = torch.where(listed & (alpha >= ALPHA_MIN), alpha, 0.0)
    behind = transmittance * (1 - alpha)
    weight = torch.where(behind > TRANSMITTANCE_STOP, transmittance * alpha, 0.0)
    payload = torch.cat([g[:, 7:10], torch.ones_like(g[:, :1])], dim=1)  # [B, 4, 1]
    return behind, total + weight[:, None, :] * payload
