"""The YAML that describes a pose network of the user's own: an ONNX file, what it is fed, and how its outputs are read.

```yaml
file: rtmpose-m.onnx              # beside this description, or an absolute path
sha256: 4f0c...                   # optional; checked where it is given
kind: simcc                       # or heatmap
input: [192, 256]                 # width, height in px
channels: rgb                     # or bgr
scale: 1.0                        # fed value = (0..255 x scale - mean) / std
mean: [123.675, 116.28, 103.53]
std: [58.395, 57.12, 57.375]
outputs: [simcc_x, simcc_y]       # or the one name of the heatmaps
joint_set: coco17
```
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from posegaussian.storage.model.documents import regular
from posegaussian.storage.model.errors import ConfigError, SourceError
from posegaussian.storage.model.joint_sets import joint_set
from posegaussian.storage.model.yaml_documents import read_yaml

Side = Annotated[int, Field(ge=8, le=4096)]
Three = tuple[float, float, float]


class Description(BaseModel):
    """A top-down pose network: one crop in, one place a joint out."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    file: str
    """The ONNX file, relative to the description's folder."""
    sha256: str | None = Field(default=None, pattern="^[0-9a-f]{64}$")
    """Hex digest that the file must have."""
    kind: Literal["heatmap", "simcc"]
    """heatmap: one output [J, h, w]; simcc: two, bins along the crop's width [J, w n] and height [J, h n]."""
    input: tuple[Side, Side]
    """Width and height of the crop, px."""
    channels: Literal["rgb", "bgr"] = "rgb"
    """Order of the colours that the network is fed."""
    scale: float = Field(default=1.0, gt=0)
    """Factor on values 0..255, before the mean is taken away."""
    mean: Three = (0.0, 0.0, 0.0)
    """Of each channel in the order of `channels`, after `scale`."""
    std: Three = (1.0, 1.0, 1.0)
    """Divisor of each channel."""
    outputs: tuple[str, ...]
    """Names of the outputs: heatmaps, or the bins along x and along y."""
    values: Literal["probabilities", "logits"] = "probabilities"
    """Whether outputs are positive weights, or logarithms of weights (logits of a sigmoid for heatmaps)."""
    cells: Literal["integer", "centre", "corners"] = "integer"
    """What cell k of n along an input of w px means: pixel k w/n counted from the first pixel's centre (integer),
    the middle of the k-th of n equal parts (centre), or pixel k (w-1)/(n-1) (corners, as with UDP)."""
    joint_set: str
    """Id of the joint set in the network's order."""
    margin: float = Field(default=1.0, gt=0, le=4)
    """Longer side of the crop over the side of the person's region."""
    score_scale: float = Field(default=1.0, gt=0)
    """Factor from a peak's value to a score, which is cut at 1."""
    folder: Path = Field(default=Path(), exclude=True)
    """Where the description lies."""

    @property
    def path(self) -> Path:
        """The ONNX file."""
        return self.folder / self.file

    @field_validator("joint_set")
    @classmethod
    def _known(cls, value: str) -> str:
        try:
            joint_set(value)
        except SourceError as e:
            raise ValueError(str(e)) from e
        return value

    @field_validator("std")
    @classmethod
    def _divisors(cls, value: Three) -> Three:
        if min(abs(v) for v in value) == 0:
            raise ValueError("a std of 0 cannot be divided by; 1 leaves a channel as it is")
        return value

    @model_validator(mode="after")
    def _outputs(self) -> Self:
        wanted = {"heatmap": 1, "simcc": 2}[self.kind]
        if len(self.outputs) != wanted:
            raise ValueError(
                f"a {self.kind} network has {wanted} named output{'s' if wanted > 1 else ''}, {len(self.outputs)}"
                f" given: {list(self.outputs)}"
            )
        return self


def read_description(file: Path) -> Description:
    """A description, checked together with the file it names.

    Raises ConfigError, naming the file and every faulty key, for YAML that cannot be read, keys that are missing,
    unknown or out of bounds, and SourceError for an ONNX file that is missing or has another sha256.
    """
    try:
        body = read_yaml(file, "description")
    except SourceError as e:
        raise ConfigError(f"{e}; describe the ONNX model as docs/guide/pose.md shows") from e
    if not isinstance(body, dict):
        raise ConfigError(
            f"{file}: a mapping of settings is expected, found {type(body).__name__}; describe the ONNX model as"
            " docs/guide/pose.md shows"
        )
    try:
        description = Description.model_validate({**body, "folder": file.resolve().parent})
    except ValidationError as e:
        faults = [
            f"{file}: {'.'.join(str(p) for p in fault['loc']) or 'outputs'}:"
            f" {fault['msg'].removeprefix('Value error, ')}"
            for fault in e.errors()
        ]
        raise ConfigError("\n".join(faults)) from e
    _check_file(file, description)
    return description


def _check_file(file: Path, description: Description) -> None:
    if not description.path.exists():
        raise SourceError(f"{file}: no file {description.path}; `file` is relative to the description's folder")
    regular(description.path, "model")
    if description.sha256 is None:
        return
    with open(description.path, "rb") as f:
        found = hashlib.file_digest(f, "sha256").hexdigest()
    if found != description.sha256:
        raise SourceError(
            f"{file}: {description.path} has sha256 {found}, the description says {description.sha256}; it is another"
            " file, or the description is to be corrected"
        )
