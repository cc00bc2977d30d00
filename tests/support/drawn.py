"""What an exported page shows, and what our renderer draws of the Gaussians in it: the pipeline's own functions,
without its retouches."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from posegaussian.dags.export.page import silhouettes_at, view_maps
from posegaussian.dags.planning.results import Results
from posegaussian.stages.geometry.subject import look_at_point
from posegaussian.stages.rendering.effects import ANTI_ALIASING
from posegaussian.stages.rendering.lift import GaussianMaps, Lifted, lift
from posegaussian.stages.rendering.mip import mip_filter
from posegaussian.stages.rendering.sources import angles_at, choose
from posegaussian.stages.splatting.definition.scene import Camera, Cutoffs, Drawing, Gaussians
from posegaussian.stages.splatting.rasterizer import rasterize
from tests.support.browser import Browser, decoded


def lifted(results: Results, frame: int, view: int) -> Lifted:
    """The Gaussians of one frame of a source view."""
    rig, m = results.context.rig, view_maps(results, frame, view, silhouettes_at(results, frame))
    maps = GaussianMaps(m.color, m.depth, m.scale, m.normal, m.opacity, m.twist, m.shift)
    return lift(maps, rig.intrinsics[view], rig.world_to_camera[view], torch.float32, torch.device("cpu"))


def drawn(results: Results, frame: int, camera: Camera, refined: bool = False) -> np.ndarray:
    """[h, w, 3] uint8 sRGB over black; `refined`: of all views and the same from all sides, as refined frames are."""
    context = results.context
    subject = look_at_point(context.rig.subset(context.views.sources))
    usable = np.isin(np.arange(len(context.rig)), context.views.sources) & context.valid[frame]
    angles = angles_at(subject, context.rig.centres, camera.centre)
    chosen = (
        [(int(v), 1.0) for v in np.flatnonzero(usable)]
        if refined
        else choose(angles, usable, context.settings.rendering.sources)
    )
    parts = []
    for view, weight in chosen:
        own = lifted(results, frame, view)
        seen = own.from_all_sides() if refined else own.seen_from(camera)
        parts.append(replace(seen, opacity=seen.opacity * weight))
    filtered = mip_filter(camera, context.rig, [v for v, _ in chosen], subject)
    wide = 1 / np.sqrt(1 - 12 * filtered.low_pass)  # the ratio that the filter is made of
    coarse = 1.0 if ANTI_ALIASING.name in context.facts else ANTI_ALIASING.threshold
    cutoffs = filtered if wide > coarse else Cutoffs()
    picture = rasterize(Gaussians.concatenate(parts), [camera], drawing=Drawing(cutoffs))
    return (picture.color[0].clamp(0, 1) * 255).round().to(torch.uint8).numpy()


def decoded_picture(browser: Browser) -> np.ndarray:
    """[h, w, 3] uint8 sRGB of an exported page's canvas, when everything asked for is on it."""
    browser.run("posegaussian.settled()")
    return decoded(browser.run("posegaussian.picture()"))


def camera_of(browser: Browser) -> Camera:
    """The camera that an exported page draws for."""
    said = browser.run("posegaussian.seen")
    fx, skew, cx, fy, cy = said["lens"]
    pose = np.concatenate([np.reshape(said["pose"], (3, 4)), [[0, 0, 0, 1]]])
    return Camera(np.array([[fx, skew, cx], [0, fy, cy], [0, 0, 1]]), pose, *said["size"])


def person_psnr(a: np.ndarray, b: np.ndarray) -> float:
    """Of two pictures [h, w, 3] uint8, over the pixels in which either shows anything before black, in dB."""
    shown = (a > 0).any(axis=-1) | (b > 0).any(axis=-1)
    error = ((a[shown].astype(float) - b[shown]) ** 2).mean()
    return float(10 * np.log10(255**2 / max(error, 1e-12)))
