"""`posegaussian scans`: a folder of textured scans is filmed, one sequence a scan, as the paper's tables on THuman2.0
and Twindom are made: a ring of cameras around each, and held-out ones in the middle between them.

Scans have no common scale: each is brought to one height, as GPS-Gaussian does.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from pydantic import ValidationError
from rich.console import Console

from posegaussian.dags.session.session import Session
from posegaussian.dags.simulation.simulate import film_scene
from posegaussian.stages.simulator.scene import Scene, faults
from posegaussian.storage.archive.store import Archive
from posegaussian.storage.model.errors import ConfigError, SourceError, UserError
from posegaussian.storage.model.splits import SCAN_PARTS

FILL = 0.86
"""Share of the picture's height that a scan fills."""
RADIUS = 2.0
"""Metres from the scan's axis to the cameras, which stand at half its height."""


@dataclass(frozen=True)
class ScanRig:
    """How every scan is filmed."""

    cameras: int
    """Source cameras on the ring."""
    held_out: int
    """Cameras in the middle of gaps, evenly."""
    size: int
    """Side of the pictures, px."""
    height: float
    """Metres that every scan is brought to."""
    up: str
    """Axis of the files that points up."""


def find_scans(folder: Path) -> dict[str, Path]:
    """{name: OBJ file} of a folder with a folder a scan, or with OBJ files, sorted by name.

    Raises SourceError where there is none, and where a scan's folder holds more than one.
    """
    if not folder.is_dir():
        raise SourceError(f"scans: {folder} is no folder; give the one that holds a folder a scan")
    found = {f.stem: f for f in folder.glob("*.obj")}
    for place in sorted(p for p in folder.iterdir() if p.is_dir()):
        files = sorted(place.glob("*.obj"))
        if len(files) > 1:
            raise SourceError(
                f"scans: {place} holds {len(files)} OBJ files, {', '.join(f.name for f in files[:3])}; one a folder is"
                " expected"
            )
        if files:
            found[place.name] = files[0]
    if not found:
        raise SourceError(f"scans: {folder} holds no OBJ file, nor does a folder in it; scans are NAME/NAME.obj")
    return dict(sorted(found.items()))


def body_parameters(folder: Path, scans: Mapping[str, Path]) -> list[str]:
    """A sentence where parameters of a body model lie beside scans, as THuman2.0's do: they are angles, shape and
    scale, and places of joints only together with the model, which is licensed; none is read."""
    beside = [p for root in (folder.resolve().parent, folder) for p in sorted(root.glob("*smpl*"))]
    found = [
        f
        for name, file in scans.items()
        for place in (file.parent, *(p / name for p in beside))
        for f in sorted(place.glob("*smpl*.pkl"))
    ]
    if not found:
        return []
    more = f" and {len(found) - 1} more" if len(found) > 1 else ""
    why = "hold angles and no joints; joints take the licensed model itself and are not made of them"
    instead = "They are estimated in the films instead: posegaussian models fetch blazepose"
    return [f"{found[0]}{more}: parameters of SMPL-X {why}. {instead}"]


def chosen(names: Sequence[str], part: str | None) -> list[str]:
    """Those of the sorted names in `part`, "first:end" as Python counts or the name of a part that papers take, or all.
    Raises SourceError."""
    if part is None:
        return list(names)
    ends = re.fullmatch(r"(-?\d+)?:(-?\d+)?", SCAN_PARTS.get(part, part))
    some = [] if ends is None else list(names)[slice(*(None if e is None else int(e) for e in ends.groups()))]
    if not some:
        named = ", ".join(f"{n} is {p}" for n, p in SCAN_PARTS.items())
        raise SourceError(
            f"scans --part {part}: it is none of the {len(names)} scans; 0:100 are the first 100, and {named}"
        )
    return some


def scene_of(scan: Path, rig: ScanRig) -> Scene:
    """One frame of a scan. Raises ConfigError for cameras that cannot be."""
    around = {"kind": "ring", "cameras": rig.cameras, "radius": RADIUS, "height": rig.height / 2, "fill": FILL}
    try:
        scene = Scene.model_validate(
            {
                "frames": 1,
                "subject": {"obj": str(scan.resolve()), "up": rig.up, "height": rig.height},
                "rig": around | {"size": [rig.size, rig.size]},
                "held_out": rig.held_out,
            }
        )
    except ValidationError as e:
        raise ConfigError("\n".join(f"scans: {'.'.join(map(str, f['loc']))}: {f['msg']}" for f in e.errors())) from e
    if wrong := [f"scans: {what}" for _, what in faults(scene)]:
        raise ConfigError("\n".join(wrong))
    return scene


def film_scans(
    session: Session,
    scans: Mapping[str, Path],
    rig: ScanRig,
    data_set: str,
    console: Console,
    threads: int | None = None,
) -> list[str]:
    """Film every scan that is no sequence of the archive yet, and register it as one of the data set; returns a
    sentence for each that cannot be filmed, which keeps none of the others."""
    failed = []
    for number, (name, file) in enumerate(scans.items(), 1):
        there = name in Archive.open(session.archive_url, create=True).names()
        told = f"scan {number} of {len(scans)}: {name}{', which is there' if there else ''}"
        console.print(told, markup=False, soft_wrap=True)
        if there:
            continue
        try:
            scene, origin = scene_of(file, rig), f"scan {file.name}"
            film_scene(session, scene, file.parent, name, origin, console, None, threads, data_set=data_set)
        except UserError as e:
            failed.append(f"{name}: {e}")
    return failed
