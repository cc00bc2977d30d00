"""Settings: the packaged default, a file laid over it, `--set` on top, and overrides by sequence.

Every fault of every layer is collected and reported as `file:line:column key: what is wrong; what to write instead`.
"""

from __future__ import annotations

import difflib
import fnmatch
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin

from pydantic import BaseModel, Field, ValidationError, create_model, field_validator

from posegaussian.dags.config.effect_settings import EffectSettings
from posegaussian.dags.config.faults import dotted, faults_of, present, unknown_key
from posegaussian.dags.config.yaml_source import Document, Location, load, parse_value
from posegaussian.stages.contract.declaration import Params, setting
from posegaussian.stages.registry import STAGES
from posegaussian.storage.model.errors import ConfigError
from posegaussian.storage.model.roles import EVENLY
from posegaussian.storage.model.spec import ArraySpec, Keep
from posegaussian.storage.model.splits import PROTOCOLS
from posegaussian.storage.model.yaml_documents import yaml_text

GLOBAL = {"archive", "partition", "run", "sequences"}
"""Sections that hold for all sequences alike."""

PACKAGED = Path(__file__).with_name("pipeline.yaml")
"""The full configuration with every default."""


SOURCES = rf"^({EVENLY}|{'|'.join(PROTOCOLS)})$"
"""What `views.sources` may be beside names of cameras."""

UNITS = {"": 1, "B": 1, "KB": 10**3, "MB": 10**6, "GB": 10**9, "TB": 10**12}
"""Bytes of a size's unit."""

_SIZE = re.compile(r"([0-9]{1,12}(?:\.[0-9]{1,6})?) *(|[KkMmGgTt]?[Bb])")


class PartitionSettings(Params):
    """How a sequence is cut along time when it is imported."""

    frames: int | None = setting(
        None, "Frames of a partition; null: as many as fit the budget.", unit="frames", ge=1, le=4096
    )
    megabytes: float = setting(256.0, "Budget of the largest shard.", unit="MB", gt=0)
    most_frames: int = setting(
        8, "Upper bound of the partition length that the budget leads to.", unit="frames", ge=1, le=4096
    )


class ViewSettings(Params):
    """Roles of the cameras."""

    sources: list[str] | Annotated[str, Field(pattern=SOURCES)] | None = setting(
        None,
        "Cameras to reconstruct from; null: all that are not held out, uniform N: N of these, evenly by angle; or a"
        f" protocol of the data set: {', '.join(PROTOCOLS)}.",
    )
    held_out: list[str] | None = setting(
        None, "Cameras that only metrics may look at; null: those that the capture holds out, [] none."
    )
    trust: Literal["auto", "all"] | list[str] = setting(
        "auto",
        "Which sources are believed; auto: all but those that contradict the others, turned where silhouettes or joints"
        " ask for it, all: every one as it is written down, names: these whatever they show, and of the others those"
        " that auto believes.",
    )

    @field_validator("sources", mode="before")
    @classmethod
    def _a_choice_of_cameras(cls, value: Any) -> Any:
        if isinstance(value, str) and re.fullmatch(SOURCES, value) is None:
            known = ", ".join(PROTOCOLS)
            raise ValueError(f"a list of cameras, uniform N or a protocol ({known}) is expected, got {value!r}")
        return value


class RunSettings(Params):
    """Where tasks run. Nothing here changes a result, but a GPU rounds otherwise than a CPU: what is drawn or refined
    on one is as good, not the same to the bit."""

    scheduler: str = setting(
        "local", "serial, local, or the address of a running scheduler.", pattern=r"^(serial|local|(tcp|tls|ucx)://.+)$"
    )
    workers: int | None = setting(
        None,
        "Worker processes of the local scheduler; null: one for every `threads` cores, less GPU workers that share a"
        " device, and no more than there is memory for.",
        ge=1,
        le=1024,
    )
    threads: int = setting(1, "Threads each task may use.", ge=1, le=256)
    gpus: Literal["auto"] | Annotated[int, Field(ge=0, le=64)] = setting(
        "auto",
        "GPU workers of the local scheduler; more than there are devices share them; auto: one, or as many as cores and"
        " memory of the device allow. Without a device they compute on the CPU.",
    )
    window: int = setting(
        2, "Tasks in flight for every worker slot; up to 8 while tasks take milliseconds.", ge=1, le=64
    )
    retries: int = setting(
        2, "Further attempts after a transient failure of a disk, a connection or a device.", ge=0, le=100
    )
    backoff: float = setting(5.0, "Pause before the second attempt, doubled before each further one.", unit="s", ge=0)
    timeout: float | None = setting(None, "Time one task may take; null: any.", unit="s", gt=0)
    lease: float = setting(
        60.0, "Time after which the work of a machine that fell silent may be taken over.", unit="s", ge=1, le=86400
    )
    memory: float | None = setting(
        None, "Memory one worker may use; null: physical memory over the number of workers.", unit="MB", gt=0
    )
    keep_variants: str = setting(
        "2GB",
        "Disk for results of other settings, so that going back to a setting takes them over, of all sequences"
        " together: a size like 500MB or 2GB; 0 keeps none.",
    )
    keep: Literal["everything", "as_declared"] = setting(
        "everything",
        "Whether arrays that no task needs any more stay, or are dropped as they are declared. Cannot change a result.",
    )
    report: str = setting(
        "auto",
        "Page that a run writes of its archive at its end: auto: report.html in the archive's folder, after runs of ten"
        " times what it takes; off: none; or an .html file of your own, after every run that did something.",
    )

    @field_validator("report", mode="before")
    @classmethod
    def _a_page(cls, value: Any) -> Any:
        if value not in ("auto", "off") and not str(value).lower().endswith((".html", ".htm")):
            raise ValueError(f"auto, off or the name of an .html file is expected, got {value!r}")
        return value

    @field_validator("keep_variants", mode="before")
    @classmethod
    def _a_size(cls, value: Any) -> Any:
        """A number alone is bytes."""
        text = str(value).strip() if isinstance(value, int | str) and not isinstance(value, bool) else ""
        if _SIZE.fullmatch(text) is None:
            raise ValueError(f"a size like 500MB or 2GB is expected, or 0, got {value!r}")
        return text

    @property
    def kept_bytes(self) -> int:
        """`keep_variants` in bytes."""
        found = _SIZE.fullmatch(self.keep_variants)
        assert found is not None
        return round(float(found[1]) * UNITS[found[2].upper()])


