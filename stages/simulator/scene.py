"""A scene file: who is filmed, doing what, by which cameras, and which effects spoil the pictures.

All lengths are metres, angles degrees, times seconds unless a field says otherwise. The subject stands at the origin, Z
is up, the ground is z = 0, and it faces +x. Every random choice follows from `seed` alone.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Discriminator, Field, Tag, create_model, field_validator, model_validator

from posegaussian.stages.contract.declaration import Params
from posegaussian.stages.simulator.effects.registry import EFFECTS
from posegaussian.stages.simulator.subjects.motion_names import MOTION_NAMES
from posegaussian.stages.simulator.subjects.outfits import LOOKS, OUTFITS
from posegaussian.stages.simulator.subjects.splits import refusal
from posegaussian.stages.simulator.wardrobe.description import Carried, Cloth, Extras, Hair, Strap

Number = Annotated[float, Field(allow_inf_nan=False)]
Size = tuple[Annotated[int, Field(ge=16, le=8192)], Annotated[int, Field(ge=16, le=8192)]]
Point = tuple[Number, Number, Number]


class Person(Extras):
    """A baked subject, what it wears and what it holds."""

    person: str = Field("auto", description="Name of a subject, or auto: chosen by the seed.")
    outfit: str = Field("auto", description="Name of an outfit, or auto: chosen by the seed.")
    heading: float = Field(0.0, description="Degrees the subject is turned to the left.")

    @field_validator("person")
    @classmethod
    def _known_person(cls, value: str) -> str:
        if value not in ("auto", *LOOKS):
            raise ValueError(f"there is no subject {value!r}; there are {', '.join(LOOKS)}, and auto")
        return value

    @field_validator("outfit")
    @classmethod
    def _known_outfit(cls, value: str) -> str:
        if value not in ("auto", *OUTFITS):
            raise ValueError(f"there is no outfit {value!r}; there are {', '.join(OUTFITS)}, and auto")
        return value

    def extras(self) -> Extras:
        """What it wears beyond the outfit, and holds."""
        return Extras.model_validate({name: getattr(self, name) for name in Extras.model_fields})


class Scan(Params):
    """A textured mesh."""

    obj: Path = Field(description="OBJ file, relative to the scene file; its material names the texture.")
    up: Literal["x", "y", "z"] = Field(
        "y", description="Axis of the file that points up; THuman2.0 and Twindom scans: y."
    )
    translation: Point = Field(
        (0.0, 0.0, 0.0),
        description="Taken from every vertex first, in the file's unit: `translation` of a THuman2.0 fit.",
    )
    scale: float = Field(1.0, gt=0, description="Every vertex is divided by it: `scale` of a THuman2.0 fit.")
    height: float | None = Field(None, gt=0, description="Height the scan is brought to; null: as it is after `scale`.")
    heading: float = Field(0.0, description="Degrees it is turned to the left.")
    turn: float = Field(0.0, description="Degrees a second it goes on turning to the left.")


class Motion(Params):
    """What a person does."""

    name: str = Field("walk", description="Name of a motion.")
    speed: float = Field(1.0, ge=0, le=20, description="How many times as fast as usual; 0 is a still.")
    phase: float = Field(0.0, description="Seconds into the motion at the first frame.")

    @field_validator("name")
    @classmethod
    def _known_motion(cls, value: str) -> str:
        if value not in MOTION_NAMES:
            raise ValueError(f"there is no motion {value!r}; there are {', '.join(MOTION_NAMES)}")
        return value


class _Lens(Params):
    size: Size = Field((512, 512), description="(width, height) of the pictures in px.")
    focal: float | None = Field(
        None, gt=0, description="Focal length over the longer side of the picture; null: from `fill`."
    )
    fill: float = Field(
        0.86,
        gt=0,
        le=1.5,
        description="Share of the picture's height that the subject at rest fills, where `focal` is null.",
    )
    roll: float = Field(0.0, description="Degrees every camera is rolled about its axis, clockwise as it looks.")


class _Around(_Lens):
    cameras: int = Field(8, ge=1, le=256, description="Number of source cameras.")
    radius: float = Field(2.6, gt=0, description="Distance from the subject's axis.")
    height: float = Field(1.15, description="Height of the cameras above the ground.")
    jitter: float = Field(0.0, ge=0, le=1, description="Random displacement of every camera, standard deviation.")
    roll_spread: float = Field(
        0.0, ge=0, le=180, description="Degrees by which every camera is rolled further, at random, at most."
    )
    tilt: float = Field(
        0.0,
        description=(
            "Degrees the circle of cameras is turned, clockwise as they look, about the line of sight of its `start`"
            " (of stereo: each pair about its own): baselines run diagonally at 45, an arc or a pair stands upright at"
            " 90. Pictures stay level; `roll` turns them."
        ),
    )
    start: float = Field(0.0, description="Degrees to the left of the subject's front where the first camera stands.")
    framing: Literal["rest", "frames"] = Field(
        "rest",
        description=(
            "What `fill` holds for: the subject at rest, or wherever it fills least in the frames filmed (focal null,"
            " level pictures)."
        ),
    )

    @property
    def gaps(self) -> int:
        """Gaps between neighbours, where held-out cameras can stand."""
        return self.cameras


class Ring(_Around):
    """Cameras evenly all around."""

    kind: Literal["ring"] = "ring"


class Arc(_Around):
    """Cameras evenly over part of a circle, its middle in front."""

    kind: Literal["arc"]
    span: float = Field(120.0, gt=0, lt=360, description="Degrees from the first to the last camera.")

    @property
    def gaps(self) -> int:
        """Those between the first camera and the last."""
        return self.cameras - 1


class Dome(_Around):
    """Rings above each other, shifted against each other by half a gap."""

    kind: Literal["dome"]
    rings: int = Field(3, ge=1, le=16, description="Number of rings that share the cameras.")
    top: float = Field(
        60.0, gt=0, lt=90, description="Degrees above the horizon of the uppermost ring; the lowest looks level."
    )

    @property
    def of_ring(self) -> list[int]:
        """Number of cameras of each ring, the lowest first; lower ones have what is left over."""
        each, left = divmod(self.cameras, self.rings)
        return [each + (r < left) for r in range(self.rings)]

    @property
    def gaps(self) -> int:
        """Those within the rings; a single camera has no neighbour."""
        return sum(k for k in self.of_ring if k > 1)


class Stereo(_Around):
    """Pairs of cameras side by side, evenly around; `cameras` is twice the number of pairs."""

    kind: Literal["stereo"]
    cameras: int = Field(8, ge=2, le=256, multiple_of=2, description="Number of source cameras.")
    baseline: float = Field(0.35, gt=0, description="Distance of the two cameras of a pair.")

    @property
    def gaps(self) -> int:
        """Those within the pairs."""
        return self.cameras // 2


class THuman(_Around):
    """The ring of the paper's THuman2.0 protocol: 6 or 8 cameras evenly around a scan, at mid-height."""

    kind: Literal["thuman"]
    cameras: Literal[6, 8] = Field(8, description="Number of source cameras.")
    radius: float = Field(2.0, gt=0, description="Distance from the subject's axis.")
    height: float = Field(0.9, description="Height of the cameras above the ground.")
    size: Size = Field((1024, 1024), description="(width, height) of the pictures in px.")


