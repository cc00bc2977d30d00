"""What a single camera gives: pictures of cameras beside it, from a relief, from a user's depth maps, and from a second
camera.

    python -m benchmarks.depth.monocular                     the published figures: seeds 9000-9003, cameras 5, 10, 20
    and 30 degrees away python -m benchmarks.depth.monocular --seeds 1-2         tuning; seeds from 9000 on are for
    publishing only

Simulated people (benchmark scenes, 384 px, one frame, exact masks) filmed by one source camera. Box PSNR in dB of each
held-out camera.

flat: the silhouette on a plane at the median of the true depth. relief: the default with no depth maps, with the same
median; guessed: where a person of 1.8 m fills three quarters of the picture. given: true depth as a user's depth maps;
noise: with errors of 1 % of the depth, a third of it from pixel to pixel and the rest over 16 px; coarse: at a quarter
of the resolution, in whole millimetres; scaled: 10 % too far, as depth from a network may be. second: no depth maps,
and another source camera 40 degrees away.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.quality.views import seeds
from benchmarks.report import publish
from posegaussian.dags.planning.results import Results
from posegaussian.dags.runtime.threads import limit
from posegaussian.dags.simulation.simulated_run import run_capture
from posegaussian.stages.depth.algorithms.relief import relief
from posegaussian.stages.metrics.params import MetricsParams
from posegaussian.stages.metrics.run import measure
from posegaussian.stages.simulator.quality_scenes import benchmark_scene
from posegaussian.stages.simulator.scene import Scene
from posegaussian.stages.simulator.setup import stage
from posegaussian.storage.exporters.images_layout import write_capture

ANGLES = (5, 10, 20, 30)
"""Degrees from the source camera to each held-out one."""
SECOND = 40
"""Degrees to the second source camera."""
STEP = 5
REPORTING = tuple(range(9000, 9004))
KINDS = ("flat", "relief", "guessed", "given", "noise", "coarse", "scaled", "second")


def film(seed: int, size: int, folder: Path) -> tuple[np.ndarray, float]:
    """Film the scene into `folder`; true depth [h, w] of the source camera, m, and the distance that gives its
    relief the same median."""
    base = benchmark_scene(seed, 1, size, 1).model_dump(exclude_unset=True)
    rig = {**base["rig"], "kind": "arc", "cameras": SECOND // STEP + 1, "span": float(SECOND)}
    staged = stage(Scene.model_validate({**base, "rig": rig, "held_out": 0}))
    views = [0, *(a // STEP for a in ANGLES), SECOND // STEP]
    shots = [staged.take.shoot(0, v) for v in views]
    color, mask, depth = (np.stack([getattr(s, k) for s in shots])[None] for k in ("color", "mask", "depth"))
    joints = np.stack([s.joints2d for s in shots if s.joints2d is not None])[None]
    write_capture(folder / "capture", staged.written.subset(views), color, mask, joints)
    truth, (shape, _) = depth[0, 0], relief(mask[0, 0], 1.0, float(staged.written.intrinsics[0, 0, 0]))
    seen = (truth > 0) & (shape > 0)
    return truth, float(np.median(truth[seen]) / np.median(shape[seen]))


def depth_maps(kind: str, truth: np.ndarray, distance: float, seed: int) -> np.ndarray:
    """[h, w] float32 m what a user might have in the place of true depth."""
    random = np.random.default_rng(seed)
    if kind == "flat":
        return np.where(truth > 0, np.median(truth[truth > 0]), 0).astype(np.float32)
    if kind == "noise":
        smooth = cv2.GaussianBlur(random.normal(size=truth.shape), (0, 0), 16)
        error = 0.01 * (np.sqrt(8 / 9) * smooth / smooth.std() + random.normal(size=truth.shape) / 3)
        return (truth * (1 + error)).astype(np.float32)
    if kind == "coarse":
        return (np.rint(truth[2::4, 2::4] * 1000) / 1000).astype(np.float32)
    return (truth * (1.1 if kind == "scaled" else 1.0)).astype(np.float32)


def measured(
    kind: str, folder: Path, truth: np.ndarray, distance: float, seed: int
) -> tuple[dict[int, float], np.ndarray]:
    """Box PSNR by angle, and the pictures [angles, h, w, 3]."""
    capture, maps = folder / "capture", folder / "capture" / "depth_maps" / "cam00"
    for old in maps.glob("*"):
        old.unlink()
    if kind in ("flat", "given", "noise", "coarse", "scaled"):
        from posegaussian.storage.readers.images import write_exr

        maps.mkdir(parents=True, exist_ok=True)
        write_exr(maps / "000000.exr", depth_maps(kind, truth, distance, seed))
    names = [f"cam{a // STEP:02d}" for a in ANGLES]
    sources = ["cam00", f"cam{SECOND // STEP:02d}"] if kind == "second" else ["cam00"]
    known = [] if kind == "guessed" else [f"depth.subject_distance={distance}"]
    results, _ = run_capture(
        folder, (f"views.sources=[{', '.join(sources)}]", f"views.held_out=[{', '.join(names)}]", *known)
    )
    assert capture.is_dir()
    return _pictures(results)


def _pictures(results: Results) -> tuple[dict[int, float], np.ndarray]:
    (path,) = results.context.paths.values()
    color, found = results.read(f"rendering/{path.name}/color", range(1)), {}
    for c, (name, angle) in enumerate(zip(path.names, ANGLES, strict=True)):
        view = results.context.rig.index(name)
        truth, mask = (results.read(a, range(1), view)[0] for a in ("frames/color", "frames/mask"))
        found[angle] = float(measure(color[0, c], truth, mask, MetricsParams(measures=["psnr"]))["box", "psnr"])  # type: ignore[arg-type]
    return found, color[0]


def table(chosen: Sequence[int], size: int, picture: Path | None, kinds: Sequence[str] = KINDS) -> list[dict[str, Any]]:
    """One row a kind of depth: mean box PSNR by angle."""
    found: dict[str, list[dict[int, float]]] = {k: [] for k in kinds}
    shown: list[np.ndarray] = []
    for n, seed in enumerate(chosen):
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            truth, distance = film(seed, size, folder)
            for kind in kinds:
                values, pictures = measured(kind, folder, truth, distance, seed)
                found[kind].append(values)
                print(
                    f"seed {seed}, {kind}: " + ", ".join(f"{a} degrees {v:.2f} dB" for a, v in values.items()),
                    flush=True,
                )
                if n == 0 and kind in ("flat", "relief", "noise", "second"):
                    shown.append(np.concatenate(list(pictures[:, :, size // 6 : -size // 6]), axis=1))
    if picture is not None:
        from posegaussian.storage.readers.images import write_png

        write_png(picture, np.concatenate(shown))
    return [
        {"depth": k, **{f"{a} degrees": float(np.mean([r[a] for r in rows])) for a in ANGLES}}
        for k, rows in found.items()
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=seeds, default=REPORTING)
    parser.add_argument("--size", type=int, default=384)
    parser.add_argument(
        "--picture", type=Path, help="PNG of the first seed: flat, relief, noise and second, by row; angles by column"
    )
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=KINDS)
    a = parser.parse_args()
    limit(1)
    writes = tuple(a.seeds) == REPORTING and tuple(a.kinds) == KINDS
    rows = table(a.seeds, a.size, a.picture or (Path("docs/measurements/monocular.png") if writes else None), a.kinds)
    publish("monocular" if writes else None, rows, {"seeds": list(a.seeds), "size": a.size})


if __name__ == "__main__":
    main()
