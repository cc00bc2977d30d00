"""What this machine can do for a run, and the command that mends what it lacks."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from posegaussian.dags.assets import lpips
from posegaussian.dags.humanize.text import gigabytes, number
from posegaussian.dags.planning.resources import machine_memory, visible_gpus
from posegaussian.stages.estimators.blazepose_files import FETCH, blazepose_folder, check_files, model_files
from posegaussian.storage.archive.store import local_path
from posegaussian.storage.model.errors import SourceError

LITTLE_MEMORY = 4 * 10**9
"""Bytes below which large pictures do not fit."""
LITTLE_DISK = 10 * 10**9
"""Bytes free below which some minutes of video do not fit."""
NO_DISK = 100 * 10**6
"""Bytes free below which no sequence fits."""
DECODERS = ("h264", "hevc", "av1", "vp9")
"""Codecs that cameras and their programs write."""
ENCODER = "libx264"
"""What `export --video` writes with."""


class State(StrEnum):
    """What a check came to."""

    GOOD = "good"
    """There."""
    LACKS = "lacks"
    """A run is possible without it."""
    STOPS = "stops"
    """No run is possible."""


@dataclass(frozen=True)
class Check:
    """One thing a run uses."""

    name: str
    """Of one or two words."""
    state: State
    """What it came to."""
    found: str
    """What there is, with its value."""
    mend: str = ""
    """The command or the step that mends it; empty where nothing has to be mended."""

    def to_json(self) -> dict[str, Any]:
        """Plain JSON types."""
        return asdict(self)


def examined(archive_url: str, metrics: Any) -> list[Check]:
    """Every check, in the order in which they are told; `metrics` are the settings that name LPIPS' files."""
    looks: Mapping[str, Callable[[], Check]] = {
        "cores": _cores,
        "memory": _memory,
        "torch": _torch,
        "GPU": _gpu,
        "people": _people,
        "LPIPS": lambda: _lpips(metrics),
        "video in": _video_in,
        "video out": _video_out,
        "disk": lambda: _disk(archive_url),
        "kernels": _kernels,
    }
    return [_tried(name, look) for name, look in looks.items()]


def _tried(name: str, look: Callable[[], Check]) -> Check:
    """A look; a library that cannot be loaded is what it finds, whatever that library raises."""
    try:
        return look()
    except Exception as e:
        return Check(
            name,
            State.STOPS,
            f"{type(e).__name__}: {e}",
            "install PoseGaussian anew: `pip install --force-reinstall .`",
        )


def possible(checks: Sequence[Check]) -> bool:
    """Whether a run is possible."""
    return all(c.state is not State.STOPS for c in checks)


def sentences(checks: Sequence[Check]) -> list[str]:
    """A line a check, the step that mends it below, and what it comes to."""
    width = max(len(c.name) for c in checks)
    lines = []
    for c in checks:
        lines.append(f"{c.state.value:5}  {c.name:{width}}  {c.found}")
        lines += [f"{'':7}{'':{width}}  to mend: {c.mend}"] * bool(c.mend)
    lacking, stopping = (sum(c.state is s for c in checks) for s in (State.LACKS, State.STOPS))
    if stopping:
        return [*lines, f"no run is possible: {number(stopping, 'thing')} to mend first"]
    rest = f"; {number(lacking, 'thing')} could be better" if lacking else ""
    return [*lines, f"a run is possible{rest}", "next: posegaussian import auto FOLDER, or posegaussian demo"]


def _cores() -> Check:
    affinity = getattr(os, "sched_getaffinity", None)
    usable = len(affinity(0)) if affinity else os.cpu_count() or 1
    return Check("cores", State.GOOD, number(usable, "core"))


def _memory() -> Check:
    there = machine_memory()
    found = f"{gigabytes(there)} for all workers together"
    if there >= LITTLE_MEMORY:
        return Check("memory", State.GOOD, found)
    return Check(
        "memory",
        State.LACKS,
        f"{found}, less than {gigabytes(LITTLE_MEMORY)}",
        "--set run.workers=1 --set frames.size=512",
    )


def _torch() -> Check:
    import torch

    return Check("torch", State.GOOD, f"{torch.__version__}, {number(torch.get_num_threads(), 'thread')}")