class SceneCamera(_Lens):
    """One camera."""

    name: str = Field(pattern=r"^[A-Za-z0-9_.-]+$", description="Unique name.")
    position: Point = Field(description="Where it stands.")
    look_at: Point | None = Field(None, description="Where it looks; null: at the middle of the subject.")
    up: Point = Field((0.0, 0.0, 1.0), description="What points upwards in its picture.")


class Listed(Params):
    """Cameras one by one."""

    kind: Literal["list"]
    cameras: list[SceneCamera] = Field(min_length=1, description="The cameras.")
    jitter: float = Field(0.0, ge=0, le=1, description="Random displacement of every camera, standard deviation.")


RIGS: dict[str, type[BaseModel]] = {
    "ring": Ring,
    "arc": Arc,
    "dome": Dome,
    "stereo": Stereo,
    "thuman": THuman,
    "list": Listed,
}


def _kind(data: Any) -> Any:
    return data.get("kind", "ring") if isinstance(data, dict) else getattr(data, "kind", None)


def _subject_kind(data: Any) -> str:
    return "scan" if (isinstance(data, dict) and "obj" in data) or isinstance(data, Scan) else "person"


AnyRig = Annotated[
    Annotated[Ring, Tag("ring")]
    | Annotated[Arc, Tag("arc")]
    | Annotated[Dome, Tag("dome")]
    | Annotated[Stereo, Tag("stereo")]
    | Annotated[THuman, Tag("thuman")]
    | Annotated[Listed, Tag("list")],
    Discriminator(
        _kind,
        custom_error_type="rig_kind",
        custom_error_message="there is no such kind of rig; there are ring, arc, dome, stereo, thuman and list",
    ),
]
AnySubject = Annotated[Annotated[Person, Tag("person")] | Annotated[Scan, Tag("scan")], Discriminator(_subject_kind)]


