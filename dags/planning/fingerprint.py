"""What a task's output depends on, hashed; and, from two such records, sentences that say what changed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from posegaussian.dags.assets.digest import asset_digest
from posegaussian.dags.planning.context import Context
from posegaussian.dags.planning.tasks import Product, Task, inputs, path_frames, selected_views, worked_frames
from posegaussian.dags.provenance.code_digest import code_digest
from posegaussian.dags.provenance.once import once
from posegaussian.stages.contract.declaration import Read, Stage
from posegaussian.stages.registry import ASSETS
from posegaussian.stages.registry import stage as stage_named
from posegaussian.storage.model.spec import digest


class PlannedAsset(NamedTuple):
    """Models or weights as a run was planned with them."""

    settings: Any
    """The settings that say which."""
    digest: str
    """Of what a kernel gets."""


def own_parts(context: Context, task: Task) -> dict[str, Any]:
    """Everything but the contents of inputs: stage, version, code, params, effects, sources, bounds, cameras."""
    stage = stage_named(task.stage)
    return {
        **_stage_parts(context, stage),
        "bounds": _bounds(context, task),
        "cameras": _cameras(context, task),
        "sources": {} if stage.sequence_wide else _sources(context, stage, task),
        **({"worked": [context.frame_range, *context.source_frames[[0, -1]].tolist()]} if stage.sequence_wide else {}),
    }


def _stage_parts(context: Context, stage: Stage) -> dict[str, Any]:
    """What all tasks of a stage have in common."""
    key = ("parts", stage.name)
    if key not in context.memo:
        asked = (
            {"asked": sorted(w.name for w in stage.writes_for(context.facts) if w.when in (None, w.name))}
            if stage.sequence_wide
            else {}
        )
        context.memo[key] = {
            "stage": stage.name,
            "version": stage.version,
            "code": once(("code", stage.run), lambda: code_digest(stage.run)),
            "params": context.params(stage).hashed(),
            **({"seen": {n: getattr(context.settings, n).hashed() for n in stage.sees}} if stage.sees else {}),
            "effects": context.effect_states(stage),
            **({"rate": float(context.capture.frame_rate)} if stage.timed else {}),
            **asked,
        }
    return context.memo[key]


def still_good(parts: dict[str, Any], old: Mapping[str, Any]) -> dict[str, Any]:
    """Fingerprint parts under which constants stay: taken together with others nobody asks for any more, or of
    frames that are at least half of those worked on now."""
    asked = {"asked": old["asked"]} if set(parts.get("asked", ["-"])) <= set(old.get("asked", ())) else {}
    worked = {"worked": old["worked"]} if "worked" in parts and _covers(old.get("worked"), parts["worked"]) else {}
    return {**parts, **asked, **worked}


def _covers(old: Sequence[Any] | None, new: Sequence[Any]) -> bool:
    """Whether constants of frames (range, first, last) will do for others: of the same range of a source that grew,
    or of at least half of them."""
    if old is None:
        return False
    return old[0] == new[0] or 2 * (min(old[2], new[2]) - max(old[1], new[1]) + 1) >= new[2] - new[1] + 1


def _bounds(context: Context, task: Task) -> list[Any]:
    """Source frame numbers of the partition and which views have them."""
    own = worked_frames(context, task)
    if not own:
        return []
    views = [task.view] if task.view is not None else list(context.active_views)
    valid = context.valid[own.start : own.stop][:, views]
    return [context.source_frames[own.start : own.stop].tolist(), "all" if valid.all() else valid.astype(int).tolist()]


def _cameras(context: Context, task: Task) -> str:
    """Digest of the cameras and roles a task may look at; of its own camera alone where it runs over views and time."""
    if task.path is None:
        stage = stage_named(task.stage)
        key = ("cameras", task.view, task.partition is None, stage.name if stage.cameras else None)
        if key not in context.memo:
            context.memo[key] = digest(_camera_parts(context, task))
        return context.memo[key]
    if "camera parts" not in context.memo:
        context.memo["camera parts"] = _camera_parts(context, task)
    span = path_frames(context, task)
    path = context.paths[task.path].slice(slice(span.start, span.stop))
    return digest(
        [*context.memo["camera parts"], list(path.names), path.intrinsics, path.world_to_camera, path.size, path.served]
    )


def _camera_parts(context: Context, task: Task) -> list[Any]:
    views = list(range(len(context.rig))) if task.view is None or task.partition is None else [task.view]
    parts: list[Any] = [
        context.rig_of(stage_named(task.stage)).subset(views).digest,
        context.capture.rig.subset(views).digest,
        context.captured_to_calibrated[views],
    ]
    if task.view is None:
        names = context.views.names
        parts += [[names[i] for i in context.views.sources], [names[i] for i in context.views.held_out]]
    if context.joint_set is not None:
        parts.append(context.joint_set)
    return parts


def _source_reads(context: Context, stage: Stage) -> list[Read]:
    """Sources that a stage reads under the context's settings."""
    key = ("sources", stage.name)
    if key not in context.memo:
        context.memo[key] = [r for r in stage.reads_for(context.params(stage), context.facts) if r.is_source]
    return context.memo[key]


