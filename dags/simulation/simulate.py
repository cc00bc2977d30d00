"""`posegaussian simulate`: a scene file becomes a capture on disk,
registered like any other, with its truth beside it."""

from __future__ import annotations

import dataclasses
import os
import shutil
import time
from collections.abc import Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import ValidationError
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from posegaussian.dags.config.faults import dotted, faults_of, unknown_key
from posegaussian.dags.config.yaml_source import Document, Location, load
from posegaussian.dags.humanize.text import next_command
from posegaussian.dags.importing.register import find_capture, register
from posegaussian.dags.importing.replace import filmed_into, make_room
from posegaussian.dags.session.session import Session
from posegaussian.stages.simulator.scene import Listed, Scan, Scene, faults, known_fields
from posegaussian.storage.archive.store import Archive, SequenceGroup
from posegaussian.storage.files.names import refuse_links
from posegaussian.storage.files.write import make_folder, scratch_array
from posegaussian.storage.model.cameras import INTRINSICS_AXES, POSE_AXES
from posegaussian.storage.model.documents import read_bytes, shortened
from posegaussian.storage.model.errors import ConfigError, SourceError
from posegaussian.storage.model.joint_sets import COCO17

if TYPE_CHECKING:
    from posegaussian.stages.simulator.effects.base import Ruling
    from posegaussian.stages.simulator.setup import Staged
    from posegaussian.stages.simulator.take import Shot

SHOTS_AT_ONCE = 32
"""Pictures of one camera held in memory."""


def read_scene(path: Path) -> Scene:
    """A scene file. Raises ConfigError with `file:line:column key: what is wrong` for every fault."""
    document = load(path)
    try:
        scene = Scene.model_validate(document.values)
    except ValidationError as error:
        wrong: Iterable[tuple[Location, str]] = faults_of(error, document.values, lambda at: _unknown(document, at))
    else:
        wrong = faults(scene)
    told = [f"{document.where(at)} {dotted(at) or 'the file'}: {what}" for at, what in wrong]
    if told:
        raise ConfigError("\n".join(dict.fromkeys(told)))
    return scene


def _unknown(document: Document, location: Location) -> str:
    """The sentence about a key that a scene has not."""
    rig = document.values.get("rig")
    known = known_fields(location[:-1], rig.get("kind") if isinstance(rig, Mapping) else None)
    is_effect = location[:1] == ("effects",) and len(location) == 2
    return unknown_key(str(location[-1]), known, thing="unknown effect" if is_effect else "unknown key")


def load_scan(scan: Scan, folder: Path) -> Any:
    """The scan of a scene as an actor; its texture is the one its material names. Raises SourceError."""
    from posegaussian.stages.simulator.scans import parse_obj, scan_mesh, texture_name
    from posegaussian.stages.simulator.wardrobe.actors import Still
    from posegaussian.storage.readers.images import read_picture

    path = folder / scan.obj
    try:
        vertices, tris, uv, material = parse_obj(_text(path))
        named = texture_name(_text(_beside(path, material))) if material else None
    except ValueError as e:
        raise SourceError(f"{path}: {e}") from e
    picture = read_picture(_beside(path, named)) if named else None
    return Still(scan_mesh(vertices, tris, uv, picture, scan), scan.turn)


def _beside(scan: Path, name: str) -> Path:
    """A file that a scan names, in its folder or below. Raises SourceError for one elsewhere: scans are other
    people's."""
    inside = os.path.normpath(name)
    if os.path.isabs(inside) or inside.split(os.sep)[0] == os.pardir:
        raise SourceError(f"{scan}: it names {shortened(name)}, outside its folder; copy that file beside the scan")
    return scan.parent / inside


def _text(path: Path) -> str:
    """Text of a scanner's file, whatever its names are encoded in."""
    return read_bytes(path, "scan").decode("utf-8", "replace")


def simulate(
    session: Session,
    scene_path: Path,
    name: str,
    console: Console,
    output: Path | None = None,
    threads: int | None = None,
    replace: bool = False,
) -> SequenceGroup:
    """Film a scene, write it, register it as a sequence; prints the plan of effects and what they took.

    Raises ConfigError for a scene that is wrong, SourceError for a scan that cannot be read, CalibrationError for
    cameras that cannot be, NotWritten where the disk is full, and ArchiveError where the name is that of a capture from
    elsewhere, unless that is to be replaced.
    """
    made = film_scene(
        session,
        read_scene(scene_path),
        scene_path.parent,
        name,
        f"scene {scene_path.name}",
        console,
        output,
        threads,
        replace,
    )
    console.print(
        next_command("run", "--archive", session.archive_url, "--sequence", name), markup=False, soft_wrap=True
    )
    return made