class _Effects(Params):
    @field_validator("*", mode="before")
    @classmethod
    def _one_word(cls, value: Any) -> Any:
        """`name: on` is short for `name: {switch: on}`."""
        if isinstance(value, bool):
            value = "on" if value else "off"
        return {"switch": value} if isinstance(value, str) else value


SceneEffects: Any = create_model(
    "SceneEffects", __base__=_Effects, **{e.name: (e.params | None, None) for e in EFFECTS}
)  # type: ignore[call-overload]
"""One field an effect; what a scene does not name is off."""


class Scene(Params):
    """Everything a scene file says."""

    seed: int = Field(1, ge=0, le=2**31 - 1, description="All that is random follows from it.")
    frames: int = Field(24, ge=1, le=100_000, description="Number of frames.")
    frame_rate: float = Field(30.0, gt=0, description="Frames a second.")
    samples: int = Field(2, ge=1, le=8, description="Samples a side of a pixel.")
    subject: AnySubject = Field(Person.model_validate({}), description="Who is filmed.")
    motion: Motion = Field(Motion.model_validate({}), description="What a person does; a scan only turns.")
    rig: AnyRig = Field(Ring.model_validate({}), description="Source cameras.")
    held_out: int | list[SceneCamera] = Field(
        0,
        description=(
            "Cameras to compare with: a number of them midway between neighbours, at most one a gap (of an arc, of a"
            " ring of a dome, of a pair of stereo), or a list."
        ),
    )
    effects: SceneEffects = Field(SceneEffects(), description="What is simulated besides the plain picture.")

    @model_validator(mode="before")
    @classmethod
    def _short_subject(cls, data: Any) -> Any:
        if isinstance(data, dict) and isinstance(data.get("motion"), str):
            data = {**data, "motion": {"name": data["motion"]}}
        return data


BODY_RADIUS, BODY_HEIGHT = 0.35, 2.0
"""Within this cylinder about the origin a camera is taken to be inside a person, metres."""


NOWHERE = 1e-6
"""Metres from a camera within which there is no direction to look in."""
LARGEST = 1e5
"""Of any number of a scene but its seed: lengths in metres, angles in degrees, times in seconds."""


def _beyond(values: Any, place: tuple[str | int, ...]) -> Iterator[tuple[tuple[str | int, ...], str]]:
    """[(place, sentence)] of numbers that are not finite or beyond `LARGEST`."""
    if isinstance(values, float) and not abs(values) <= LARGEST:
        yield place, f"{values:g} is beyond {LARGEST:g}; lengths are metres, angles degrees and times seconds"
    for key, value in (
        values.items() if isinstance(values, dict) else enumerate(values) if isinstance(values, list | tuple) else ()
    ):
        yield from _beyond(value, (*place, key))


