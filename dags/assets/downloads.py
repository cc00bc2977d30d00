"""Other people's models: fetched by one explicit step or added from files, checked by their sha256, kept in the user's
cache folder.

BlazePose's three files come out of the official mediapipe 0.10.21 wheel, which is never installed: it needs numpy < 2.
One wheel is pinned, whatever the platform, as all of them hold the same files.
"""

from __future__ import annotations

import zipfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from posegaussian.dags.assets import lpips
from posegaussian.dags.assets.wheels import LARGEST, Wheel, download, megabytes, member, sha256
from posegaussian.stages.estimators.blazepose_files import BLAZEPOSE, FETCH, ModelFile, blazepose_folder
from posegaussian.stages.estimators.description import Description, read_description
from posegaussian.stages.network.card import shipped
from posegaussian.storage.files.write import write_atomically
from posegaussian.storage.model.documents import read_bytes, reader_of
from posegaussian.storage.model.errors import NotWritten, SourceError

MEDIAPIPE = Wheel(
    requirement="mediapipe==0.10.21",
    platform="manylinux_2_28_x86_64",
    python="311",
    file="mediapipe-0.10.21-cp311-cp311-manylinux_2_28_x86_64.whl",
    sha256="05dc4a9e593655a79558d05d6227d31018c2537a4bd3362b51e230cf22aecfe3",
    licence="Apache-2.0",
)
KNOWN = ("blazepose", "lpips")
"""Models that can be fetched."""


def listing() -> list[str]:
    """Sentences: which of BlazePose's and LPIPS' files are there, their sizes,
    what is missing or spoilt and the command that mends it."""
    folder = blazepose_folder()
    states = [_state(folder / m.name, m) for m in BLAZEPOSE]
    lines = [f"blazepose (pose and person segmentation, licence {MEDIAPIPE.licence}) in {folder}"]
    lines += [f"  {m.name:28} {megabytes(m.size)}  {state}" for m, state in zip(BLAZEPOSE, states, strict=True)]
    if set(states) != {"there"}:
        lines.append(
            f"  bring it with `{FETCH}`, or `posegaussian models add FILE`"
            f" with {MEDIAPIPE.file} where there is no network"
        )
    lines += lpips.listing()
    lines += [
        f"{name} (the network's weights, {megabytes(f.stat().st_size)}, ships): --set network.weights={name}; what"
        f" they were trained on and measured at: {f.with_suffix('.md')}"
        for name, f in shipped().items()
    ]
    lines.append(
        "onnx: any heatmap or SimCC model of your own, by detection.model=DESCRIPTION.yaml; check one with"
        " `posegaussian models add DESCRIPTION.yaml`"
    )
    return lines


def fetch(name: str) -> list[str]:
    """Bring a model's files from the package index that pip is configured for; returns sentences about what was done.

    Raises SourceError for an unknown name, without pip or network, for a wrong sha256 or a folder that cannot be
    written.
    """
    if name not in KNOWN:
        raise SourceError(
            f"no model named {name!r} can be fetched;"
            f" known are {', '.join(KNOWN)}, and `posegaussian models add` takes files"
        )
    if name == "lpips":
        return lpips.fetch()
    folder = blazepose_folder()
    if all(_state(folder / m.name, m) == "there" for m in BLAZEPOSE):
        return [f"blazepose is in {folder} already, every sha256 is right; nothing was fetched"]
    with TemporaryDirectory(prefix="posegaussian-models-") as work:
        wheel = download(MEDIAPIPE, Path(work))
        return [
            (
                f"fetched {wheel.name} ({megabytes(wheel.stat().st_size)}) with pip, sha256 {MEDIAPIPE.sha256}; it is"
                " not installed, and goes again"
            ),
            *_from_wheel(wheel),
        ]


