"""What people extend takes one new file and one registration: a made-up one of each kind, in a copy of the package.

The copy is a folder of its own, imported by processes of its own, so what is seen there follows from these files alone.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from tests.support.pipeline import film

ROOT = Path(__file__).resolve().parent.parent
PARTS = ("dags", "stages", "storage")


class Recipe(NamedTuple):
    """One addition: a file, and its entry in a registry."""

    file: str
    text: str
    registry: str = ""
    imported: str = ""
    behind: str = ""
    """Name of the entry that it follows."""


RECIPES = {
    "depth method": Recipe(
        "stages/depth/methods/flat.py",
        """
import numpy as np

from posegaussian.stages.depth.methods.declaration import DepthMethod


def _maps(inputs, params, view):
    depth = np.where(inputs.read("frames/mask", view) > 127, np.float32(2.5), np.float32(0))
    return depth, depth > 0


METHOD = DepthMethod("flat", "a plane 2.5 m away", of_view=_maps)
""",
        "stages/depth/methods/registry.py",
        "from posegaussian.stages.depth.methods.flat import METHOD as FLAT",
        "TRUTH",
    ),
    "metric": Recipe(
        "stages/metrics/measures/mean_error.py",
        """
import numpy as np

from posegaussian.stages.metrics.measures.declaration import Metric

METRIC = Metric(
    "mean_error",
    "Mean error",
    "1/255",
    "lower",
    lambda settings: "mean of the absolute differences",
    bytes_a_pixel=50,
    of_region=lambda pictures, settings: float(np.abs(pictures.picture - pictures.truth).mean()),
    traded=True,
)
""",
        "stages/metrics/measures/registry.py",
        "from posegaussian.stages.metrics.measures.mean_error import METRIC as MEAN_ERROR",
        "LPIPS_VGG",
    ),
    "survey measure": Recipe(
        "stages/survey/measures/brightness.py",
        """
import numpy as np

from posegaussian.stages.contract.io import Block
from posegaussian.stages.survey.algorithms.look import Look
from posegaussian.stages.survey.measures.declaration import Measure
from posegaussian.storage.model.spec import ArraySpec

NAME = "survey/brightness"


class BrightnessLook(Look):
    def __init__(self, s):
        self.numbers, self._view, self._found = s.few, s.view, []

    def see(self, number, picture, shown):
        self._found.append(shown.mean())

    def blocks(self):
        yield Block(NAME, np.array([np.mean(self._found)]), self._view)


MEASURE = Measure(
    (ArraySpec(NAME, ("view", "one"), "float64", "1/255", "Mean of the pictures.", when=NAME, noted=True),),
    BrightnessLook,
)
""",
        "stages/survey/measures/registry.py",
        "from posegaussian.stages.survey.measures.brightness import MEASURE as BRIGHTNESS",
        "JOINT_FIT",
    ),
    "effect": Recipe(
        "stages/frames/dimming.py",
        """
from posegaussian.stages.contract.declaration import Decision, Effect


def _decide(evidence, bound):
    if "survey/brightness" not in evidence.noted:
        return None
    mean = float(evidence.noted["survey/brightness"].mean())
    return Decision(mean > bound, mean, bound, f"pictures are {mean:.0f}/255 on the mean")


DIMMING = Effect(
    "dimming", "Darken the pictures.", "mean", 0.5, "of 255", _decide, asks=("survey/brightness",)
)
""",
        "stages/frames/stage.py",
        "from posegaussian.stages.frames.dimming import DIMMING",
        "TONE_MAPPING",
    ),
    "importer": Recipe(
        "storage/importers/shots.py",
        """
from posegaussian.storage.importers import images
from posegaussian.storage.importers.declaration import Importer, Trait


def find(source, options):
    return images.find(source / "capture", options)


