"""Protocols of data sets, written once and used by name: which cameras are sources, which are compared with, and the
frames that papers report.

Places are those of a data set's own list of cameras. An importer resolves the protocols of its data set to names of
cameras; the capture keeps them, so that a name means the same cameras in every later version.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from posegaussian.storage.model.errors import ConfigError


@dataclass(frozen=True)
class Split:
    """A protocol in one capture."""

    sources: tuple[str, ...]
    """Names of the cameras to reconstruct from; one that the capture does not have makes the protocol unusable."""
    held_out: tuple[str, ...]
    """Names of the cameras that only metrics may look at."""
    frames: str | None = None
    """Its test frames as start:stop:stride; None where its authors tell none for this capture."""


@dataclass(frozen=True)
class Protocol:
    """One protocol of a data set."""

    name: str
    """As in `views.sources: NAME`."""
    layout: str
    """The importer of its data set."""
    summary: str
    """For the help and the documentation."""
    sources: Callable[[Sequence[str]], Sequence[str]]
    """From all cameras of the data set in its order to the names of the sources."""
    compares: bool = True
    """Whether all other cameras are held out; else none is."""
    frames: Mapping[str, str] = field(default_factory=dict)
    """Test frames as start:stop:stride by subject, "" for any."""


def at(*places: int) -> Callable[[Sequence[str]], list[str]]:
    """The cameras at places of a data set's list; one that is not there is named by its place."""
    return lambda order: [order[p] if p < len(order) and order[p] else f"at place {p}" for p in places]


def _of_every_subject(order: Sequence[str]) -> list[str]:
    """313 and 315 have 21 cameras, without those that are numbered 20 and 21; the others have 23."""
    return [n for p, n in enumerate(order) if len(order) < 23 or p not in (19, 20)]


_ZJU_FRAMES = {
    "313": "0:60:30",
    "315": "0:400:30",
    **dict.fromkeys(("377", "386", "387", "392", "393", "394"), "0:300:30"),
    "390": "700:1000:30",
    "396": "810:1350:30",
}
"""Every 30th of the frames that Neural Body trains with."""

PROTOCOLS: Mapping[str, Protocol] = {
    p.name: p
    for p in (
        Protocol(
            "zju_4",
            "zju_mocap",
            "Neural Body: the cameras at places 0, 6, 12 and 18; all others are compared with, every 30th frame",
            at(0, 6, 12, 18),
            frames=_ZJU_FRAMES,
        ),
        Protocol(
            "zju_1",
            "zju_mocap",
            "Instant-NVR: the camera at place 4; all others are compared with, 17 frames",
            at(4),
            frames={"": "0:510:30"},
        ),
        Protocol(
            "zju_21",
            "zju_mocap",
            "the 21 cameras that all subjects have, none of them held out",
            _of_every_subject,
            compares=False,
            frames=_ZJU_FRAMES,
        ),
        Protocol(
            "genebody_4",
            "genebody",
            "cameras 01, 13, 25 and 37; all others are compared with",
            lambda _: ["01", "13", "25", "37"],
        ),
        Protocol(
            "gps_2",
            "gps_gaussian",
            "a rendered sample's views 0 and 1; 2, 3 and 4 are compared with",
            lambda _: ["0", "1"],
        ),
    )
}
"""In the order in which sentences name them."""

SCAN_PARTS: Mapping[str, str] = {"gps_train": "0:426", "gps_val": "426:526"}
"""Scans of THuman2.0, in the order of their names, that GPS-Gaussian trains on and measures on."""


def splits_of(layout: str, order: Sequence[str], there: Sequence[str], subject: str) -> dict[str, Split]:
    """The protocols of a layout in one capture.

    Args:
        layout: the importer's name.
        order: all cameras of the data set in its order, "" for those whose name nobody knows.
        there: the cameras that the capture has.
        subject: the folder's name, which tells the subject: `CoreView_377`, `my_377`.
    """
    out = {}
    for p in PROTOCOLS.values():
        if p.layout != layout:
            continue
        sources = tuple(p.sources(order))
        rest = tuple(n for n in there if n not in sources) if p.compares else ()
        own = next((f for s, f in p.frames.items() if s and subject.endswith(s)), p.frames.get(""))
        out[p.name] = Split(sources, rest, own)
    return out


def said_of(splits: Mapping[str, Split], there: Sequence[str]) -> list[str]:
    """Sentences for whoever imports: which protocol fits, and which needs cameras that are not there."""
    out = []
    for name, s in splits.items():
        if lacking := [n for n in s.sources if n not in there]:
            out.append(f"protocol {name} needs cameras that are not there: {', '.join(lacking)}")
            continue
        held = f", {len(s.held_out)} held out" if s.held_out else ", none held out"
        frames = f"; frames.range: {name} takes its test frames, {s.frames}" if s.frames else ""
        sources = ", ".join(s.sources) if len(s.sources) <= 4 else f"{len(s.sources)} cameras"
        out.append(f"views.sources: {name} is a protocol of this data set: sources {sources}{held}{frames}")
    return out


def split_named(name: str, splits: Mapping[str, Split], key: str, sequence: str, layout: str) -> Split:
    """The protocol that a setting names, in a capture. Raises ConfigError where the capture is of another data set."""
    if name not in splits:
        own = f"it has {', '.join(splits)}" if splits else "it has none: use uniform N or names of cameras"
        raise ConfigError(
            f"{key}: {name} is a protocol of {PROTOCOLS[name].layout}, and sequence {sequence} came in as {layout};"
            f" {own}. Where it was imported by an earlier version, import it again"
        )
    return splits[name]


def frames_of(text: str, splits: Mapping[str, Split], sequence: str, layout: str) -> str:
    """`frames.range` as start:stop:stride, where it may name a protocol. Raises ConfigError where that tells none."""
    if text not in PROTOCOLS:
        return text
    frames = split_named(text, splits, "frames.range", sequence, layout).frames
    if frames is None:
        raise ConfigError(
            f"frames.range: protocol {text} tells no test frames for sequence {sequence}; write them as"
            " start:stop:stride"
        )
    return frames
