"""One frame's pictures: its source views are lifted once, then drawn into one target camera after the other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np
import torch

from posegaussian.stages.contract.facts import MASKS
from posegaussian.stages.contract.io import Inputs
from posegaussian.stages.contract.reading import read_together
from posegaussian.stages.depth.algorithms.pose_prior import flesh_of
from posegaussian.stages.geometry.subject import look_at_point
from posegaussian.stages.imaging.part import part_around
from posegaussian.stages.rendering.clipping import UNSURE, beside, retouched
from posegaussian.stages.rendering.closing import Body, closed
from posegaussian.stages.rendering.detail import SourcePicture, detailed
from posegaussian.stages.rendering.evening import outlines_for
from posegaussian.stages.rendering.facts import (
    ANTI_ALIASING,
    HOLE_FILLING,
    OUTLINE_EVENING,
    POSE_BLENDING,
    SILHOUETTE_CLIPPING,
    SOURCE_DETAIL,
    SURFACE_CLOSING,
)
from posegaussian.stages.rendering.lift import GaussianMaps, Lifted, from_list, lift
from posegaussian.stages.rendering.mip import mip_filter, pixel_size
from posegaussian.stages.rendering.params import RenderingParams
from posegaussian.stages.rendering.pose_blending import PAST, Sureness, stabilised
from posegaussian.stages.rendering.sources import (
    COUNTS,
    REFINED,
    angles_at,
    cut_off,
    faded_in,
    map_bytes,
    outlines_refined,
    outlines_trusted,
    refined_shares,
    shown,
    unrefined_arrays,
    weights,
)
from posegaussian.stages.silhouettes.hull import Silhouettes
from posegaussian.stages.silhouettes.places import agreed
from posegaussian.stages.silhouettes.softness import softness
from posegaussian.stages.splatting.definition.scene import Camera, Cutoffs, Drawing, Gaussians
from posegaussian.stages.splatting.device import device
from posegaussian.stages.splatting.rasterizer import rasterize
from posegaussian.storage.model.joint_sets import to_set
from posegaussian.storage.model.masks import foreground

Picture: TypeAlias = tuple[torch.Tensor, torch.Tensor]
"""Colour [h, w, 3] premultiplied on black, and alpha [h, w]."""
DTYPES = {"float32": torch.float32, "float64": torch.float64}


class MapReader:
    """Reads a view's arrays when a picture first asks for them, of large pictures some frames at a time."""

    def __init__(self, inputs: Inputs) -> None:
        self.inputs = inputs
        self.subject = look_at_point(inputs.rig.subset(inputs.views.sources))
        """[3] world metres: where the source cameras look."""
        self.shares = refined_shares(inputs)
        """[F] share 0..1 of the refined Gaussians' picture in those of each frame."""
        self._maps: dict[tuple[int, bool], tuple[range, tuple[np.ndarray, ...]]] = {}
        """{(view, whether refined): (frames of the partition, what was read of them)}."""
        self._counts: dict[int, np.ndarray] = {}
        """{view: [F]} refined Gaussians, of frames whose refined picture is drawn."""
        self._masks: dict[int, np.ndarray] = {}

    def maps(self, i: int, view: int, refined: bool = False) -> tuple[GaussianMaps, np.ndarray, np.ndarray]:
        """Maps of the i-th frame of the partition, before or after refinement, and the view's intrinsics [3, 3] and
        pose [4, 4]."""
        if (view, refined) not in self._maps or i not in self._maps[view, refined][0]:
            self._maps[view, refined] = self._read(i, view, refined)
        (span, arrays), rig = self._maps[view, refined], self.inputs.rig
        own = [a[i - span.start] for a in arrays]
        maps = from_list([a[: self._counts[view][i]] for a in own], rig) if refined else GaussianMaps(*own)
        return maps, rig.intrinsics[view], rig.world_to_camera[view]

    def _read(self, i: int, view: int, refined: bool) -> tuple[range, tuple[np.ndarray, ...]]:
        """Maps or lists of the i-th frame and of those that are read with it."""
        inputs, start = self.inputs, self.inputs.partition.start
        frame_bytes = map_bytes(int(inputs.rig.size.max(axis=0).prod()), len(inputs.views.sources))
        own = read_together(inputs.partition, start + i, frame_bytes)
        span = range(own.start - start, own.stop - start)
        names, first = unrefined_arrays(inputs.facts), None
        if refined:
            if view not in self._counts:
                self._counts[view] = np.where(self.shares > 0, inputs.read(COUNTS, view), 0)
            names, first = REFINED, int(self._counts[view][span.start : span.stop].max())
        return span, tuple(inputs.read(name, view, own, first) for name in names)

    def masks(self, i: int) -> dict[int, np.ndarray]:
        """Masks [h, w] of the i-th frame by source view that has a picture."""
        if not self._masks:
            self._masks = {v: self.inputs.read("frames/mask", v) for v in self.inputs.views.sources}
        return {v: m[i] for v, m in self._masks.items() if self.inputs.valid[i, v]}

    def flesh(self, i: int) -> np.ndarray:
        """[N, 7] capsules of the subject's limbs whose joints are known in the i-th frame, world metres. Where a limb
        may be is none: of bodies that the pictures cut at the knees balls of 0.6 m would be closed."""
        joint_set = self.inputs.joint_set
        assert joint_set is not None, f"{SURFACE_CLOSING} is on without joints"
        return flesh_of(to_set(self.inputs.read("pose/joints3d")[i : i + 1], joint_set, "coco17")[0], feet=True)

    def sureness(self, i: int) -> Sureness:
        """How sure the source views are of the joints of the i-th frame, from it and the frames before."""
        span, scores = self.inputs.span("pose/joints2d"), {}
        at = self.inputs.partition.start - span.start + i
        first = max(at - PAST, 0)
        while first < at and not self._follows(first - at + i):
            first += 1
        for view in self.inputs.views.sources:
            scores[view] = stabilised(self.inputs.read("pose/joints2d", view)[first : at + 1, :, 2])
        return Sureness(self.inputs.read("pose/joints3d")[i], scores)

    def _follows(self, i: int) -> bool:
        """Whether the frames from the i-th on are consecutive: those of a sample are not, whose times are all 0."""
        return len(self.inputs.time) < 2 or bool((np.diff(self.inputs.time[max(i, 0) :]) > 0).all())