def film_scene(
    session: Session,
    scene: Scene,
    beside: Path,
    name: str,
    origin: str,
    console: Console,
    output: Path | None = None,
    threads: int | None = None,
    replace: bool = False,
    data_set: str = "",
) -> SequenceGroup:
    """As `simulate`, of a scene whose paths are relative to the folder `beside` and which comes from `origin`;
    `data_set` is the published one that its subject is of."""
    archive = Archive.open(session.archive_url, create=True)
    archive.check_sequence_name(name)
    folder = output or archive.place(f"_captures/{name}")
    if output is None:
        refuse_links(folder)
    staged = stage_scene(scene, beside)
    staged.written.check()
    if not replace:  # refused before the work; what is to be replaced stays until the new pictures are there
        make_room(archive, name, filmed_into(folder), origin, replace=False)
    console.print(effects_plan(name, scene, staged.rulings))
    start = time.perf_counter()
    truth = film(scene, staged, folder, threads or os.cpu_count() or 1)
    pictures = int(staged.valid.sum())
    seconds = time.perf_counter() - start
    held_out = list(staged.written.names[staged.sources :])
    found = find_capture("images", folder, [], session.configuration.for_sequence(name))
    capture = dataclasses.replace(found, data_set=data_set)
    made, said = register(archive, name, capture, session.configuration.for_sequence(name), replace=replace)
    put_truth(made, staged, truth)
    for line in (*capture.notes, *said):
        console.print(line, markup=False, soft_wrap=True)
    console.print(
        f"sequence {name}: {pictures} pictures of {staged.sources}"
        f" cameras{f' and {len(held_out)} held out' if held_out else ''} in {seconds:.1f} s,"
        f" {1000 * seconds / pictures:.0f} ms each, in {folder}",
        markup=False,
        soft_wrap=True,
    )
    return made


def stage_scene(scene: Scene, folder: Path) -> Staged:
    """A scene ready to be filmed; paths in it are relative to `folder`."""
    from posegaussian.stages.simulator.setup import stage

    return stage(scene, load_scan(scene.subject, folder) if isinstance(scene.subject, Scan) else None)


def effects_plan(name: str, scene: Scene, rulings: tuple[Ruling, ...]) -> Table:
    """Every effect: what was measured, on or off, why, and what it costs a picture of this size."""
    table = Table(title=f"{escape(name)}: effects of the scene", title_justify="left")
    for column, justify, fold in (
        ("effect", "left", False),
        ("state", "left", False),
        ("why", "left", True),
        ("ms a picture", "right", False),
    ):
        table.add_column(column, justify=justify, overflow="fold", no_wrap=not fold)  # type: ignore[arg-type]
    area = 1.0 if isinstance(scene.rig, Listed) else scene.rig.size[0] * scene.rig.size[1] / 512**2
    for r in rulings:
        e, d = r.effect.effect, r.decision
        switched = "" if r.params is None else " (auto)" if r.params.switch == "auto" else " (forced)"
        why = (
            d.reason if d.measured is None else f"{d.reason} ({e.measure} {d.measured:.3g}, bound {d.bound:g} {e.unit})"
        )
        table.add_row(
            e.name,
            f"{'on' if d.on else 'off'}{switched}",
            escape(why),
            f"{'spends' if d.on else 'saves'} {r.effect.milliseconds * area:.3g}",
        )
    return table


def film(scene: Scene, staged: Staged, folder: Path, threads: int) -> dict[str, np.ndarray]:
    """Shoot every picture and write the capture; returns the truth that goes into the archive.

    Pictures do not depend on each other, so neither order nor threads change a byte. Memory holds the joints and
    SHOTS_AT_ONCE pictures; the truth's pictures are kept in files without a name in `folder` until nobody needs them. A
    folder that was not there before goes again where filming does not come to its end. Raises NotWritten.
    """
    new = not folder.exists()
    try:
        return _film(scene, staged, folder, threads)
    except BaseException:
        if new:  # half a capture would be taken for a whole one
            shutil.rmtree(folder, ignore_errors=True)
        raise


def _film(scene: Scene, staged: Staged, folder: Path, threads: int) -> dict[str, np.ndarray]:
    from posegaussian.storage.exporters.images_layout import write_capture

    take, rig = staged.take, staged.written
    take.prepare()
    make_folder(folder)
    truth = _room(scene.frames, staged, folder)
    with ThreadPoolExecutor(max(1, threads)) as pool:
        for v in range(len(rig)):
            numbers = np.nonzero(staged.valid[:, v])[0]
            found: list[np.ndarray] = []
            for part in np.split(numbers, range(SHOTS_AT_ONCE, len(numbers), SHOTS_AT_ONCE)):
                shots: list[Shot] = list(pool.map(lambda f, v=v: take.shoot(int(f), v), part))
                _keep(truth, shots, v, staged.sources)
                found += [s.joints2d for s in shots if s.joints2d is not None]
                color, mask, depth = (
                    np.stack([getattr(s, k) for s in shots])[:, None] for k in ("color", "mask", "depth")
                )
                write_capture(folder, rig.subset([v]), color, mask, None, depth, scene.frame_rate, part)
            if found:
                write_capture(
                    folder,
                    rig.subset([v]),
                    None,
                    joints2d=np.stack(found)[:, None],
                    frame_rate=scene.frame_rate,
                    numbers=numbers,
                )
    write_capture(folder, rig, None, frame_rate=scene.frame_rate, held_out=rig.names[staged.sources :])
    return truth