class _Common(Params):
    archive: str = Field("./archive", description="Folder of the archive.")
    partition: PartitionSettings = PartitionSettings()
    views: ViewSettings = ViewSettings()
    keep: dict[str, Keep] = Field(
        default={}, description="ARRAY: always | until_done | never; what is not named follows run.keep."
    )
    run: RunSettings = RunSettings()

    @field_validator("keep")
    @classmethod
    def _arrays_that_can_be_dropped(cls, value: dict[str, Keep]) -> dict[str, Keep]:
        """A misspelt name would drop nothing in silence;
        constants of a sequence come out different once the sources have grown."""
        known = [w.name for s in STAGES if not s.sequence_wide for w in s.writes if isinstance(w, ArraySpec)]
        for name in value:
            if name not in known:
                close = difflib.get_close_matches(name, known, n=1)
                raise ValueError(
                    f"{name!r} is no array that can be dropped"
                    + (f'; did you mean "{close[0]}"?' if close else f"; these can: {', '.join(known)}")
                )
        return value


Settings: Any = create_model(
    "Settings",
    __base__=_Common,
    effects=(EffectSettings, EffectSettings()),
    **{s.name: (s.params, s.params()) for s in STAGES},
)  # type: ignore[call-overload]
"""The validated settings of one sequence: one field a stage, beside archive, partition, views, effects and run."""


@dataclass(frozen=True)
class Configuration:
    """All layers, and the settings they lead to."""

    layers: tuple[Document, ...]
    """Lowest first: packaged default, file, `--set`."""
    default: Any
    """Settings of a sequence that no override names."""
    overrides: dict[str, dict[str, Any]]
    """{glob: partial settings} of `sequences`."""

    def for_sequence(self, name: str) -> Any:
        """Settings of one sequence: overrides of its name, or whose glob matches, are laid over the default,
        in the order of the file."""
        values = _merged(self.layers)
        globs = [g for g in self.overrides if _means(g, name)]
        if not globs:
            return self.default
        for g in globs:
            values = merge(values, self.overrides[g])
        return Settings.model_validate({k: v for k, v in values.items() if k != "sequences"})

    def idle(self, names: Sequence[str]) -> list[str]:
        """Sentences about overrides whose glob matches none of an archive's sequences: a misspelt name is no error,
        for one file may serve several archives."""
        return [
            unknown_key(g, names, thing=f"the settings under sequences.{g} are for no sequence of this archive")
            for g in self.overrides
            if not any(_means(g, n) for n in names)
        ]

    def as_yaml(self, paths: Sequence[str] = ()) -> str:
        """The effective settings, kept in the archive by every run;
        `paths` that it was asked for take the place of all others."""
        values = {**self.default.model_dump(mode="json"), "sequences": self.overrides}
        if paths:
            own = {"rendering": {"paths": list(paths)}}
            named = {
                g: merge(o, own) if "paths" in (o.get("rendering") or {}) else o for g, o in self.overrides.items()
            }
            values = {**merge(values, own), "sequences": named}
        return yaml_text(values)


def _means(glob: str, name: str) -> bool:
    """Whether a key of `sequences` is a sequence's name, in which brackets are but letters, or a glob that matches."""
    return glob == name or fnmatch.fnmatchcase(name, glob)


