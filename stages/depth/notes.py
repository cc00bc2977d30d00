"""What a plan says of the depth these settings give with this capture."""

from __future__ import annotations

from posegaussian.stages.camera_paths.gaps import gap_notes
from posegaussian.stages.camera_paths.stretch import stretch_notes
from posegaussian.stages.contract.declaration import Evidence
from posegaussian.stages.depth.params import UNTOLD, resolve_method
from posegaussian.stages.geometry.cone import cone_notes
from posegaussian.stages.geometry.pairs import alone, pair_notes
from posegaussian.stages.geometry.subject import subject_distance


def notes(evidence: Evidence) -> list[str]:
    """Sentences on pairs that are not matched, on what a single source view and views along each other give, on cameras
    that a path between the others leaves out, and on gaps that a path crosses."""
    params, rig, sources = evidence.params, evidence.rig, evidence.sources
    method = resolve_method(params, evidence.facts)
    paths = {path.name: path for path in evidence.targets}
    found = pair_notes(rig, sources, params.max_angle) if method.rectifies else []
    if len(sources) == 1:
        distance = subject_distance(rig, sources[0], params.subject_distance)
        found += cone_notes(rig, sources[0], distance, method.alone_note(distance), method.useful_angle, paths)
    if method.several and (untold := alone(rig, sources, params.max_angle)):
        found.append(f"{', '.join(rig.names[v] for v in untold)}: {UNTOLD}")
    return [
        *found,
        *stretch_notes(rig, sources, params.max_angle, paths),
        *gap_notes(rig, sources, params.max_angle, paths),
    ]
