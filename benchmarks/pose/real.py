"""How well people are found in real video without joint files: estimated, triangulated joints of `balance` against its
given 3D joints.

    python -m benchmarks.pose.real [--archive FOLDER]

The capture of POSEGAUSSIAN_CAPTURES is imported without its keypoints; BlazePose must have been fetched. Of 100 frames
x 4 cameras, for the 12 limb joints and the nose: distance in captured px between the given 3D joint as a camera sees it
and `triangulated` (pose/joints3d as that camera sees it) and `raw` (the clearest person of each picture, by itself); an
unknown joint counts as missed and is never within a bound. The yardstick itself is 8 to 11 px off the pictures.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from benchmarks.report import publish
from posegaussian.dags.config.settings import load_configuration
from posegaussian.dags.importing.register import find_capture, register
from posegaussian.dags.planning.results import Results
from posegaussian.dags.planning.selection import Selection
from posegaussian.dags.session.session import Session
from posegaussian.stages.geometry.points import to_frames
from posegaussian.stages.geometry.projection import project
from posegaussian.stages.geometry.triangulation import triangulate
from posegaussian.storage.archive.store import Archive
from posegaussian.storage.formats.joint_files import read_trc
from posegaussian.storage.model.cameras import Rig
from posegaussian.storage.model.joint_sets import joint_set, to_set
from posegaussian.storage.readers.sources import open_source

CROPS = [
    "frames.crop.cam01={scale: 1.00741, offset: [0, -7.06]}",
    "frames.crop.cam02={scale: 1.00741, offset: [0, -7.06]}",
]
COMPARED = [
    joint_set("coco17").names.index(n)
    for n in ("Nose", *(s + part for part in ("Shoulder", "Elbow", "Wrist", "Hip", "Knee", "Ankle") for s in "LR"))
]
TRC = "S00_P00_T01_BalancingTrial_0-100.trc"
CHAIN = ("Head", "Neck", "RHip", "RKnee", "RAnkle", "RHeel")
"""Markers whose distances add up to a person's height, nearly."""
GATES = {"median px": 15.0, "within 5 % of the height": 0.9}
AWAY = 0.5
"""Metres between the joints' middles from which on somebody else was reconstructed."""


def without_keypoints(balance: Path, folder: Path) -> Path:
    """A folder that holds the capture's videos and calibration alone."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in ("videos", "calibration.toml"):
        if not (folder / name).exists():
            (folder / name).symlink_to((balance / name).resolve())
    return folder


def estimated(balance: Path, archive: Path, settings_too: list[str]) -> Results:
    """The capture's results up to pose, made where they are not there."""
    wanted = ["frames.size=960", *CROPS, *settings_too]
    session = Session(load_configuration(None, wanted, folder=archive), str(archive), Console(quiet=True))
    settings = session.configuration.for_sequence("balance")
    if not (archive / "balance").exists():
        register(
            Archive.open(str(archive), create=True),
            "balance",
            find_capture("pose2sim", without_keypoints(balance, archive.parent / "plain"), [], settings),
            settings,
        )
    selection = Selection(only=frozenset({"survey", "detection", "pose"}))
    plans, failed = session.usable(["balance"], (), selection)
    assert not failed, failed
    if session.run_and_report(plans, selection, []):
        raise SystemExit("a task failed; see `posegaussian status --failed`")
    return Results(session.context("balance", ()))


def given_joints(balance: Path, frames: int) -> tuple[np.ndarray, float]:
    """COCO-17 joints [F, 17, 4] as given, world metres, and the person's height in metres."""
    names = joint_set("trc21").names
    markers = read_trc(balance / "keypoints" / "trc" / TRC).joints(names, "yzx")
    found = np.stack([markers[n] for n in range(frames)])
    chain = found[:, [names.index(n) for n in CHAIN], :3]
    height = float(np.median(np.linalg.norm(np.diff(chain, axis=1), axis=-1).sum(axis=1)))
    return to_set(found, "trc21", "coco17"), height