def _gpu() -> Check:
    import torch

    devices = visible_gpus()
    if not devices:
        return Check("GPU", State.GOOD, "none; everything runs on the CPU")
    if not torch.cuda.is_available():
        mend = "install the torch that pytorch.org gives for your CUDA version, then `pip install '.[gpu]'`"
        return Check(
            "GPU", State.LACKS, f"{number(len(devices), 'device')}, which torch {torch.__version__} cannot use", mend
        )
    if find_spec("triton") is None:
        return Check("GPU", State.LACKS, "triton is missing, which draws on it", "pip install '.[gpu]'")
    return Check("GPU", State.GOOD, ", ".join(torch.cuda.get_device_name(i) for i in range(torch.cuda.device_count())))


def _people() -> Check:
    files = model_files()
    if files is None:
        found = f"BlazePose is not in {blazepose_folder()}: only captures with joints and masks of their own"
        return Check("people", State.LACKS, found, FETCH)
    try:
        check_files(files)
    except SourceError as e:
        return Check("people", State.LACKS, str(e), FETCH)
    return Check("people", State.GOOD, f"BlazePose in {blazepose_folder()}")


def _lpips(metrics: Any) -> Check:
    given = metrics.lpips_weights
    absent = [f"{name} ({path})" for name, path in given.items() if not Path(path).is_file()]
    if absent:
        mend = "put them there, or name others by metrics.lpips_weights"
        return Check("LPIPS", State.LACKS, f"files of metrics.lpips_weights are missing: {', '.join(absent)}", mend)
    if given:
        return Check("LPIPS", State.GOOD, f"weights of {', '.join(given)}")
    wanted = any(m.startswith("lpips") for m in metrics.measures)
    state = State.LACKS if wanted else State.GOOD
    if fetched := lpips.there():
        mend = "metrics.lpips_weights, see docs/reference/metrics.md; `posegaussian evaluate` finds them by itself"
        return Check("LPIPS", state, f"weights of {', '.join(fetched)} in {lpips.folder()}", mend if wanted else "")
    return Check(
        "LPIPS",
        state,
        f"no weights; nothing else needs them; `{lpips.FETCH}` brings them",
        lpips.FETCH if wanted else "",
    )


def _video_in() -> Check:
    absent = [c for c in DECODERS if not _codec(c, "r")]
    if not absent:
        return Check("video in", State.GOOD, ", ".join(DECODERS))
    return Check("video in", State.LACKS, f"no decoder for {', '.join(absent)}", "pip install --upgrade av")


def _video_out() -> Check:
    if _codec(ENCODER, "w"):
        return Check("video out", State.GOOD, "H.264")
    return Check("video out", State.LACKS, f"no {ENCODER}: `export --video` cannot write", "pip install --upgrade av")


def _codec(name: str, mode: str) -> bool:
    from av.codec import Codec
    from av.codec.codec import UnknownCodecError

    try:
        Codec(name, mode)  # type: ignore[arg-type]
    except UnknownCodecError:
        return False
    return True


def _disk(archive_url: str) -> Check:
    place = local_path(archive_url).resolve()
    folder = next(p for p in (place, *place.parents) if p.exists())
    elsewhere = "--archive FOLDER, or `archive` in pipeline.yaml, on another disk"
    if not folder.is_dir() or not os.access(folder, os.W_OK):
        return Check("disk", State.STOPS, f"archive {place}: {folder} cannot be written to", elsewhere)
    free = shutil.disk_usage(folder).free
    found = f"{gigabytes(free)} free for archive {place}"
    if free < NO_DISK:
        return Check("disk", State.STOPS, f"{found}, less than {gigabytes(NO_DISK)}", f"free some, or {elsewhere}")
    if free < LITTLE_DISK:
        return Check("disk", State.LACKS, f"{found}, less than {gigabytes(LITTLE_DISK)}", "--set run.keep=as_declared")
    return Check("disk", State.GOOD, found)


def _kernels() -> Check:
    """Where compiled kernels are kept, asked of the renderer's: the library chooses the folder as it is loaded."""
    from posegaussian.stages.splatting.cpu.backend import CACHE

    folder = next(p for p in (CACHE, *CACHE.parents) if p.exists())
    if os.access(folder, os.W_OK):
        return Check("kernels", State.GOOD, f"compiled once, kept in {CACHE}")
    mend = "NUMBA_CACHE_DIR=FOLDER, of one that you may write to"
    return Check("kernels", State.LACKS, f"{CACHE} cannot be written to: every process compiles again", mend)
