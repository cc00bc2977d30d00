"""The page in a real browser: it plays, it is steered, and its pictures are our renderer's."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from posegaussian.dags.export import page
from posegaussian.dags.export.background import parse
from posegaussian.dags.planning.results import Results
from posegaussian.stages.rendering.lift import GaussianMaps, lift
from posegaussian.stages.splatting.quaternions import rotations
from posegaussian.storage.exporters.page import maps as coding
from posegaussian.storage.exporters.page.document import write_page
from posegaussian.storage.exporters.page.maps import coded
from posegaussian.storage.model.cameras import rigid
from tests.dags.export.test_exporting_page import head_of
from tests.storage.exporters.test_page import HOSTILE, maps
from tests.support.browser import Browser, sized
from tests.support.drawn import camera_of, decoded_picture, drawn, person_psnr
from tests.support.pipeline import Pipeline, film

SIDE = 128
LEAST = 38.0
"""dB over the person; 42 to 48 are measured."""


@dataclass
class Made:
    results: Results
    file: Path


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with Browser(800, 700) as opened:
        yield opened


@pytest.fixture(scope="module")
def made(browser: Browser, tmp_path_factory: pytest.TempPathFactory) -> Made:
    folder = tmp_path_factory.mktemp("page")
    film(folder / "capture", views=4, size=SIDE, frames=4)
    pipeline = Pipeline(folder / "archive", folder / "capture", ["depth.method=truth", "rendering.paths=[]"])
    pipeline.register()
    pipeline.run()
    results = Results(pipeline.context())
    said = page.export_page(results, (), folder / "person.html", "orbit", parse("#000000"))
    assert "4 frames" in said[0]
    return Made(results, folder / "person.html")


@pytest.fixture
def opened(browser: Browser, made: Made) -> Browser:
    start(browser, made.file)
    return browser


def start(browser: Browser, file: Path) -> None:
    browser.resize(800, 700)
    browser.open(file)
    browser.wait("document.getElementById('message').hidden")


def silent(browser: Browser) -> None:
    """Nothing went wrong, and nothing was asked for but the file and its own worker."""
    assert browser.complaints == []
    assert {address.partition(":")[0] for address in browser.requests} <= {"file", "blob", "data"}
    assert len([address for address in browser.requests if address.startswith("file:")]) == 1


def test_pictures_are_our_renderers(opened: Browser, made: Made) -> None:
    assert opened.run("posegaussian.renderer.gl.isContextLost()") is False
    sized(opened, SIDE, SIDE)
    for step, code in (
        (0, "0"),
        (1, "posegaussian.choose(2)"),  # a source camera
        (2, "posegaussian.move(orbited(posegaussian.camera, posegaussian.target, posegaussian.head.up, 0.3, -0.2))"),
        (3, "posegaussian.move(dollied(posegaussian.camera, posegaussian.target, 2))"),  # averaged down
        (3, "posegaussian.move(dollied(posegaussian.camera, posegaussian.target, 0.5))"),
    ):
        opened.run(f"posegaussian.choose(0), posegaussian.seek({step}), {code}")
        picture = decoded_picture(opened)
        reference = drawn(made.results, opened.run("posegaussian.frame"), camera_of(opened))
        assert picture.shape == reference.shape
        assert (reference > 20).any(axis=-1).mean() > 0.02, "somebody is there"
        assert person_psnr(picture, reference) > LEAST, (step, code)
    opened.run("posegaussian.head.allSides = true, posegaussian.choose(0)")
    picture = decoded_picture(opened)
    assert person_psnr(picture, drawn(made.results, 3, camera_of(opened), refined=True)) > LEAST
    assert person_psnr(picture, drawn(made.results, 3, camera_of(opened))) < LEAST
    silent(opened)


def test_it_plays_and_is_scrubbed(opened: Browser) -> None:
    first = decoded_picture(opened)
    opened.run("document.getElementById('play').click()")
    for step in (1, 2, 3, 0):
        opened.wait(f"posegaussian.step === {step}")
    opened.key(" ")
    assert opened.run("posegaussian.playing") is False
    opened.run("const bar = document.getElementById('scrub'); bar.value = 2; bar.dispatchEvent(new Event('input'))")
    second = decoded_picture(opened)
    assert opened.run("document.getElementById('time').textContent").startswith("frame 2 ")
    assert (first != second).any(axis=-1).mean() > 0.01
    opened.key("Home")
    np.testing.assert_array_equal(decoded_picture(opened), first)
    opened.key("ArrowLeft")
    assert opened.run("posegaussian.step") == 3
    opened.key("]")
    assert opened.run("posegaussian.speed") == 2
    silent(opened)


def test_mouse_and_touch_steer(opened: Browser) -> None:
    before = decoded_picture(opened)
    opened.pointer("mousePressed", 300, 300, button="left", buttons=1, clickCount=1)
    opened.pointer("mouseMoved", 420, 280, button="left", buttons=1)
    opened.pointer("mouseReleased", 420, 280, button="left")
    turned = decoded_picture(opened)
    assert (before != turned).any(axis=-1).mean() > 0.01
    assert opened.run("document.getElementById('camera').value") == "free"
    away = "Math.hypot(...minus(centreOf(posegaussian.camera.pose), posegaussian.target))"
    far = opened.run(away)
    assert far == pytest.approx(opened.run("posegaussian.distance"))  # an orbit keeps it
    opened.pointer("mouseWheel", 300, 300, deltaX=0, deltaY=-200)
    near = opened.run(away)
    assert near < 0.9 * far
    for kind, x in (("touchStart", 100), ("touchMove", 40), ("touchEnd", None)):
        points = [] if x is None else [{"x": 300 - x, "y": 300, "id": 0}, {"x": 300 + x, "y": 300, "id": 1}]
        opened.call("Input.dispatchTouchEvent", type=kind, touchPoints=points)
    assert opened.run(away) > 1.5 * near
    opened.key("r")
    np.testing.assert_array_equal(decoded_picture(opened), before)
    silent(opened)


NEARER = "plus(posegaussian.target, axisOf(posegaussian.camera.pose, 2), -0.2)"
"""A point of the subject's side that faces the viewer: turning moves it across the picture."""


