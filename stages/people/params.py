"""Settings of the people stage: none."""

from posegaussian.stages.contract.declaration import Params


class PeopleParams(Params):
    """Nothing to set."""