def add(files: Sequence[Path]) -> list[str]:
    """Take models from files the user has: the mediapipe or lpips wheel, single .tflite and .pth files, or descriptions
    of ONNX models (.yaml), which are checked: their network
    is opened and looks at a picture once.

    Returns sentences about what was done; raises SourceError for a file that is missing or is not what was published,
    and ConfigError for a description, or a network that does not fit it.
    """
    said: list[str] = []
    for file in files:
        if not file.is_file():
            raise SourceError(
                f"no file {file}; give a mediapipe wheel, a .tflite file of BlazePose, a .pth file of LPIPS, or the"
                " description (.yaml) of an ONNX model"
            )
        if file.suffix == ".whl":
            said += lpips.from_wheel(file) if file.name.startswith("lpips-") else _from_wheel(file)
        elif file.suffix == ".pth":
            said += lpips.add(file)
        elif file.suffix == ".tflite":
            content = read_bytes(file, "model", LARGEST)
            said += _put({_which(file, content): content}, str(file))
        elif file.suffix in (".yaml", ".yml"):
            d = read_description(file)
            _try(d)
            said.append(
                f"{file} is good: {d.kind} model {d.path}, joints {d.joint_set}; use it with --set"
                f" detection.estimator=onnx --set detection.model={file.resolve()}"
            )
        else:
            raise SourceError(
                f"{file}: models come as .whl, .tflite or .pth, or as the description (.yaml) of an ONNX model"
            )
    return said


def _try(described: Description) -> None:
    """Let a network look at a grey picture once. Raises ConfigError where it is none or answers otherwise than is
    described."""
    from posegaussian.stages.estimators.onnx import OnnxEstimator

    width, height = described.input
    OnnxEstimator(described).find(np.full((height, width, 3), 128, np.uint8), 1)


def _from_wheel(wheel: Path) -> list[str]:
    """Take the model files out of a wheel;
    each is checked by itself, so any platform's wheel of that version will do."""
    try:
        with reader_of(wheel, "wheel"), zipfile.ZipFile(wheel) as z:
            contents = {m: member(z, m.member) for m in BLAZEPOSE}
    except (zipfile.BadZipFile, SourceError) as e:
        raise SourceError(
            f"{wheel} does not hold BlazePose's models ({e}); {MEDIAPIPE.file} does, later versions of mediapipe do not"
        ) from e
    return _put(contents, wheel.name)


def _which(file: Path, content: bytes) -> ModelFile:
    """The model file that a .tflite file is, told by its content, so that its name does not matter."""
    found = sha256(content)
    for m in BLAZEPOSE:
        if m.sha256 == found:
            return m
    raise SourceError(
        f"{file} has sha256 {found}, which is none of BlazePose's files ({', '.join(m.name for m in BLAZEPOSE)} of"
        f" mediapipe 0.10.21); take them from {MEDIAPIPE.file}"
    )


def _put(contents: dict[ModelFile, bytes], source: str) -> list[str]:
    """Write checked files into the cache folder, each whole or not at all."""
    for m, content in contents.items():
        if (found := sha256(content)) != m.sha256:
            raise SourceError(
                f"{source}: {m.name} has sha256 {found}, the published one has {m.sha256}; nothing was kept. Take it"
                f" from {MEDIAPIPE.file}"
            )
    folder = blazepose_folder()
    try:
        for m, content in contents.items():
            write_atomically(folder / m.name, content)
    except NotWritten as e:
        raise SourceError(f"{e}; XDG_CACHE_HOME chooses another place for models") from e
    return [
        *_written(contents, folder),
        f"licence {MEDIAPIPE.licence}: https://github.com/google-ai-edge/mediapipe/blob/master/LICENSE",
    ]


def _written(models: Iterable[ModelFile], folder: Path) -> list[str]:
    return [f"wrote {folder / m.name} ({megabytes(m.size)}, sha256 {m.sha256})" for m in models]


def _state(file: Path, model: ModelFile) -> str:
    """`there`, `missing`, or what is wrong with it."""
    if not file.is_file():
        return "missing"
    return "there" if sha256(file.read_bytes()) == model.sha256 else "spoilt: not the published sha256"