def merge(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """Lay one mapping over another, key by key; lists and scalars are replaced. A section whose keys are all
    commented out changes nothing."""
    out = dict(below)
    for key, value in above.items():
        old = out.get(key)
        out[key] = (
            merge(old, {} if value is None else value)
            if isinstance(old, Mapping) and (value is None or isinstance(value, Mapping))
            else value
        )
    return out


def load_configuration(
    config: Path | None = None, assignments: Sequence[str] = (), folder: Path | None = None
) -> Configuration:
    """Read `config`, else ./pipeline.yaml of `folder`, over the packaged default, with `--set` assignments on top.

    Raises ConfigError listing every fault.
    """
    layers = [_packaged()]
    own = (folder or Path.cwd()) / "pipeline.yaml"
    if config is not None:
        layers.append(load(config))
    elif own.is_file() and own.resolve() != PACKAGED.resolve():
        layers.append(load(own))
    if assignments:
        layers.append(from_assignments(assignments))
    return validate(tuple(layers))


@lru_cache(maxsize=1)
def _packaged() -> Document:
    """The packaged default, read once a process; nobody changes it."""
    return load(PACKAGED)


def validate(layers: tuple[Document, ...]) -> Configuration:
    """Check every layer against the schema. Raises ConfigError with all faults at once."""
    faults: list[str] = []
    values = _merged(layers)
    overrides = values.pop("sequences", None) or {}
    settings = _try(values, (), layers, faults)
    if not isinstance(overrides, Mapping):
        faults.append(
            f"{_where(layers, ('sequences',))} sequences: a mapping of names to settings is expected, got {overrides!r}"
        )
        overrides = {}
    for glob, partial in overrides.items():
        if not isinstance(partial, Mapping):
            faults.append(
                f"{_where(layers, ('sequences', glob))} sequences.{glob}:"
                f" a mapping of settings is expected, got {partial!r}"
            )
            continue
        faults += [
            f"{_where(layers, ('sequences', glob, key))} sequences.{glob}.{key}: cannot differ between sequences; set"
            " it at the top level"
            for key in GLOBAL & partial.keys()
        ]
        known = {k: v for k, v in partial.items() if k not in GLOBAL}
        _try(merge(values, known), ("sequences", glob), layers, faults, only=known)
    if faults:
        raise ConfigError("\n".join(dict.fromkeys(faults)))
    return Configuration(layers, settings, {str(k): dict(v) for k, v in overrides.items()})


def _merged(layers: Sequence[Document]) -> dict[str, Any]:
    values: dict[str, Any] = {}
    for layer in layers:
        values = merge(values, layer.values)
    return values


def validated(model: type[Any], layers: Sequence[Document]) -> Any:
    """The settings of a model of its own, from layers, lowest first. Raises ConfigError with all faults at once."""
    faults: list[str] = []
    settings = _try(_merged(layers), (), layers, faults, model=model)
    if faults:
        raise ConfigError("\n".join(dict.fromkeys(faults)))
    return settings


def from_assignments(assignments: Sequence[str]) -> Document:
    """`depth.method=hull` as a layer; values are YAML. Raises ConfigError for what is no assignment."""
    document = Document("--set")
    for text in assignments:
        key, separator, value = text.partition("=")
        if not separator or not key.strip():
            raise ConfigError(f"--set {text}: write it as stage.key=value, for example depth.method=hull")
        target = document.values
        *parents, last = key.strip().split(".")
        for parent in parents:
            target = target.setdefault(parent, {})
            if not isinstance(target, dict):
                raise ConfigError(f"--set {text}: {parent} was already given a value and cannot hold {last}")
        try:
            target[last] = parse_value(value)
        except ConfigError as e:
            raise ConfigError(f"--set {text}: {e}") from e
    return document


def _where(layers: Sequence[Document], location: Location) -> str:
    """Position in the topmost layer that has the key."""
    for layer in reversed(layers):
        if present(layer.values, location):
            return layer.where(location)
    return layers[-1].where(location)


def _try(
    values: Mapping[str, Any],
    prefix: Location,
    layers: Sequence[Document],
    faults: list[str],
    only: Mapping[str, Any] | None = None,
    model: type[Any] = Settings,
) -> Any:
    """Validate; add a sentence per fault; None when there are any."""
    try:
        return model.model_validate(values)
    except ValidationError as error:
        for location, sentence in faults_of(error, values, lambda at: _unknown(at, model)):
            if only is None or present(only, location):
                place = (*prefix, *location)
                faults.append(f"{_where(layers, place)} {dotted(place)}: {sentence}")
        return None


def _unknown(location: Location, model: type[BaseModel]) -> str:
    """The sentence about a key that a model has not; a stage's key at the top of a section may belong to another
    stage."""
    key = str(location[-1])
    of_stage = model is Settings and len(location) == 2
    elsewhere = [f"{s.name}.{key}" for s in STAGES if of_stage and key in s.params.model_fields]
    return unknown_key(key, _fields_at(location[:-1], model), elsewhere)


def _fields_at(location: Location, model: type[BaseModel]) -> list[str]:
    """Known keys of a section of a model."""
    of_each: Any = None
    for part in location:
        info = model.model_fields.get(str(part))
        annotation = of_each or (info.annotation if info else None)
        of_each = get_args(annotation)[1] if get_origin(annotation) is dict else None
        if of_each is not None:
            continue
        if not (isinstance(annotation, type) and issubclass(annotation, BaseModel)):
            break
        model = annotation
    names = list(model.model_fields)
    return [*names, "sequences"] if model is Settings else names