IMPORTER = Importer(
    "shots",
    "A folder with shots.txt and a capture in it.",
    images.ImagesOptions,
    find,
    (Trait("shots.txt", lambda base: (base / "shots.txt").is_file()),),
)
""",
        "storage/importers/registry.py",
        "from posegaussian.storage.importers.shots import IMPORTER as SHOTS",
        "IMAGES",
    ),
    "layout to export": Recipe(
        "storage/exporters/layouts/listing.py",
        """
from posegaussian.storage.exporters.layouts.declaration import Layout


def write(folder, recording):
    (folder / "cameras.txt").write_text("\\n".join(recording.rig.names))


LAYOUT = Layout("listing", "images, masks and the names of cameras.", write)
""",
        "storage/exporters/layouts/registry.py",
        "from posegaussian.storage.exporters.layouts.listing import LAYOUT as LISTING",
        "IMAGES",
    ),
    "simulator effect": Recipe(
        "stages/simulator/effects/raised_cameras.py",
        '''
import dataclasses

import numpy as np
from pydantic import Field

from posegaussian.stages.contract.declaration import Effect
from posegaussian.stages.simulator.effects.base import EffectParams, SceneEffect, above
from posegaussian.storage.model.cameras import rigid


class RaisedCameras(EffectParams):
    """How much."""

    metres: float = Field(0.1, ge=0, description="By how much cameras are written down too high.")


def _decide(evidence, bound):
    return above(evidence.params.metres, bound, f"cameras are {evidence.params.metres:g} m too high")


def apply(rig, params, seed):
    """The cameras as written down."""
    up = np.array([0, 0, params.metres])
    poses = [rigid(r, -r @ (c + up)) for r, c in zip(rig.rotations, rig.centres, strict=True)]
    return dataclasses.replace(rig, world_to_camera=np.stack(poses))


EFFECT = SceneEffect(
    Effect("raised_cameras", "Write cameras down too high.", "height", 0.0, "m", _decide),
    RaisedCameras,
    "calibration",
    "posegaussian.stages.simulator.effects.raised_cameras:apply",
    0.0,
)
''',
        "stages/simulator/effects/registry.py",
        "from posegaussian.stages.simulator.effects.raised_cameras import EFFECT as RAISED_CAMERAS",
        "CALIBRATION_ERROR",
    ),
    "scene": Recipe(
        "dags/simulation/scenes/lone_pair.yaml",
        """
