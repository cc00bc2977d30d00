"""What one should know before using weights: their card, which lies in the file. Nothing here imports torch."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from pydantic import TypeAdapter, ValidationError

from posegaussian.storage.model.documents import parse_json, regular, shortened
from posegaussian.storage.model.errors import UserError

SHIPPED = Path(__file__).resolve().parent / "shipped"
"""Folder of the weights that come with the project, NAME.safetensors each."""


class WeightsError(UserError):
    """A file of weights that cannot be written or does not fit the network."""


@dataclass(frozen=True)
class Card:
    """What one should know before using weights."""

    name: str
    """Of the weights."""
    preset: str
    """Of the network: paper, base, fast."""
    network: str
    """Its whole shape, JSON of `posegaussian.stages.network.model.presets.Preset`: what a network of these weights
    is built from."""
    iterations: int
    """Most steps of refinement it was trained with."""
    data: str
    """What they were trained on, in a sentence."""
    seeds: str
    """Of the training scenes and of the training."""
    minutes: float
    """Of training."""
    machine: str
    """That trained."""
    validation: tuple[tuple[str, ...], ...]
    """A table: a head and rows, all of one length."""
    not_good_for: tuple[str, ...] = field(default=())
    """Sentences."""

    def markdown(self, digest: str) -> str:
        """The card as a page; digest is the file's sha256."""
        facts = {
            "preset": self.preset,
            "iterations": str(self.iterations),
            "data": self.data,
            "seeds": self.seeds,
            "minutes of training": f"{self.minutes:g}",
            "machine": self.machine,
            "sha256": digest,
        }
        lines = [f"# {self.name}", "", *(f"- **{k}**: {v}" for k, v in facts.items()), "", "## Validation", ""]
        for i, row in enumerate(self.validation):
            lines += [f"| {' | '.join(row)} |", *(["|" + " --- |" * len(row)] if i == 0 else [])]
        return "\n".join([*lines, "", "## Not good for", "", *(f"- {s}" for s in self.not_good_for)]) + "\n"


def read_card(path: Path) -> Card:
    """The card within a file of weights. Raises WeightsError where there is no such file or card."""
    from safetensors import SafetensorError, safe_open  # a plan without a network needs none

    must_exist(path)
    try:
        with safe_open(path, framework="numpy") as f:
            return TypeAdapter(Card).validate_python(parse_json((f.metadata() or {})["card"], f"the card of {path}"))
    except (SafetensorError, KeyError, UnicodeDecodeError, ValidationError) as e:
        raise WeightsError(
            f"{path} is no safetensors file with a card ({shortened(e, 300)}); write it with save_weights"
        ) from e


def must_exist(path: Path) -> None:
    """Raise WeightsError for a path that is no file, SourceError for what is no regular one."""
    if not path.exists():
        raise WeightsError(f"{path}: no such file of weights")
    regular(path, "weights")


def shipped() -> dict[str, Path]:
    """Weights that come with the project, by name."""
    return {f.stem: f for f in sorted(SHIPPED.glob("*.safetensors"))}
