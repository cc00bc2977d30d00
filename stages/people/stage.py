"""Declaration of the people stage."""

from __future__ import annotations

from posegaussian.stages.contract.declaration import Read, Resources, Stage, Typical
from posegaussian.stages.contract.facts import TRACKED, Facts
from posegaussian.stages.people.params import PeopleParams
from posegaussian.storage.model.spec import ArraySpec, Shape


def needs(shape: Shape, params: PeopleParams) -> Resources:
    """Who is who in the whole sequence."""
    return Resources(cpu=1, ram=shape["moment"] * shape["view"] * 64 + 2**20)


def unneeded(params: PeopleParams, facts: Facts) -> str | None:
    """Where nobody is followed there is nothing to cut."""
    return None if TRACKED in facts else "nobody has to be told from others"


STAGE = Stage(
    name="people",
    summary="Say of each partition's people who they are, so that later stages read their part alone.",
    version=1,
    run="posegaussian.stages.people.run:run",
    reads=(Read("tracks/people"),),
    writes=(
        ArraySpec(
            "people/number",
            ("frame", "view", "candidate"),
            "int16",
            "1",
            "Who each person found in a picture is: 0 is person1; -1 nobody who is followed.",
        ),
    ),
    over=("sequence", "time"),
    params=PeopleParams,
    needs=needs,
    typical=Typical(seconds=1e-8),
    unneeded=unneeded,
)