def hold(browser: Browser, roll: float) -> None:
    """Turn the first camera about its own view, by radians."""
    browser.run(
        f"""(() => {{
          const p = posegaussian; p.reset();
          const axes = [0, 1, 2].map((row) => axisOf(p.camera.pose, row));
          const rolled = axes.map((axis) => turned(axis, axes[2], {roll}));
          p.move({{ ...p.camera, pose: poseAt(rolled, centreOf(p.camera.pose)) }});
        }})()"""
    )


def drag(browser: Browser, dx: float, dy: float) -> None:
    browser.pointer("mousePressed", 300, 300, button="left", buttons=1, clickCount=1)
    browser.pointer("mouseMoved", 300 + dx, 300 + dy, button="left", buttons=1)
    browser.pointer("mouseReleased", 300 + dx, 300 + dy, button="left")


@pytest.mark.parametrize("roll", [0, 0.6, np.pi / 2, np.pi, -np.pi / 2])
def test_the_subject_follows_the_finger_however_the_camera_is_held(opened: Browser, roll: float) -> None:
    """Rolled by any angle; and no drag goes over the top."""
    seen = """(() => {
      const { lens, pose } = fitted(posegaussian.camera, posegaussian.canvas.width, posegaussian.canvas.height);
      const [x, y, z] = [0, 1, 2].map((row) => dot(axisOf(pose, row), window.nearer) + pose[4 * row + 3]);
      return [lens[0] * x / z + lens[2], lens[3] * y / z + lens[4]];
    })()"""
    height = "dot(axisOf(posegaussian.camera.pose, 2), posegaussian.head.up)"
    for dx, dy in ((40, 0), (0, 40), (0, -40)):
        hold(opened, roll)
        opened.run(f"window.nearer = {NEARER}")
        before = np.array(opened.run(seen))
        drag(opened, dx, dy)
        moved, way = np.array(opened.run(seen)) - before, np.array([dx, dy]) / 40
        assert moved @ way > 5
        assert abs(moved @ way[::-1]) < 0.15 * (moved @ way)
    for dx, dy in ((0, 250), (0, -250), (250, 0), (-250, 0)):
        hold(opened, roll)
        for _ in range(3):
            drag(opened, dx, dy)
            assert abs(opened.run(height)) <= np.sin(1.5) + 1e-9
    silent(opened)


def test_a_camera_that_looks_straight_down_is_not_tipped_by_a_drag_across(opened: Browser) -> None:
    opened.run(
        """(() => {
          const p = posegaussian, { up } = p.head, down = up.map((n) => -n), right = axisOf(p.camera.pose, 0);
          const x = plus(right, up, -dot(right, up)), unit = x.map((n) => n / Math.hypot(...x));
          p.move({ ...p.camera, pose: poseAt([unit, cross(down, unit), down], plus(p.target, up, 2.5)) });
        })()"""
    )
    forward = "axisOf(posegaussian.camera.pose, 2)"
    before = np.array(opened.run(forward))
    drag(opened, 1, 0)
    assert np.degrees(np.arccos(min(1.0, before @ opened.run(forward)))) < 0.01
    drag(opened, 0, 100)  # further over the top it does not go
    assert np.degrees(np.arccos(min(1.0, before @ opened.run(forward)))) < 0.01
    drag(opened, 0, -100)
    assert np.degrees(np.arccos(min(1.0, before @ opened.run(forward)))) > 30
    silent(opened)