def faults(scene: Scene) -> list[tuple[tuple[str | int, ...], str]]:
    """[(place in the file, sentence)] of what no single field can know."""
    out: list[tuple[tuple[str | int, ...], str]] = [*_beyond(scene.model_dump(), ())]
    if isinstance(scene.subject, Person):
        named: list[tuple[tuple[str | int, ...], str]] = [
            (("subject", "person"), scene.subject.person),
            (("subject", "outfit"), scene.subject.outfit),
            (("motion", "name"), scene.motion.name),
        ]
        if scene.effects.second_person is not None:
            named.append((("effects", "second_person", "motion"), scene.effects.second_person.motion))
        out += [(place, why) for place, name in named for why in [refusal(scene.seed, name)] if why is not None]
        for key, what, taken in (
            ("straps", "strap", [s.kind for s in scene.subject.straps]),
            ("carries", "hand", [c.hand for c in scene.subject.carries]),
        ):
            out += [
                (("subject", key, i), f"{what} {name!r} is taken already; each may be given once")
                for i, name in enumerate(taken)
                if name in taken[:i]
            ]
        inside = (BODY_RADIUS, BODY_HEIGHT)
        if not isinstance(scene.rig, Listed) and scene.rig.radius <= inside[0]:
            out.append(
                (
                    ("rig", "radius"),
                    (
                        f"cameras {scene.rig.radius:g} m from the subject's axis are inside the body; more than"
                        f" {inside[0]:g} m is needed"
                    ),
                )
            )
        for key, cameras in (
            ("rig", scene.rig.cameras if isinstance(scene.rig, Listed) else []),
            ("held_out", scene.held_out if isinstance(scene.held_out, list) else []),
        ):
            for i, c in enumerate(cameras):
                if math.hypot(*c.position[:2]) <= inside[0] and 0 <= c.position[2] <= inside[1]:
                    place = ("rig", "cameras", i) if key == "rig" else ("held_out", i)
                    out.append(
                        (
                            place,
                            (
                                f"camera {c.name} at {tuple(c.position)} is inside the body, which fills {inside[0]:g}"
                                f" m around the axis up to {inside[1]:g} m"
                            ),
                        )
                    )
    listed = [
        *((("rig", "cameras", i), c) for i, c in enumerate(scene.rig.cameras if isinstance(scene.rig, Listed) else [])),
        *((("held_out", i), c) for i, c in enumerate(scene.held_out if isinstance(scene.held_out, list) else [])),
    ]
    out += [
        (place, f"camera {c.name} looks at where it stands, {tuple(c.position)}; name another look_at")
        for place, c in listed
        if c.look_at is not None and math.dist(c.position, c.look_at) < NOWHERE
    ]
    names = [c.name for _, c in listed]
    out += [
        (("rig", "cameras"), f"camera name {n!r} is given twice; names must be unique")
        for n in sorted({n for n in names if names.count(n) > 1})
    ]
    if isinstance(scene.held_out, int):
        count, gaps = (0, 0) if isinstance(scene.rig, Listed) else (scene.rig.cameras, scene.rig.gaps)
        if scene.held_out < 0 or scene.held_out > gaps:
            out.append(
                (
                    ("held_out",),
                    (
                        f"{scene.held_out} held-out cameras between {count} cameras of a rig, which has {gaps} gaps;"
                        " at most one a gap, 0 for a list (list them too)"
                    ),
                )
            )
    return out


_OF_PERSON: dict[str, type[BaseModel]] = {
    "upper": Cloth,
    "lower": Cloth,
    "straps": Strap,
    "carries": Carried,
    "hair": Hair,
}


def known_fields(path: tuple[str | int, ...], tag: str | None = None) -> list[str]:
    """Names that may stand in a section of a scene file; `tag` is the rig's kind. Empty where nothing is known."""
    if not path:
        return list(Scene.model_fields)
    top = str(path[0])
    if top == "effects":
        return (
            [e.name for e in EFFECTS]
            if len(path) == 1
            else next((list(e.params.model_fields) for e in EFFECTS if e.name == path[1]), [])
        )
    if top == "rig":
        return list((SceneCamera if len(path) > 1 else RIGS.get(str(tag), Ring)).model_fields)
    if top == "subject" and len(path) > 1:
        return list(_OF_PERSON[str(path[1])].model_fields) if path[1] in _OF_PERSON else []
    models: dict[str, tuple[type[BaseModel], ...]] = {
        "subject": (Person, Scan),
        "motion": (Motion,),
        "held_out": (SceneCamera,),
    }
    return [n for m in models.get(top, ()) for n in m.model_fields]