def _room(frames: int, staged: Staged, folder: Path) -> dict[str, np.ndarray]:
    """{array of the truth: zeros of its size}, the large ones in files."""
    size = tuple(int(s) for s in staged.written.size.max(axis=0)[::-1])
    views, held_out, joints = len(staged.written), len(staged.written) - staged.sources, len(COCO17)

    def pictures(cameras: int, dtype: type, *more: int) -> np.ndarray:
        return scratch_array(folder, dtype, (frames, cameras, *size, *more))

    out = {"normal": pictures(views, np.float16, 3), "mask": pictures(views, np.uint8)}
    if held_out:
        out |= {
            "held_out/color": pictures(held_out, np.uint8, 3),
            "held_out/depth": pictures(held_out, np.float32),
            "held_out/mask": pictures(held_out, np.uint8),
        }
    return out | {
        "joints2d": np.zeros((frames, views, joints, 3), np.float32),
        "joints3d": np.zeros((frames, joints, 4), np.float32),
    }


def _keep(truth: dict[str, np.ndarray], shots: list[Shot], view: int, sources: int) -> None:
    for s in shots:
        h, w = s.true_mask.shape
        if view >= sources:
            for k, value in (("color", s.color), ("depth", s.depth), ("mask", s.true_mask)):
                truth[f"held_out/{k}"][s.frame, view - sources, :h, :w] = value
        truth["normal"][s.frame, view, :h, :w] = s.normal
        truth["mask"][s.frame, view, :h, :w] = s.true_mask
        if s.true_joints2d is not None and s.joints3d is not None:
            truth["joints2d"][s.frame, view] = s.true_joints2d
            truth["joints3d"][s.frame, :, :3], truth["joints3d"][s.frame, :, 3] = s.joints3d, 1.0


_TRUTH: tuple[tuple[str, tuple[str, ...], str, str], ...] = (
    (
        "normal",
        ("filmed_frame", "view", "filmed_y", "filmed_x", "xyz"),
        "1",
        "Unit normal of what is seen, camera axes, facing the camera; 0 = no surface.",
    ),
    ("mask", ("filmed_frame", "view", "filmed_y", "filmed_x"), "1", "0..255 covered share of the pixel."),
    (
        "joints2d",
        ("filmed_frame", "view", "joint", "uvs"),
        "px",
        "Exact COCO-17 in the pictures as filmed; 1 where the joint's own limb is seen there.",
    ),
    ("joints3d", ("filmed_frame", "joint", "xyzs"), "m", "Exact COCO-17 in the world."),
    (
        "held_out/color",
        ("filmed_frame", "camera", "filmed_y", "filmed_x", "rgb"),
        "1",
        "SRGB; on black, or before the scene's background.",
    ),
    (
        "held_out/depth",
        ("filmed_frame", "camera", "filmed_y", "filmed_x"),
        "m",
        "Along the optical axis at the pixel centre; 0 = no surface.",
    ),
    ("held_out/mask", ("filmed_frame", "camera", "filmed_y", "filmed_x"), "1", "0..255 covered share of the pixel."),
)


def put_truth(sequence: SequenceGroup, staged: Staged, truth: Mapping[str, np.ndarray]) -> None:
    """Write `truth/*` of all views as filmed, and `truth/held_out/*`;
    depth of the views comes with the capture itself."""
    for name, dims, unit, meaning in _TRUTH:
        if name in truth and (not name.startswith("joints") or truth["joints3d"].any()):
            chunk = (1, 1, *truth[name].shape[2:]) if "filmed_x" in dims else truth[name].shape
            sequence.put(f"truth/{name}", truth[name], dims, unit, meaning, chunk)
    sequence.put_rig("truth", staged.take.rig)
    if staged.sources < len(staged.written):
        held_out = staged.take.rig.subset(range(staged.sources, len(staged.written)))
        sequence.put(
            "truth/held_out/intrinsics", held_out.intrinsics, ("camera", *INTRINSICS_AXES), "px", "Our pixel centres."
        )
        sequence.put(
            "truth/held_out/world_to_camera",
            held_out.world_to_camera,
            ("camera", *POSE_AXES),
            "m",
            "Rigid motion, OpenCV axes.",
        )
