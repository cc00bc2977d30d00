"""Every kind of file that is read from other people:
a whole one, which of its files are spoiled, and what reads them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from posegaussian.dags.config.settings import load_configuration
from posegaussian.dags.importing.register import find_capture, register
from posegaussian.storage.archive.store import Archive
from posegaussian.storage.model.capture import PER_VIEW, Capture
from posegaussian.storage.readers.sources import open_source
from tests.fuzz import captures, models
from tests.storage.importers import test_anipose, test_biocv, test_dynacap, test_opencv_storage, test_vicon

ROOT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class Format:
    """One row of the table."""

    name: str
    make: Callable[[Path], None]
    """Write the whole thing into a folder that does not exist."""
    files: str
    """Glob of the files that are spoiled; empty: names of files and folders are."""
    kind: str
    """How they are spoiled: a key of `tests.fuzz.spoil.STRUCTURE`."""
    use: Callable[[Path, Path], object]
    """Read everything of a folder; whatever is written goes into the second one."""


@cache
def settings() -> Any:
    """The default settings of a sequence."""
    return load_configuration(folder=ROOT / "tests").default


def imported(layout: str, folder: Path, out: Path, **options: Any) -> None:
    """What `import` does, and a look at everything that was imported, as the stages look at it."""
    capture = find_capture(layout, folder, [f"{k}={v}" for k, v in options.items()], settings())
    archive = Archive.open(str(out / "archive"), create=True)
    register(archive, "sequence", capture, settings())
    kept = Archive.open(str(out / "archive")).sequence("sequence").capture
    read_sources(kept)
    look_at_cameras(kept)


def read_sources(capture: Capture) -> None:
    """The first frames of every source of every view."""
    for kind in PER_VIEW:
        if not capture.has(kind):
            continue
        source = open_source(capture, kind)
        for view, stream in enumerate(capture.streams(kind)):
            numbers = list(stream.numbers[:2]) if stream is not None else []
            if kind == "joints":
                for n in numbers:
                    source.read(view, n), source.boxes(view, n)
            else:
                list(source.read(view, numbers))
    if capture.has("joints3d"):
        source = open_source(capture, "joints3d")
        for n in capture.numbers[:2]:
            source.read(int(n))


def look_at_cameras(capture: Capture) -> None:
    """Rectify, walk and carve with the cameras: loops over their numbers must end."""
    from posegaussian.stages.geometry.subject import look_at_point
    from posegaussian.stages.imaging.camera_mapping import frames_rig
    from posegaussian.stages.silhouettes.agreement import agreement
    from posegaussian.stages.silhouettes.hull import Silhouettes, searched_radius, visual_hull

    rig = frames_rig(capture.rig, settings().frames.size)
    w, h = rig.size.max(axis=0)
    mask = np.zeros((h, w), np.uint8)
    mask[h // 4 : -(h // 4) or None, w // 4 : -(w // 4) or None] = 255
    masks = dict.fromkeys(range(len(rig)), mask)
    centre = look_at_point(rig)
    silhouettes = Silhouettes.of(rig, masks, centre, searched_radius(rig, list(masks), centre))
    agreement(rig, masks, silhouettes)
    visual_hull(rig, 0, mask, silhouettes)


def camera_path(folder: Path, out: Path) -> None:
    from posegaussian.stages.camera_paths.path_file import read_path_file

    read_path_file(str(folder / "path.json"), np.arange(3))


def configuration(folder: Path, out: Path) -> None:
    read = load_configuration(folder / "own.yaml", folder=folder)
    read.for_sequence("person")
    read.as_yaml()


def scene(folder: Path, out: Path) -> None:
    from posegaussian.dags.simulation.simulate import read_scene, stage_scene

    stage_scene(read_scene(folder / "own.yaml"), folder).written.check()


def training(folder: Path, out: Path) -> None:
    from posegaussian.dags.training.config import load_training

    load_training(folder / "own.yaml").network()


def a_copy(source: Path) -> Callable[[Path], None]:
    """Makes a folder with a shipped file in it, `own.yaml`."""

    def make(folder: Path) -> None:
        folder.mkdir(parents=True)
        (folder / "own.yaml").write_bytes(source.read_bytes())

    return make


def record(folder: Path, out: Path) -> None:
    """A sequence's own record, which may come from somebody else with the archive."""
    from posegaussian.storage.archive.receipts import scan_receipts

    archive = Archive.open(str(folder / "archive"))
    for name in archive.names():
        found = archive.sequence(name)
        _ = found.capture, found.partition_frames
        list(scan_receipts(found))