def assets(context: Context, stage: Stage) -> dict[str, PlannedAsset]:
    """{source: what is planned with} of the models and weights that a stage opens, which are no files of the
    capture."""
    key = ("assets", stage.name)
    if key not in context.memo:
        asked = [r.array for r in _source_reads(context, stage) if r.array in ASSETS]
        settings = {name: context.asset_settings(name) for name in asked}
        context.memo[key] = {
            name: PlannedAsset(given, asset_digest(ASSETS[name][1], given)) for name, given in settings.items()
        }
    return context.memo[key]


def _sources(context: Context, stage: Stage, task: Task) -> dict[str, str]:
    """Digest of the source files a task may open, by kind and camera."""
    found = {name: planned.digest for name, planned in assets(context, stage).items()}
    for read in _source_reads(context, stage):
        if read.array in found:
            continue
        streams = context.capture.streams(read.array)
        halo = read.halo_for(context.params(stage), context.facts)
        span = None if task.partition is None else context.grid.span(task.partition, halo)
        numbers = context.capture.numbers if span is None else context.source_frames[span.start : span.stop]
        if read.array == "joints3d":
            chosen = {"joints3d": streams[0]}
        else:
            chosen = {
                f"{read.array} of {context.views.names[v]}": streams[v] if streams else None
                for v in selected_views(context, read, task)
            }
        found |= {k: "none" if s is None else s.digest(numbers) for k, s in chosen.items()}
    return found


def all_parts(context: Context, task: Task, own: dict[str, Any], digests: Mapping[Product, str]) -> dict[str, Any]:
    """`own_parts` and the content digest of every product the task reads."""
    names = context.views.names
    read = {_product_label(p, names): digests[p] for i in inputs(context, task) for p in i.products}
    return {**own, "inputs": read}


def _product_label(p: Product, names: tuple[str, ...]) -> str:
    return " ".join(
        [
            p.array,
            *([f"partition {p.partition}"] if p.partition is not None else []),
            *([f"of {names[p.view]}"] if p.view is not None else []),
        ]
    )