def distances(results: Results, given: np.ndarray, height: float) -> dict[str, np.ndarray]:
    """{triangulated, raw: [F, V, 13] captured px, inf where unknown; limit: [F, V] 5 % of the height as each camera
    sees it}."""
    context = results.context
    calibrated, frames, count = context.capture.rig, range(len(given)), len(given)
    set_id = context.joint_set or ""
    scale = 1.0 / context.captured_to_calibrated[:, 0]
    target, depth = seen(calibrated, given[..., :3])
    own = to_set(results.read("pose/joints3d", frames).astype(np.float64), set_id, "coco17")
    ours, _ = seen(calibrated, own[..., :3])
    off = np.linalg.norm(ours - target, axis=-1) * scale[None, :, None]
    out = {"triangulated": np.where(own[:, None, :, 3] > 0, off, np.inf)}
    raw = np.full_like(off, np.inf)
    for v in range(len(calibrated)):
        first = to_set(results.read("detection/joints2d", frames, v)[:, 0].astype(np.float64), set_id, "coco17")
        placed = first[..., :2] * context.captured_to_calibrated[v, 0] + context.captured_to_calibrated[v, 1:]
        raw[:, v] = np.where(first[..., 2] > 0, np.linalg.norm(placed - target[:, v], axis=-1) * scale[v], np.inf)
    out["raw"] = raw
    known = given[:, None, COMPARED, 3] > 0
    out = {k: np.where(known, d[..., COMPARED], np.nan) for k, d in out.items()}
    out["limit"] = 0.05 * height * calibrated.intrinsics[:, 1, 1] / np.median(depth, axis=-1) * scale
    assert out["limit"].shape == (count, len(calibrated))
    return out