def archived(base: Path) -> None:
    """An archive with one imported sequence and its arrays."""
    captures.images(base / "capture")
    register(
        Archive.open(str(base / "archive"), create=True),
        "sequence",
        find_capture("images", base / "capture", [], settings()),
        settings(),
    )


def capture_formats() -> list[Format]:
    """All importers, and each file of theirs."""
    pose2sim, easymocap, images = (
        partial(imported, "pose2sim"),
        partial(imported, "easymocap"),
        partial(imported, "images"),
    )
    colmap, nerfstudio = partial(imported, "colmap"), partial(imported, "nerfstudio")
    gps_gaussian = partial(imported, "gps_gaussian")
    in_mm = partial(imported, "images", depth_scale=0.001)
    return [
        Format("pose2sim: calibration TOML", captures.pose2sim, "calib/*.toml", "toml", pose2sim),
        Format("pose2sim: Qualisys XML", captures.qualisys, "*.qca.txt", "xml", pose2sim),
        Format("pose2sim: OpenPose JSON", captures.pose2sim, "pose/**/*.json", "json", pose2sim),
        Format(
            "pose2sim: TRC",
            captures.pose2sim,
            "pose-3d/*.trc",
            "table",
            partial(imported, "pose2sim", trc="pose-3d/walk.trc"),
        ),
        Format("caliscope: calibration TOML", captures.caliscope, "*.toml", "toml", partial(imported, "caliscope")),
        Format(
            "caliscope: timestamps CSV", captures.caliscope, "timestamps.csv", "table", partial(imported, "caliscope")
        ),
        Format("caliscope: landmarks CSV", captures.caliscope, "POSE/*.csv", "table", partial(imported, "caliscope")),
        Format("easymocap: intri and extri YAML", captures.easymocap, "*.yml", "yaml", easymocap),
        Format("easymocap: annots JSON", captures.easymocap, "annots/**/*.json", "json", easymocap),
        *(
            Format(f"colmap: {form} model", partial(captures.colmap, form), "sparse/0/*", kind, colmap)
            for form, kind in (("text", "table"), ("binary", "binary"))
        ),
        Format("colmap: names", partial(captures.colmap, "text"), "", "binary", colmap),
        Format("nerfstudio: transforms.json", captures.nerfstudio, "*.json", "json", nerfstudio),
        Format("nerfstudio: names", captures.nerfstudio, "", "binary", nerfstudio),
        Format("llff: poses_bounds.npy", captures.llff, "*.npy", "binary", partial(imported, "llff")),
        Format("gps_gaussian: parm", captures.gps_gaussian, "parm/*/*.npy", "binary", gps_gaussian),
        Format("gps_gaussian: depth", captures.gps_gaussian, "depth/*/*.png", "binary", gps_gaussian),
        Format("gps_gaussian: names", captures.gps_gaussian, "", "binary", gps_gaussian),
        Format("zju_mocap: annots.npy", captures.zju_mocap, "annots.npy", "pickle", partial(imported, "zju_mocap")),
        *(
            Format(f"dna_rendering: {f}", captures.dna_rendering, f, "binary", partial(imported, "dna_rendering"))
            for f in ("0012_01.smc", "0012_01_annots.smc")
        ),
        *(
            Format(f"people_snapshot: {f}", captures.people_snapshot, f, kind, partial(imported, "people_snapshot"))
            for f, kind in (("camera.pkl", "pickle"), ("*.hdf5", "binary"))
        ),
        Format("humman: cameras.json", captures.humman, "cameras.json", "json", partial(imported, "humman")),
        Format("actorshq: calibration.csv", captures.actorshq, "*.csv", "table", partial(imported, "actorshq")),
        Format("mvhumannet: JSON", captures.mvhumannet, "*.json", "json", partial(imported, "mvhumannet")),
        Format("mvhumannet: scale", captures.mvhumannet, "*.pkl", "pickle", partial(imported, "mvhumannet")),
        Format("genebody: annots.npy", captures.genebody, "annots.npy", "pickle", partial(imported, "genebody")),
        Format("dynacap: calibration", test_dynacap.write, "*.calibration", "table", partial(imported, "dynacap")),
        Format("panoptic: calibration", captures.panoptic, "*.json", "json", partial(imported, "panoptic")),
        Format("panoptic: joints", captures.panoptic, "hdPose3d*/*.json", "json", partial(imported, "panoptic")),
        *(
            Format(f"videos: {f}", partial(captures.films_and, make), f, kind, partial(imported, "videos"))
            for f, kind, make in (
                ("camchain.yaml", "yaml", captures.test_videos.kalibr),
                ("cameras.xml", "xml", captures.test_videos.metashape),
                ("cameras.csv", "table", captures.test_videos.realitycapture),
                ("calibration.toml", "toml", test_anipose.write),
                ("cam0.mp4.calib", "table", test_biocv.write),
                ("rig.xcp", "xml", test_vicon.distorted),
                ("rig.yml", "yaml", test_opencv_storage.one_file),
                ("rig.json", "json", test_opencv_storage.listed),
            )
        ),
        Format("images: cameras.json", captures.images, "cameras.json", "json", images),
        Format("images: COCO JSON", captures.images, "joints/*.json", "json", images),
        Format("images: names", captures.images, "", "binary", images),
        Format("pose2sim: names", captures.pose2sim, "", "binary", pose2sim),
        Format("masks: PNG", captures.images, "masks/**/*.png", "binary", images),
        Format("depth: EXR", captures.images, "depth*/**/*.exr", "binary", images),
        Format("depth maps: PNG", partial(captures.depth_maps_of, ".png"), "depth_maps/**/*.png", "binary", in_mm),
        Format("depth maps: TIFF", partial(captures.depth_maps_of, ".tif"), "depth_maps/**/*.tif", "binary", in_mm),
        *(
            Format(f"pictures: {s[1:].upper()}", partial(captures.pictures_of, s), f"images/**/*{s}", "binary", images)
            for s in (".png", ".jpg", ".exr", ".tif", ".bmp", ".webp")
        ),
        *(
            Format(f"videos: {s[1:].upper()}", partial(captures.videos_of, s), f"videos/*{s}", "binary", pose2sim)
            for s in (".mp4", ".mov", ".mkv", ".avi", ".webm")
        ),
    ]


def formats() -> list[Format]:
    """Every row."""
    return [
        *capture_formats(),
        Format("camera path JSON", captures.path_file, "*.json", "json", camera_path),
        Format(
            "configuration YAML", a_copy(ROOT / "dags" / "config" / "pipeline.yaml"), "own.yaml", "yaml", configuration
        ),
        Format("scene YAML", a_copy(ROOT / "dags" / "simulation" / "scenes" / "messy.yaml"), "own.yaml", "yaml", scene),
        Format("training YAML", a_copy(ROOT / "dags" / "training" / "training.yaml"), "own.yaml", "yaml", training),
        *(Format(name, make, files, kind, use) for name, make, files, kind, use in models.rows()),
        Format("sequence record JSON", archived, "archive/sequence/zarr.json", "json", record),
    ]