def test_frames_that_are_lacking_take_their_time(opened: Browser) -> None:
    """Third and fourth frame a minute after the second: playing waits there, and the time is told."""
    opened.run("window.seen = [], posegaussian.listeners.push(() => seen.push(posegaussian.step))")
    opened.run("posegaussian.head.times = [0, 0.05, 60, 60.05], posegaussian.play(true)")
    opened.wait("seen.includes(1)")
    opened.run("new Promise((resolve) => setTimeout(resolve, 500))")
    assert set(opened.run("seen")) == {0, 1}
    opened.run("posegaussian.seek(2)")
    opened.wait("posegaussian.step < 2")  # the two at the end take as long as they are apart, and it begins again
    opened.run("posegaussian.play(false), posegaussian.seek(3)")
    assert opened.run("document.getElementById('time').textContent").endswith(" 60.05 s")
    silent(opened)


def test_more_gaussians_than_a_device_holds_are_told(opened: Browser) -> None:
    count = opened.run("posegaussian.count")
    opened.run(
        """(() => {
          const { gl } = posegaussian.renderer, own = gl.getParameter.bind(gl);
          gl.getParameter = (name) => (name === gl.MAX_TEXTURE_SIZE ? 2 : own(name));
          posegaussian.renderer.forget(0), posegaussian.look();
        })()"""
    )
    opened.wait("!document.getElementById('message').hidden")
    told = opened.run("document.getElementById('message').textContent")
    assert f"a frame has {count} Gaussians, this device holds 2048; export with --page-gaussians 1843" in told


@pytest.mark.parametrize("size", [(320, 480), (640, 300), (360, 640)])
@pytest.mark.parametrize("key", ["i", "?"])
def test_panels_leave_the_controls_of_a_small_window_free(opened: Browser, size: tuple[int, int], key: str) -> None:
    opened.resize(*size, mobile=True)
    opened.key(key)
    covered = """[...document.querySelectorAll('footer button, footer select, footer input')].filter((control) => {
      const { left, top, width, height } = control.getBoundingClientRect();
      return document.elementFromPoint(left + width / 2, top + height / 2) !== control;
    }).map((control) => control.id)"""
    opened.wait("posegaussian.canvas.clientHeight < 480")
    assert opened.run(covered) == []
    panel = "document.querySelector('aside:not([hidden])').getBoundingClientRect()"
    assert opened.run(f"{panel}.bottom <= document.querySelector('footer').getBoundingClientRect().top")
    assert opened.run(f"{panel}.height") > 60
    silent(opened)


def test_source_pictures_background_and_information(opened: Browser, made: Made) -> None:
    opened.key("p")
    assert opened.run("document.getElementById('source-name').textContent") == "cam00"
    opened.wait("document.getElementById('source-picture').naturalWidth > 0")
    opened.run("posegaussian.paint('#30a040')")
    np.testing.assert_array_equal(decoded_picture(opened)[0, 0], [0x30, 0xA0, 0x40])
    opened.key("i")
    told = opened.run("document.getElementById('info').innerText")
    for text in (
        "person",
        "4 (source 0 to 3, 30 a second)",
        "128 × 128 px",
        "cam03",
        "depth.method truth",
        "MB of coded",
    ):
        assert text in told
    opened.resize(390, 780, mobile=True)
    assert opened.run("document.documentElement.scrollWidth") <= 390
    silent(opened)