seed: 1
frames: 1
motion: stand
rig: {kind: ring, cameras: 2, size: [16, 16], fill: 0.88}
effects: {raised_cameras: {metres: 0.25}}
""",
    ),
}


class Copy(NamedTuple):
    """A copy of the package with all recipes, and what it sees."""

    folder: Path

    def _started(self, *words: str) -> subprocess.CompletedProcess[str]:
        # Compiling a kernel takes seconds; the few pixels here are as quick without.
        env = {**os.environ, "PYTHONPATH": str(self.folder), "NUMBA_DISABLE_JIT": "1", "COLUMNS": "200"}
        return subprocess.run([sys.executable, *words], cwd=self.folder, env=env, capture_output=True, text=True)

    def python(self, code: str) -> Any:
        """What `code` leaves in `out`, as JSON."""
        done = self._started("-c", f"import json, sys\n{code}\nprint(json.dumps(out))")
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)

    def command(self, *words: str, status: int = 0) -> str:
        """What a command prints."""
        done = self._started("-m", "posegaussian.dags.cli.app", *words)
        assert done.returncode == status, done.stdout + done.stderr
        return done.stdout + done.stderr


def added(package: Path, recipe: Recipe) -> None:
    """Follow a recipe: write the file; in the registry, import what it declares and name it where the others are."""
    file = package / recipe.file
    assert not file.exists()
    file.write_text(recipe.text.lstrip())
    if recipe.registry:
        registry = package / recipe.registry
        text, name = registry.read_text(), recipe.imported.split()[-1]
        first, place = text.index("from posegaussian"), text.rindex(recipe.behind) + len(recipe.behind)
        registry.write_text(f"{text[:first]}{recipe.imported}\n{text[first:place]}, {name}{text[place:]}")


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Copy:
    folder = tmp_path_factory.mktemp("copy")
    package = folder / "posegaussian"
    package.mkdir()
    shutil.copy(ROOT / "posegaussian" / "__init__.py", package)
    for part in PARTS:
        shutil.copytree(ROOT / part, package / part, ignore=shutil.ignore_patterns("__pycache__"))
    for recipe in RECIPES.values():
        added(package, recipe)
    return Copy(folder)


def files(folder: Path) -> Iterator[str]:
    for part in PARTS:
        for f in (folder / part).rglob("*"):
            if f.is_file() and "__pycache__" not in f.parts:
                yield f.relative_to(folder).as_posix()


def test_each_is_one_new_file_and_one_registration(copy: Copy) -> None:
    package = copy.folder / "posegaussian"
    before, after = set(files(ROOT)), set(files(package))
    assert after - before == {r.file for r in RECIPES.values()}
    assert not before - after
    changed = {f for f in before if (ROOT / f).read_bytes() != (package / f).read_bytes()}
    assert changed == {r.registry for r in RECIPES.values() if r.registry}


@pytest.fixture(scope="module")
def archive(copy: Copy, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, list[str], str]:
    """(what the import and the run printed, options that mean the archive) of a capture that only `shots` can read."""
    shots = tmp_path_factory.mktemp("shots")
    (shots / "shots.txt").write_text("")
    film(shots / "capture", views=3, size=32, frames=1, held_out=0)
    options = ["--archive", str(shots / "archive"), "--set", "run.scheduler=serial", "--set", "depth.method=flat"]
    said = copy.command("import", "auto", str(shots), "--sequence", "a", *options[:2])
    ran = copy.command("run", *options, "--only", "survey", "--only", "pose", "--only", "frames", "--only", "depth")
    return said, options, ran


def test_a_depth_method(copy: Copy, archive: tuple[str, list[str], str]) -> None:
    _, options, _ = archive
    found = copy.python(
        f"""
from posegaussian.dags.config.settings import Settings
from posegaussian.dags.provenance.code_digest import closure
from posegaussian.stages.registry import stage
from posegaussian.dags.config.settings import load_configuration
from posegaussian.dags.session.session import Session
from posegaussian.dags.planning.results import Results
from rich.console import Console
heavy = sorted({{"numba", "cv2", "torch"}} & sys.modules.keys())
field = stage("depth").params.model_fields["method"]
configuration = load_configuration(None, ["depth.method=flat"])
context = Session(configuration, {options[1]!r}, Console(quiet=True)).context("a", ())
depth = Results(context).read("depth/depth", range(1), 0)
out = {{
    "heavy": heavy,
    "description": field.description,
    "depths": sorted({{float(z) for z in depth.ravel()}}),
    "hashed": [name for name, _ in closure("posegaussian.stages.depth.run")],
}}
"""
    )
    assert found["heavy"] == []
    assert "; flat: a plane 2.5 m away; auto" in found["description"]
    assert found["depths"] == [0.0, 2.5]
    assert "posegaussian.stages.depth.methods.flat" in found["hashed"]
    refused = " ".join(copy.command("plan", *options[:2], "--set", "depth.method=flut", status=2).split())
    assert "depth.method: there is no depth method 'flut'; there are auto, given, relief, sweep" in refused
    assert "flat" in refused
    assert "depth.method flat: depth.method is flat" in copy.command("plan", *options, "-v")


def test_a_metric(copy: Copy) -> None:
    found = copy.python(
        """