def reasons(context: Context, old: Mapping[str, Any], new: Mapping[str, Any]) -> list[str]:
    """What changed between two records of a task, most telling first; keys that `new`, the context's, lacks are not
    compared."""
    stage = new["stage"]
    out = []
    if old.get("version") != new["version"]:
        out.append(f"version of {stage} {old.get('version')} -> {new['version']}")
    out += _params_changed(stage, old.get("params", {}), new["params"])
    for name, seen in new.get("seen", {}).items():
        out += _params_changed(name, old.get("seen", {}).get(name, {}), seen)
    if old.get("code") != new["code"]:
        out.append(f"code of {stage} changed ({str(old.get('code'))[:4]} -> {new['code'][:4]})")
    out += _effects_changed(old.get("effects", {}), new["effects"])
    if "rate" in new and old.get("rate") != new["rate"]:
        before = f"{old['rate']:g}" if "rate" in old else "one that was not noted"
        out.append(f"the frame rate {before} -> {new['rate']:g}")
    out += [f"{name} is asked for" for name in new.get("asked", []) if name not in old.get("asked", [])]
    if "worked" in new and not _covers(old.get("worked"), new["worked"]):
        first, last = new["worked"][1:]
        seen = f", {stage} looked at {old['worked'][1]}..{old['worked'][2]}" if "worked" in old else ""
        out.append(f"frames {first}..{last} are worked on{seen}")
    moved = old.get("bounds") != new["bounds"]
    if moved:
        out.append(_bounds_changed(old.get("bounds"), new["bounds"]))
    if old.get("cameras") != new["cameras"]:
        out.append("cameras, their roles or the camera path changed")
    if not moved:  # other frames have other sources; that they differ is no news
        around = tuple(f"{kind} of " for kind in _read_around(context, stage_named(stage)))
        out += _entries_changed("source", old.get("sources", {}), new["sources"], around=around)
    if "inputs" in new:
        out += _entries_changed("input", old.get("inputs", {}), new["inputs"], both=moved)
    return out


def asked_alike(old: Mapping[str, Any], new: Mapping[str, Any]) -> bool:
    """Whether two records are of the same settings, effects, frames and cameras, by whatever code and of whatever
    content; effects that are undecided in `new` are not compared."""
    return (
        all(old.get(part) == new.get(part) for part in ("params", "seen", "bounds", "cameras"))
        and not _effects_changed(old.get("effects", {}), new["effects"])
        and ("worked" not in new or _covers(old.get("worked"), new["worked"]))
    )


def _read_around(context: Context, stage: Stage) -> list[str]:
    """Sources of which frames around the partition are read, too: another range of frames changes their digests."""
    params = context.params(stage)
    return [r.array for r in _source_reads(context, stage) if r.halo_for(params, context.facts) != (0, 0)]


def _entries_changed(
    kind: str, old: Mapping[str, str], new: Mapping[str, str], both: bool = False, around: tuple[str, ...] = ()
) -> list[str]:
    """Entries whose digest changed, that are read now, or no longer; with `both` only those that were read before
    and after. `around`: how those begin of which frames around the partition are read."""
    shared = [
        f"{kind} {k}, or which frames are read of it, changed" if k.startswith(around) else f"{kind} {k} changed"
        for k in sorted(old.keys() & new.keys())
        if old[k] != new[k]
    ]
    if both:
        return shared
    return [
        *shared,
        *(f"{kind} {k} is now read" for k in sorted(new.keys() - old.keys())),
        *(f"{kind} {k} is no longer read" for k in sorted(old.keys() - new.keys())),
    ]


def _params_changed(stage: str, old: Mapping[str, Any], new: Mapping[str, Any]) -> list[str]:
    absent = object()
    changed = [k for k in sorted({*old, *new}) if old.get(k, absent) != new.get(k, absent)]
    return [f"{stage}.{k} {_short(old.get(k, 'unset'))} -> {_short(new.get(k, 'unset'))}" for k in changed]


def _effects_changed(old: Mapping[str, str], new: Mapping[str, str]) -> list[str]:
    """`effect NAME off -> on`; undecided ones are not compared."""
    pairs = [(k, old.get(k, "off"), new.get(k, "off")) for k in sorted({*old, *new})]
    return [f"effect {k} {was} -> {now}" for k, was, now in pairs if now not in (was, "undecided")]


def _short(value: Any) -> str:
    text = f"{value}"
    return text if len(text) <= 40 else text[:37] + "..."


def _bounds_changed(old: Any, new: Any) -> str:
    def span(b: Any) -> str:
        return f"{b[0][0]}..{b[0][-1]} ({len(b[0])} frames)" if b and b[0] else "none"

    return (
        f"frames of the partition {span(old)} -> {span(new)}"
        if span(old) != span(new)
        else "which views have which frames changed"
    )