class FrameRenderer:
    """Draws the i-th frame of a partition, from its own maps only."""

    def __init__(self, reader: MapReader, i: int, params: RenderingParams) -> None:
        inputs = reader.inputs
        self.reader, self.i, self.params, self.rig, self.facts = reader, i, params, inputs.rig, inputs.facts
        self.share = float(reader.shares[i])
        """Of the refined Gaussians' picture, 0..1; 0 where there is none."""
        self.retouches = bool(self.facts & {SILHOUETTE_CLIPPING, HOLE_FILLING, SURFACE_CLOSING, OUTLINE_EVENING})
        self.usable = self._usable()
        """[V] source views that have a picture, and by their masks, where these are looked at, the subject in it."""
        self.parts = self._parts()
        """Views whose picture cuts the subject off, by their masks, where these are looked at."""
        self.silhouettes = agreed(inputs.rig, reader.masks(i)) if self.retouches else None
        self.widths = self._widths() if self.facts & {SILHOUETTE_CLIPPING, OUTLINE_EVENING} and self.share > 0 else {}
        """Px over which masks rise, by view, 0 without an outline; nothing while pictures are not refined."""
        self.sureness = reader.sureness(i) if POSE_BLENDING in self.facts else None
        self.body = self._body(self.silhouettes) if SURFACE_CLOSING in self.facts else None
        self.bounds = self._bounds()
        """What pictures are clipped to; None: to nothing."""
        self._lifted: dict[tuple[int, bool], Lifted] = {}
        self._refined: Gaussians | None = None
        self._sources: dict[int, SourcePicture] = {}

    def _usable(self) -> np.ndarray:
        views = np.arange(len(self.rig))
        pictured = np.isin(views, self.reader.inputs.views.sources) & self.reader.inputs.valid[self.i]
        if not self.retouches:
            return pictured
        shown = np.isin(views, [v for v, mask in self.reader.masks(self.i).items() if foreground(mask).any()])
        return shown if shown.any() else pictured

    def _parts(self) -> frozenset[int]:
        if not self.retouches:
            return frozenset()
        return frozenset(v for v, mask in self.reader.masks(self.i).items() if cut_off(mask, self.rig.size[v]))

    def _weights(self, camera: Camera) -> Mapping[int, np.ndarray | float]:
        """{view: weight 0..1, or [N] of each of its Gaussians} of the source views that draw a picture."""
        angles = angles_at(self.reader.subject, self.rig.centres, camera.centre)

        def shown_of(view: int, views: Sequence[int]) -> np.ndarray:
            self._prepare(view, False)
            points = self._lifted[view, False].mean.double().cpu().numpy()
            return shown(self.rig, points, view, views, self.parts)

        return weights(angles, self.usable, self.parts, self.params.sources, shown_of)

    def picture(self, camera: Camera) -> tuple[torch.Tensor, torch.Tensor, int] | None:
        """Colour [h, w, 3] premultiplied on black, alpha [h, w] and how many Gaussians were not finite; None without
        any source view."""
        if not self.usable.any():
            return None
        chosen = self._weights(camera)
        color, alpha, depth, masked = self._drawn(camera, chosen)
        alone = trust = 0.0
        if self.share > 0:
            *refined, _, more = self._drawn(camera, None)
            angles = angles_at(self.reader.subject, self.rig.centres, camera.centre)[self.usable]
            alone, trust = outlines_refined(angles, self.share), outlines_trusted(angles, self.share)
            color, alpha = mixed((color, alpha), (refined[0], refined[1]), self.share, faded_in(angles), alone)
            masked += more
        if depth is not None:
            color = self._detailed(color, alpha, depth, camera, chosen)
        return *self._retouched(color, alpha, depth, camera, alone, trust), masked

    def _drawn(
        self, camera: Camera, chosen: Mapping[int, np.ndarray | float] | None
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor | None, int]:
        """The picture of the Gaussians before refinement, of the `chosen` views by `_weights`, or after it, None, of
        all views and the same from all sides; as `picture` returns it, without retouches. Before refinement, where
        detail is looked up, also depth [h, w] metres, 0 where less than half of a pixel is covered."""
        refined = chosen is None
        views = [int(v) for v in np.flatnonzero(self.usable)] if chosen is None else list(chosen)
        for view in views:
            self._prepare(view, refined)
        if chosen is None:
            gaussians = self._from_all_sides(views)
        else:
            gaussians = Gaussians.concatenate([self._seen(camera, v, weight, views) for v, weight in chosen.items()])
        cutoffs = mip_filter(camera, self.rig, views, self.reader.subject) if ANTI_ALIASING in self.facts else Cutoffs()
        located = SOURCE_DETAIL in self.facts and not refined
        picture = rasterize(gaussians, [camera], ("depth",) if located else (), Drawing(cutoffs))
        masked = picture.masked[0] + sum(self._lifted[v, refined].masked for v in views)
        color, alpha, depth = picture.color[0], picture.alpha[0], None
        if located:
            assert picture.depth is not None
            depth = torch.where(alpha > 0.5, picture.depth[0] / alpha.clamp(min=0.5), 0)
        return color, alpha, depth, masked

    def _detailed(
        self,
        color: torch.Tensor,
        alpha: torch.Tensor,
        depth: torch.Tensor,
        camera: Camera,
        chosen: Mapping[int, np.ndarray | float],
    ) -> torch.Tensor:
        """The colour with the detail of the `chosen` source views, which are drawn, on the CPU."""
        masks = self.reader.masks(self.i)
        for view in chosen:
            if view not in self._sources:
                self._sources[view] = SourcePicture.of(*self.reader.maps(self.i, view), masks[view])
        subject = self.reader.subject
        pixel = pixel_size(np.asarray(camera.intrinsics), camera.centre, subject)
        sources = [
            (
                self._sources[v].averaged(pixel / pixel_size(self.rig.intrinsics[v], self.rig.centres[v], subject)),
                float(np.max(weight)),
            )
            for v, weight in chosen.items()
        ]
        drawn, covered, surface = (t.cpu().numpy() for t in (color, alpha, depth))
        return torch.from_numpy(detailed(drawn, covered, surface, camera, sources))

    def _retouched(
        self,
        color: torch.Tensor,
        alpha: torch.Tensor,
        depth: torch.Tensor | None,
        camera: Camera,
        alone: float,
        trust: float,
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Colour and alpha of a picture with gaps closed, holes filled, the outline evened and the rest clipped, as far
        as these are on.

        `alone` 0..1: how far outlines are the refined picture's alone. Then its light is right, too, where it is not
        quite opaque within them: that becomes opaque, but no brighter. Fifteen tuning people filmed from 15 to 36
        degrees apart gain 0.19 dB on the mean by it (384 px; 0.00 to 0.55).
        """
        if self.silhouettes is None:
            return color, alpha
        touched = color.cpu().numpy(), alpha.cpu().numpy()
        if self.body is not None:
            touched = closed(*touched, self.body, camera)
        lit = 1 - alone if HOLE_FILLING in self.facts else None
        outlines = (
            outlines_for(camera, self.rig, self.silhouettes, self.reader.masks(self.i), self.widths)
            if OUTLINE_EVENING in self.facts
            else None
        )
        if lit is not None or self.bounds is not None or outlines:
            near = None if depth is None else depth.cpu().numpy()
            sharp = trust, alone
            touched = retouched(*touched, self.silhouettes, camera, lit, outlines, self.bounds, near, sharp)
        return torch.from_numpy(touched[0]), torch.from_numpy(touched[1])

    def _widths(self) -> dict[int, float]:
        sizes = self.rig.size
        return {v: softness([m[: sizes[v, 1], : sizes[v, 0]]]) for v, m in self.reader.masks(self.i).items()}

    def _bounds(self) -> Silhouettes | None:
        """The silhouettes, as much wider as their masks are unsure of outlines."""
        if self.silhouettes is None or SILHOUETTE_CLIPPING not in self.facts:
            return None
        if MASKS not in self.facts:
            return self.silhouettes.wider(UNSURE * self.silhouettes.sizes.max(axis=1))
        if self.share == 0:
            return self.silhouettes
        widths = [width for width in self.widths.values() if width > 0]
        spared = beside(float(np.median(widths))) if widths else 0.0
        return self.silhouettes.wider(spared) if spared > 0 else self.silhouettes

    def _body(self, silhouettes: Silhouettes | None) -> Body | None:
        """What closes gaps; None where no source view has a picture."""
        masks = self.reader.masks(self.i)
        if silhouettes is None or not masks:
            return None
        maps = {v: self.reader.maps(self.i, v)[0] for v in masks}
        depth, color = ({v: np.asarray(getattr(m, n)) for v, m in maps.items()} for n in ("depth", "color"))
        return Body.of(self.rig, silhouettes, self.reader.flesh(self.i), depth, color, masks)

    def _prepare(self, view: int, refined: bool) -> None:
        if (view, refined) in self._lifted:
            return
        posed = self.reader.maps(self.i, view, refined)
        self._lifted[view, refined] = lift(*posed, DTYPES[self.params.precision], device())

    def _from_all_sides(self, views: list[int]) -> Gaussians:
        """The refined Gaussians of all usable views, which every picture of the frame shows alike."""
        if self._refined is None:
            self._refined = Gaussians.concatenate([self._lifted[v, True].from_all_sides() for v in views])
        return self._refined

    def _seen(self, camera: Camera, view: int, weight: np.ndarray | float, views: list[int]) -> Gaussians:
        """One view's Gaussians as the camera sees them."""
        seen = self._lifted[view, False].seen_from(camera)
        if isinstance(weight, np.ndarray):
            drawn = torch.from_numpy(np.flatnonzero(weight)).to(seen.mean.device)
            seen = Gaussians(*(getattr(seen, name)[drawn] for name in Gaussians.__dataclass_fields__))
            opacity = seen.opacity * torch.from_numpy(weight).to(seen.opacity)[drawn]
        else:
            opacity = seen.opacity * weight
        if self.sureness is not None:
            share = self.sureness.share(seen.mean.double().cpu().numpy(), view, views)
            opacity = opacity * torch.from_numpy(share).to(opacity)
        return replace(seen, opacity=opacity)


def mixed(unrefined: Picture, refined: Picture, share: float, fade: float, outlines: float) -> Picture:
    """`share` 0..1 of the refined picture where it has faded in, `fade` 1. Where it has not, 0, it lies behind the
    other: what the nearest view leaves transparent because a neighbour is to draw it, which has itself faded out there.

    With `outlines` of 1 a pixel that either picture leaves transparent is the refined one's alone, one that is opaque
    in both the mean, and between them its share grows with 1 - alpha^2 of the less opaque.
    """
    whole = torch.zeros_like(unrefined[0]), torch.zeros_like(unrefined[1])
    part = part_around(((unrefined[1] > 0) | (refined[1] > 0)).cpu().numpy(), 0)
    (color, alpha), (behind, behind_alpha) = ((p[0][part], p[1][part]) for p in (unrefined, refined))
    left = (1 - fade) * (1 - alpha)
    color, alpha = color + left[..., None] * behind, alpha + left * behind_alpha
    thin = 1 - torch.minimum(alpha, behind_alpha).clamp(0, 1) ** 2
    s = 1 - (1 - share * fade) * (1 - outlines * thin)
    whole[0][part] = s[..., None] * behind + (1 - s)[..., None] * color
    whole[1][part] = s * behind_alpha + (1 - s) * alpha
    return whole
