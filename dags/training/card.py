"""The card of trained weights: what they were trained on, for how long,
how they measured, what they are not good for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from posegaussian.dags.humanize.text import number
from posegaussian.dags.training.run_folder import skipped
from posegaussian.stages.training.config import SHAPE, TrainingConfig

if TYPE_CHECKING:
    from posegaussian.stages.network.card import Card

VARIANTS = (*SHAPE, "fusion", "pose_in", "rotation_head", "opacity_head", "normalisation", "downsampling", "residual")
"""Settings in which a network may differ from its preset."""


def name(config: TrainingConfig) -> str:
    """`posegaussian-fast`, with the variants that were chosen."""
    plain = TrainingConfig(preset=config.preset)
    chosen = {k: getattr(config, k) for k in VARIANTS if getattr(config, k) != getattr(plain, k)}
    said = [f"{k}={'+'.join(v) if isinstance(v, tuple) else v}" for k, v in chosen.items()]
    return "-".join([f"posegaussian-{config.preset}", *said])


def card(config: TrainingConfig, step: int, machines: Mapping[str, float], rows: Sequence[Mapping[str, Any]]) -> Card:
    """The card at a step; `machines` is {machine: minutes}, `rows` the log, whose last validation is shown beside
    the first one."""
    from posegaussian.stages.network.card import Card

    scenes, held = config.scenes, config.validation
    data = (
        f"{number(scenes.count, 'simulated scene')} with {number(config.frames_per_scene, 'frame')} each, filmed at"
        f" {config.size} px by rings of {' or '.join(map(str, config.cameras))} cameras and arcs that lean; crops of"
        f" {config.crop} px, {number(config.batch, 'pair')} a step, over {' or '.join(_starts(config))}; step {step} of"
        f" {config.steps}" + (f"; {skipped_told(lost, step)}" if (lost := skipped(rows)) else "")
    )
    start = f", continued from {config.start}" if config.start else ""
    return Card(
        name=name(config),
        preset=config.preset,
        network=config.network().as_json(),
        iterations=config.iterations,
        data=data,
        seeds=(
            f"training scenes {scenes.first} to {scenes.end - 1}, validation scenes {held.first} to {held.end - 1},"
            f" training {config.seed}{start}"
        ),
        minutes=round(sum(machines.values()), 1),
        machine="; ".join(f"{machine} ({minutes:.0f} min)" for machine, minutes in machines.items()),
        validation=_table([r for r in rows if r["kind"] == "validation"]),
        not_good_for=(
            "Depth without a start: they refine one, and know nothing else.",
            f"Pairs of more than {config.network().widest:.0f} degrees; those are left to the analytic floor.",
            "Claims about real captures: people, clothes, light and cameras they were trained on are simulated.",
            f"More than {config.iterations} iterations; they were trained with 1 to {config.iterations}.",
            *([f"A final judgement: training was at step {step} of {config.steps}."] if step < config.steps else []),
        ),
    )


def skipped_told(count: int, steps: int) -> str:
    """That so many of the steps changed no weight."""
    return f"{count} of {number(steps, 'step')} were skipped, their loss was not finite"


def _starts(config: TrainingConfig) -> list[str]:
    """What examples start from."""
    shares = config.starts
    return [
        *(config.methods if shares.matched else ()),
        *(["the hull"] if shares.hull else ()),
        *(["true depth with and without noise"] if shares.noisy + shares.truth else ()),
        *(["reliefs of views alone"] if config.single else ()),
    ]


def _table(validations: Sequence[Mapping[str, Any]]) -> tuple[tuple[str, ...], ...]:
    """One row a measure: at the first validation and at the last one."""
    first, last = validations[0], validations[-1]
    shown = [last] if first is last else [first, last]
    head = ("measure", *(f"step {v['step']}" for v in shown))
    return (head, *((key, *(_text(v.get(key)) for v in shown)) for key in last if key not in ("kind", "step")))


def _text(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, int | float) else "none"