import numpy as np
from posegaussian.dags.tradeoff.pareto import QUALITIES
from posegaussian.stages.metrics.params import MetricsParams
from posegaussian.stages.metrics.run import measure
from posegaussian.stages.metrics.stage import STAGE
params = MetricsParams(measures=["mean_error", "psnr"])
white = np.full((4, 4, 3), 255, np.uint8)
values = measure(white - 3, white, np.full((4, 4), 255, np.uint8), params)
try:
    MetricsParams(measures=["mean_eror"])
except ValueError as e:
    refused = str(e)
out = {
    "value": values["box", "mean_error"],
    "title": QUALITIES["mean_error box"].title,
    "axis": QUALITIES["mean_error box"].axis,
    "better": QUALITIES["mean_error full"].better,
    "refused": refused,
    "description": MetricsParams.model_fields["measures"].description,
    "ram": STAGE.needs({"x": 10, "y": 10, "frame": 1, "view": 2}, params).ram,
}
"""
    )
    assert found["value"] == pytest.approx(3.0)
    assert (found["title"], found["axis"]) == ("Mean error in the mask's box", "Mean error, 1/255")
    assert found["better"] == "lower"
    assert "there is no measure 'mean_eror'; there are psnr" in found["refused"]
    assert "mean_error" in found["refused"]
    assert "mean_error" in found["description"]
    assert found["ram"] > 0


def test_a_survey_measure_and_an_effect_that_it_decides(copy: Copy, archive: tuple[str, list[str], str]) -> None:
    _, options, ran = archive
    switched = next(line for line in ran.splitlines() if "switched on by what the frames show" in line)
    assert "dimming" in switched.partition("; off")[0]
    planned = copy.command("plan", *options, "-v")
    (line,) = [line for line in planned.splitlines() if line.startswith("dimming on")]
    assert "/255 on the mean" in line
    off = copy.command("plan", *options, "--set", "effects.dimming=off")
    assert any("dimming" in line and "off (forced)" in line for line in off.splitlines())
    refused = copy.command("plan", *options, "--set", "effects.diming=off", status=2)
    assert 'did you mean "dimming"?' in refused


def test_an_importer(copy: Copy, archive: tuple[str, list[str], str]) -> None:
    assert "layout: shots" in archive[0]
    assert "3 cameras" in archive[0]
    shown = " ".join(copy.command("import", "--help").split())
    assert "images, shots, or auto for the one that fits." in shown
    assert "shots: A folder with shots.txt and a capture in it." in shown


def test_a_layout_to_export(copy: Copy, archive: tuple[str, list[str], str]) -> None:
    assert "listing" in " ".join(copy.command("export", "--help").split())
    refused = copy.command("export", "a", *archive[1], "--to", "listings", status=2)
    assert "export --to listings: unknown layout; known are colmap, nerfstudio, easymocap, images, listing" in refused


def test_an_effect_of_the_simulator_and_a_scene(copy: Copy) -> None:
    assert "lone_pair" in copy.command("simulate", "--help")
    found = copy.python(
        """
from posegaussian.dags.simulation.shipped import scene_file
from posegaussian.dags.simulation.simulate import read_scene
from posegaussian.stages.simulator.scene import known_fields
from posegaussian.stages.simulator.setup import stage
from posegaussian.stages.simulator.wardrobe.actors import Still
import itertools, types
import numpy as np
box = np.array(list(itertools.product((-0.3, 0.3), (-0.3, 0.3), (0.0, 1.8))))
staged = stage(read_scene(scene_file("lone_pair")), Still(types.SimpleNamespace(vertices=box)))
(ruling,) = [r for r in staged.rulings if r.effect.name == "raised_cameras"]
out = {
    "raised": (staged.written.centres - staged.take.rig.centres).round(9).tolist(),
    "why": ruling.decision.reason,
    "known": known_fields(("effects",)),
}
"""
    )
    assert found["raised"] == [[0, 0, 0.25]] * 2
    assert found["why"] == "cameras are 0.25 m too high"
    assert "raised_cameras" in found["known"]