@pytest.mark.parametrize("shift", [False, True])
def test_gaussians_are_lifted_as_rendering_lifts_them(
    browser: Browser, made: Made, tmp_path: Path, shift: bool
) -> None:
    """With a twist, with and without a shift, a skewed lens and a rolled camera."""
    given = maps(twist=True, shift=shift)
    assert given.twist is not None
    k, roll = np.array([[39.0, 2.5, 14.0], [0, 41.0, 12.5], [0, 0, 1]]), 2.5
    turn = np.array([[np.cos(roll), -np.sin(roll), 0], [np.sin(roll), np.cos(roll), 0], [0, 0, 1]])
    pose = rigid(turn @ made.results.context.rig.rotations[1], np.array([0.3, -0.2, 4.0]))
    lens = [k[0, 0], k[0, 1], k[0, 2], k[1, 1], k[1, 2]]
    view = {"name": "a", "size": [31, 23], "lens": lens, "pose": pose[:3].ravel().tolist()}
    head = head_of(made.file)
    head |= {
        "views": [view],
        "frames": [0],
        "steps": 1,
        "usable": [[True]],
        "coding": {**head["coding"], "turns": True, "shifts": shift},
    }
    head["cameras"] = [{**view, "group": "", "lens": [lens], "pose": [view["pose"]]}]
    write_page(tmp_path / "a.html", "a", [([coded(given)], [b""])], lambda: head)
    start(browser, tmp_path / "a.html")
    texels = browser.run(
        "posegaussian.sequence.order(0, posegaussian.camera.pose, [true], true).then((a) => [...a.data])"
    )
    wanted = lift(
        GaussianMaps(given.color, given.depth, given.scale, given.normal, given.opacity, given.twist, given.shift),
        k, pose, torch.float64, torch.device("cpu"),
    )  # fmt: skip
    words = np.array(texels, np.uint32).reshape(-1, 8)[: len(wanted.mean)]
    step = 1 / (coding.DEPTH_STEPS * given.focal)
    # half a step of a shift to both sides of the picture, where the surface is farthest
    beside = shift * 0.5 * 2**0.5 / coding.SHIFT_STEPS * given.depth.max() / 39.0
    np.testing.assert_allclose(words[:, :3].copy().view(np.float32), wanted.mean, atol=3 * step + beside)
    color = (words[:, 3, None] >> np.array([0, 8, 16], np.uint32)) & 255
    np.testing.assert_allclose(color / 255, wanted.color, atol=1e-9)
    quaternion = words[:, 4:6].copy().view(np.int16).reshape(-1, 4) / 32767
    axes = rotations(torch.tensor(quaternion)).numpy()
    # a step of a number of the octahedron is up to three degrees, and a turn about a normal close to (0, 0, 1) is loose
    off = np.degrees(np.arccos(np.clip(((axes * wanted.rotation.numpy()).sum(axis=(1, 2)) - 1) / 2, -1, 1)))
    assert np.percentile(off, 99) < 4
    scale = 2.0 ** ((words[:, 6:].copy().view(np.uint16).reshape(-1, 4)[:, :3].astype(float) - 32768) / 1024)
    np.testing.assert_allclose(scale, wanted.scale, rtol=0.07)
    opacity = words[:, 7].copy().view(np.uint8).reshape(-1, 4)[:, 2:] / 255
    np.testing.assert_allclose(opacity, wanted.faces, atol=0.51 / coding.OPACITY_STEPS + 0.5 / 255)


def test_a_smaller_page_shows_the_same(opened: Browser, made: Made, tmp_path: Path) -> None:
    def seen() -> tuple[np.ndarray, int]:
        sized(opened, SIDE, SIDE)
        opened.run("posegaussian.seek(1)")
        return decoded_picture(opened), opened.run("posegaussian.count")

    whole, count = seen()
    page.export_page(made.results, (), tmp_path / "a.html", "orbit", parse("#000000"), count // 3)
    start(opened, tmp_path / "a.html")
    small, fewer = seen()
    assert 0.2 * count < fewer < 0.34 * count
    assert person_psnr(whole, small) > 20
    assert "2 × 2 px merged" in str(opened.run("posegaussian.head.info"))
    silent(opened)


def test_hostile_names_are_shown_as_they_are(
    browser: Browser, made: Made, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def hostile(head: Mapping[str, Any]) -> dict[str, Any]:
        named = {key: [{**c, "name": HOSTILE} for c in head[key]] for key in ("views", "cameras")}
        return {**head, **named, "title": HOSTILE, "info": [(HOSTILE, HOSTILE)]}

    write = page.write_page
    monkeypatch.setattr(
        page, "write_page", lambda file, _, frames, head: write(file, HOSTILE, frames, lambda: hostile(head()))
    )
    page.export_page(made.results, (), tmp_path / "a b 'ü.html", "orbit", parse("none"))
    start(browser, tmp_path / "a b 'ü.html")
    assert browser.run("document.title") == HOSTILE
    for key in "ip":
        browser.key(key)
    assert browser.run("document.querySelector('#info h1').textContent") == HOSTILE
    assert browser.run("document.getElementById('source-name').textContent") == HOSTILE
    assert browser.run("document.getElementById('camera').options[0].textContent") == HOSTILE
    assert browser.run("document.querySelectorAll('b').length") == 0
    silent(browser)
