"""`posegaussian simulate`: a scene file becomes a sequence that runs; bad scenes get a sentence with file and line."""

import json
from pathlib import Path

import numpy as np
import pytest
import zarr
from rich.console import Console

from posegaussian.dags.config.settings import load_configuration
from posegaussian.dags.planning.effects import judged
from posegaussian.dags.session.session import Session
from posegaussian.dags.simulation.shipped import SCENES, scene_file
from posegaussian.dags.simulation.simulate import (
    effects_plan,
    film,
    read_scene,
    simulate,
    stage_scene,
)
from posegaussian.stages.contract.io import Views
from posegaussian.stages.simulator.effects.registry import EFFECTS
from posegaussian.storage.model.errors import ArchiveError, ConfigError, SourceError
from posegaussian.storage.readers.images import read_mask, read_picture, write_png
from tests.support.pipeline import Pipeline
from tests.support.pipeline import film as film_person

SMALL = """\
seed: 3
frames: 3
motion: {name: kick, phase: 0.1}
rig: {cameras: 4, size: [48, 64]}
held_out: 1
effects:
  ambient_occlusion: {directions: 8}
  dropped_frames: {share: 0.4}
  sensor_noise: on
  joint_noise: on
"""


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "scene.yaml"
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            "effects:\n  lens_distorsion: on\n",
            'scene.yaml:2:3 effects.lens_distorsion: unknown effect; did you mean "lens_distortion"?',
        ),
        (
            "effects:\n  fog: on\n",
            "scene.yaml:2:3 effects.fog: unknown effect; known are lens_distortion, calibration_error",
        ),
        (
            "seed: 1\neffects:\n  sensor_noise: {electrons: -3}\n",
            "scene.yaml:3:18 effects.sensor_noise.electrons: input should be greater than 0, got -3",
        ),
        ("effects:\n  jpeg: maybe\n", "scene.yaml:2:3 effects.jpeg"),
        (
            "rig: {kind: list, cameras: [{name: a, position: [2, 0, 1]},\n  {name: b, position: [0.1, 0, 1]}]}\n",
            "scene.yaml:2:3 rig.cameras.1: camera b at (0.1, 0.0, 1.0) is inside the body",
        ),
        (
            "rig: {radius: 0.2}\n",
            "scene.yaml:1:7 rig.radius: cameras 0.2 m from the subject's axis are inside the body",
        ),
        ("rig: {kind: list, cameras: []}\n", "scene.yaml:1:19 rig.cameras: list should have at least 1 item"),
        ("rig: {cameras: 0}\n", "scene.yaml:1:7 rig.cameras: input should be greater than or equal to 1, got 0"),
        ("rig:\n  kind: circle\n", "scene.yaml:1:1 rig: there is no such kind of rig; there are ring, arc"),
        ("rig:\n  kind: arc\n  spann: 20\n", 'scene.yaml:3:3 rig.spann: unknown key; did you mean "span"?'),
        ("motion: moonwalk\n", "scene.yaml:1:1 motion: there is no motion 'moonwalk'; there are stand, walk"),
        ("motion:\n  name: moonwalk\n", "scene.yaml:2:3 motion.name: there is no motion 'moonwalk'"),
        (
            "seed: 5\nsubject: {person: gao}\n",
            (
                "scene.yaml:2:11 subject.person: gao is kept for measuring and appears only in scenes with a seed from"
                " 9000 on; this seed is 5"
            ),
        ),
        ("held_out: 9\n", "scene.yaml:1:1 held_out: 9 held-out cameras between 8 cameras"),
        ("frame: 3\n", 'scene.yaml:1:1 frame: unknown key; did you mean "frames"?'),
    ],
)
def test_a_bad_scene_gets_a_sentence_with_file_and_line(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(ConfigError) as e:
        read_scene(write(tmp_path, text))
    assert said in str(e.value).replace(str(tmp_path) + "/", "")


def test_all_faults_are_told_at_once(tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as e:
        read_scene(write(tmp_path, "frames: 0\nmotion: {speed: -1}\nrig: {focal: .nan}\n"))
    assert len(str(e.value).splitlines()) == 3


def test_scenes_that_ship_are_valid_and_found_by_name() -> None:
    names = {f.stem for f in SCENES.glob("*.yaml")}
    assert names == {
        "demo",
        "plain",
        "fast_motion",
        "self_occlusion",
        "messy",
        "sparse_6",
        "dense_16",
        "single_pair",
        "two_people",
        "passing",
    }
    for name in names:
        scene = read_scene(scene_file(name))
        assert scene.seed < 9000
    with pytest.raises(ConfigError, match="neither a file nor one of those that ship, demo, dense_16"):
        scene_file("nothing")


def test_a_missing_or_broken_scan_is_named(tmp_path: Path) -> None:
    scene = read_scene(write(tmp_path, "subject: {obj: body.obj}\n"))
    with pytest.raises(SourceError, match=r"cannot read scan .*body\.obj"):
        stage_scene(scene, tmp_path)
    (tmp_path / "body.obj").write_text("v 0 0 0\nv 1 x 3\n")
    with pytest.raises(SourceError, match=r"body\.obj: line 2"):
        stage_scene(scene, tmp_path)


@pytest.mark.parametrize("named", ["../m.mtl", "/etc/m.mtl", "in/../../m.mtl"])
def test_a_scan_leads_to_no_file_outside_its_folder(tmp_path: Path, named: str) -> None:
    folder = tmp_path / "scan"
    (folder / "in").mkdir(parents=True)
    scene = read_scene(write(folder, "subject: {obj: body.obj}\n"))
    square = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
    refused = rf"body\.obj: it names '{named}', outside its folder; copy that file beside the scan"
    for file in (folder / "m.mtl", tmp_path / "m.mtl"):
        file.write_text("newmtl a\n")
    (folder / "body.obj").write_text(f"mtllib {named}\n{square}")
    with pytest.raises(SourceError, match=refused):
        stage_scene(scene, folder)
    (folder / "m.mtl").write_text(f"newmtl a\nmap_Kd {named}\n")
    (folder / "body.obj").write_text(f"mtllib in/.././m.mtl\n{square}")
    with pytest.raises(SourceError, match=refused):
        stage_scene(scene, folder)
    (folder / "m.mtl").write_text("newmtl a\n")
    stage_scene(scene, folder)


def test_a_scan_is_aligned_stood_upright_and_textured(tmp_path: Path) -> None:
    """A plate 2 units high whose fit says scale 2 and an offset:
    y is up, red on its upper half, blue on its lower half."""
    v = np.array([[-0.5, -1, 0], [0.5, -1, 0], [0.5, 1, 0], [-0.5, 1, 0]]) + np.array([30.0, -7.0, 4.0])
    lines = [
        "mtllib scan.mtl",
        *(f"v {x} {y} {z}" for x, y, z in v),
        "vt 0 0",
        "vt 1 0",
        "vt 1 1",
        "vt 0 1",
        "f 1/1 2/2 3/3 4/4",
    ]
    (tmp_path / "scan.obj").write_text("\n".join(lines))
    (tmp_path / "scan.mtl").write_text("newmtl a\nmap_Kd material0.png\n")
    picture = np.zeros((64, 32, 3), np.uint8)
    picture[:32, :, 0], picture[32:, :, 2] = 220, 220
    write_png(tmp_path / "material0.png", picture)
    scene = write(
        tmp_path,
        "subject: {obj: scan.obj, translation: [30, -7, 4], scale: 2}\nrig: {cameras: 4, size: [64, 96], fill: 0.5,"
        " radius: 3, height: 0.5}\n",
    )
    staged = stage_scene(read_scene(scene), tmp_path)
    v = staged.take.actors[0].mesh.vertices
    np.testing.assert_allclose((v.min(axis=0), v.max(axis=0)), ([0, -0.25, 0], [0, 0.25, 1]), atol=1e-12)
    shot = staged.take.shoot(0, 0)
    rows = np.nonzero(shot.true_mask[:, 32])[0]
    assert len(rows) == pytest.approx(48, abs=2), "one metre fills half the height"
    assert shot.color[rows[5], 32, 0] > 60 > shot.color[rows[5], 32, 2]
    assert shot.color[rows[-5], 32, 2] > 60 > shot.color[rows[-5], 32, 0]
    assert shot.joints2d is None
    np.testing.assert_allclose(shot.depth[rows, 32], 3.0, atol=1e-5)


def asked(archive: Path, *words: str) -> str:
    """What a command says of the simulated sequence, without its configuration."""
    from typer.testing import CliRunner

    from posegaussian.dags.cli.app import app

    done = CliRunner().invoke(app, [*words, "--archive", str(archive), "--set", "run.scheduler=serial"])
    assert done.exit_code == 0, (done.output, done.exception)
    return done.output


def test_every_command_knows_the_held_out_cameras_and_says_so(
    simulated: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    archive, _ = simulated
    monkeypatch.chdir(tmp_path)
    line = "held out as imported: mid00 (of kick); views.held_out overrules it"
    for words in (("plan",), ("status",), ("run", "--only", "survey", "--set", "frames.range=0:1")):
        assert asked(archive, *words).count(line) == 1, words
    assert "held out" not in asked(archive, "status", "--set", "views.held_out=[cam01]")

    def views(*settings: str) -> Views:
        return (
            Session(load_configuration(None, [*settings], folder=tmp_path), str(archive), Console(quiet=True))
            .context("kick")
            .views
        )

    assert views() == Views(("cam00", "cam01", "cam02", "cam03", "mid00"), (0, 1, 2, 3), (4,))
    assert views("views.held_out=[cam01]").held_out == (1,)
    assert views("views.held_out=[]").sources == (0, 1, 2, 3, 4)
    assert views("views.sources=[cam00, cam01, mid00]") == Views(views().names, (0, 1, 4), ())


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    root = tmp_path_factory.mktemp("simulated")
    scene = write(root, SMALL)
    session = Session(load_configuration(None, [], folder=root), str(root / "archive"), Console(quiet=True))
    simulate(session, scene, "kick", Console(quiet=True), threads=2)
    return root / "archive", scene


def test_the_sequence_is_planned_with_its_held_out_camera_and_its_truth(simulated: tuple[Path, Path]) -> None:
    archive, _ = simulated
    folder = archive / "_captures" / "kick"
    session = Session(
        load_configuration(None, ["run.scheduler=serial"], folder=folder), str(archive), Console(quiet=True)
    )
    context = session.context("kick")
    assert context.capture.rig.names == ("cam00", "cam01", "cam02", "cam03", "mid00")
    assert context.views.held_out == (4,)
    assert {"masks", "joints2d", "held_out", "truth_depth", "several_frames"} <= set(context.capture_facts)
    assert not context.valid.all(), "frames were dropped"
    sequence = context.sequence
    mask, normal = sequence.get("truth/mask"), sequence.get("truth/normal")
    assert mask.shape == (3, 5, 64, 48)
    assert normal.shape == (*mask.shape, 3)
    for f, v in ((0, 0), (2, 4)):
        np.testing.assert_array_equal(
            read_mask(folder / "masks" / context.capture.rig.names[v] / f"{f:06d}.png"), mask[f, v]
        )
    joints2d, joints3d = sequence.get("truth/joints2d"), sequence.get("truth/joints3d")
    camera = joints3d[0, :, :3] @ context.capture.rig.rotations[1].T + context.capture.rig.world_to_camera[1, :3, 3]
    uv = camera @ context.capture.rig.intrinsics[1].T
    np.testing.assert_allclose(uv[:, :2] / uv[:, 2:], joints2d[0, 1, :, :2], atol=1e-3)
    assert (read_picture(folder / "images" / "cam00" / "000000.png") > 0).any()
    assert judged(context.evidence, context.settings.effects)
    held_out = {
        k: sequence.get(f"truth/held_out/{k}") for k in ("color", "depth", "mask", "intrinsics", "world_to_camera")
    }
    np.testing.assert_array_equal(held_out["mask"], mask[:, 4:])
    np.testing.assert_array_equal(held_out["color"][1, 0], read_picture(folder / "images" / "mid00" / "000001.png"))
    np.testing.assert_array_equal(held_out["depth"] > 0, normal[:, 4:].any(axis=-1))
    np.testing.assert_array_equal(held_out["intrinsics"], context.capture.rig.intrinsics[4:])
    assert zarr.open_array(sequence.root / "truth/normal", mode="r").chunks == (1, 1, 64, 48, 3), "a picture at a time"
    assert not [f for f in folder.rglob("*") if f.is_file() and f.suffix not in (".png", ".exr", ".json", ".yaml")], (
        "nothing is left behind"
    )


def test_pictures_shot_in_parts_are_the_same_capture(
    simulated: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    archive, path = simulated
    monkeypatch.setattr("posegaussian.dags.simulation.simulate.SHOTS_AT_ONCE", 2)
    scene = read_scene(path)
    truth = film(scene, stage_scene(scene, path.parent), tmp_path, threads=1)
    for f in ("joints/cam02.json", "depth/cam01/000002.exr", "cameras.json"):
        assert (tmp_path / f).read_bytes() == (archive / "_captures" / "kick" / f).read_bytes()
    assert truth["normal"].any(axis=(2, 3, 4))[:, 4].all()


def test_one_and_two_threads_write_the_same_bytes(simulated: tuple[Path, Path], tmp_path: Path) -> None:
    archive, path = simulated
    scene = read_scene(path)
    film(scene, stage_scene(scene, path.parent), tmp_path, threads=1)
    first = archive / "_captures" / "kick"
    files = sorted(f.relative_to(tmp_path) for f in tmp_path.rglob("*.*") if f.is_file())
    assert len(files) > 40
    for f in files:
        assert (tmp_path / f).read_bytes() == (first / f).read_bytes(), f


def test_cameras_of_a_scene_come_back_from_its_file(simulated: tuple[Path, Path]) -> None:
    archive, path = simulated
    entries = json.loads((archive / "_captures" / "kick" / "cameras.json").read_text())["cameras"]
    staged = stage_scene(read_scene(path), path.parent)
    np.testing.assert_array_equal([c["K"] for c in entries], staged.written.intrinsics)


def test_the_plan_says_on_or_off_why_and_what_it_costs(simulated: tuple[Path, Path]) -> None:
    scene = read_scene(simulated[1])
    console = Console(record=True, width=140, quiet=False, file=open("/dev/null", "w"))  # noqa: SIM115
    console.print(effects_plan("kick", scene, stage_scene(scene, Path()).rulings))
    text = console.export_text()
    for e in EFFECTS:
        assert e.name in text
    assert "mid-grey varies by" in text
    assert "the scene does not call for it" in text
    assert "saves" in text
    assert "spends" in text


def test_a_name_that_is_taken_is_refused_before_anything_is_filmed(tmp_path: Path) -> None:
    film_person(tmp_path / "capture", views=2, frames=1, held_out=0)
    taken = Pipeline(tmp_path / "archive", tmp_path / "capture")
    taken.register()
    with pytest.raises(
        ArchiveError,
        match=r"sequence person is there already: layout images, 2 cameras .*; scene scene\.yaml is another capture",
    ):
        simulate(taken.session, write(tmp_path, SMALL), "person", Console(quiet=True), threads=1)
    assert not (taken.root / "_captures").exists()