def seen(rig: Rig, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """World points [F, J, 3] -> calibrated px [F, V, J, 2], no lens, and depths [F, V, J]."""
    found = [project(points, k, w) for k, w in zip(rig.intrinsics, rig.world_to_camera, strict=True)]
    return np.stack([p for p, _ in found], axis=1), np.stack([z for _, z in found], axis=1)


def rows_of(results: Results, off: dict[str, np.ndarray]) -> list[dict[str, Any]]:
    """One row a camera and one for all, for triangulated and for raw joints."""
    names, rows = [*results.context.views.names, "all"], []
    for kind in ("raw", "triangulated"):
        for v, name in enumerate(names):
            own = off[kind] if name == "all" else off[kind][:, v : v + 1]
            limit = (off["limit"] if name == "all" else off["limit"][:, v : v + 1])[..., None]
            known = ~np.isnan(own)
            rows.append(
                {
                    "joints": kind,
                    "camera": name,
                    "median px": float(np.median(own[known])),
                    "within 5 % of the height": float((own <= limit)[known].mean()),
                    "unknown": float(np.isinf(own[known]).mean()),
                    "5 % px": float(np.median(limit)),
                }
            )
    return rows


def yardstick(balance: Path, results: Results, given: np.ndarray) -> list[str]:
    """Sentences: how far the given OpenPose joints, triangulated by the same code, lie from the given 3D joints and
    from ours, and what the maker's calibration makes of ours."""
    settings, frames = load_configuration(None, CROPS, folder=balance).for_sequence("balance"), range(len(given))
    capture = find_capture("pose2sim", balance, [], settings)
    rig, reader = capture.rig, open_source(capture, "joints")
    ideal = Rig(rig.names, rig.intrinsics, np.zeros_like(rig.distortion), rig.world_to_camera, rig.size)
    openpose = np.stack(
        [
            triangulate(
                ideal, np.stack([_largest(reader.read(v, n), rig, ideal, v) for v in range(len(rig))]), 0.2, 0.02
            )
            for n in frames
        ]
    )
    openpose = to_set(openpose, reader.joint_set, "coco17")
    ours = to_set(results.read("pose/joints3d", frames).astype(np.float64), results.context.joint_set or "", "coco17")
    maker = find_capture("pose2sim", balance, ["calibration=calibration_qualisys.qca.txt"], settings).rig
    return [
        (
            "the given OpenPose joints, triangulated by the same code: median"
            f" {_apart(openpose, given, ideal, ideal):.1f} px from the given 3D joints, ours"
            f" {_apart(ours, openpose, ideal, ideal):.1f} px from them"
        ),
        (
            "given 3D joints seen through the maker's calibration, ours through the corrected one: median"
            f" {_apart(ours, given, ideal, maker):.1f} px"
        ),
    ]


def _largest(people: np.ndarray, rig: Rig, ideal: Rig, view: int) -> np.ndarray:
    """[J, 3] the person of [P, J, 3] with the highest scores, calibrated px without lens; `balance` has one a file."""
    if not len(people):
        return np.zeros((people.shape[1], 3))
    person = np.asarray(max(people, key=lambda p: p[:, 2].sum()))
    pixels, mapped = to_frames(person[:, :2], np.array([1.0, 0.0, 0.0]), rig, ideal, view)
    return np.concatenate([pixels, np.where(mapped, person[:, 2], 0.0)[:, None]], axis=1)


def _apart(first: np.ndarray, second: np.ndarray, rig: Rig, other: Rig) -> float:
    """Median px between joints [F, 17, 4] seen by the cameras of `rig` and others seen by those of `other`."""
    off = np.linalg.norm(seen(rig, first[..., :3])[0] - seen(other, second[..., :3])[0], axis=-1)[..., COMPARED]
    known = (first[:, None, COMPARED, 3] > 0) & (second[:, None, COMPARED, 3] > 0)
    return float(np.median(off[np.broadcast_to(known, off.shape)]))


def milliseconds(results: Results) -> float:
    """Processor time of detection a picture, from its receipts."""
    folder = results.context.sequence.root
    seconds = [
        r["facts"]["cpu_seconds"]
        for f in folder.rglob("*.json")
        if '"stage": "detection"' in (text := f.read_text()) or '"stage":"detection"' in text
        for r in [json.loads(text)]
    ]
    return 1000 * sum(seconds) / (len(results.context.source_frames) * len(results.context.views.sources))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--archive", type=Path, help="kept and used again; default: made anew")
    parser.add_argument(
        "--set", action="append", default=[], help="a setting of the pipeline, as for `posegaussian run`"
    )
    a = parser.parse_args()
    balance = Path(os.environ.get("POSEGAUSSIAN_CAPTURES", "../shared")) / "captures" / "balance"
    with tempfile.TemporaryDirectory() as scratch:
        results = estimated(balance, (a.archive or Path(scratch) / "archive").resolve(), a.set)
        given, height = given_joints(balance, len(results.context.source_frames))
        off = distances(results, given, height)
        rows = rows_of(results, off)
        publish(None if a.set else "real_pose", rows, {"frames": len(given), "height m": height})
        own = to_set(
            results.read("pose/joints3d", range(len(given))).astype(np.float64),
            results.context.joint_set or "",
            "coco17",
        )
        known = (own[..., 3] > 0) & (given[..., 3] > 0)
        apart = [np.linalg.norm((own[f, k, :3] - given[f, k, :3]).mean(axis=0)) for f, k in enumerate(known) if k.any()]
        print(
            f"somebody else is reconstructed in {sum(d > AWAY for d in apart)} of {len(given)} frames; nobody in"
            f" {len(given) - len(apart)}"
        )
        for sentence in yardstick(balance, results, given):
            print(sentence)
        print(f"detection: {milliseconds(results):.0f} ms of a processor a picture")
    every = rows[-1]
    print(
        "holds  " if every["median px"] <= GATES["median px"] else "FAILS  ",
        f"median {every['median px']:.1f} px of at most {GATES['median px']:g}",
    )
    share = "within 5 % of the height"
    print(
        "holds  " if every[share] >= GATES[share] else "FAILS  ",
        f"{every[share]:.1%} within 5 % of the body's height of at least {GATES[share]:.0%}",
    )


if __name__ == "__main__":
    main()
