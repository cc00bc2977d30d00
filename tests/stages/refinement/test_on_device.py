"""Steps on a device are those on the CPU: the same slopes, Gaussians and moves; in Triton's interpreter where there is
no GPU."""

import numpy as np
import pytest
import torch

from posegaussian.stages.refinement import rehearsal
from posegaussian.stages.refinement.steps.attributes import CHANNELS
from posegaussian.stages.refinement.steps.loss import Filmed, loss
from posegaussian.stages.refinement.steps.optimise import HostWalk, Walk
from posegaussian.stages.simulator.subjects.capsule_person import PersonCapture, capture_person
from posegaussian.stages.splatting.definition.scene import Camera
from posegaussian.stages.splatting.rasterizer import rasterize
from tests.stages.refinement.walks import begun
from tests.support.gaussian_scenes import GPU_DEVICE, NO_GPU

if NO_GPU is None:
    from posegaussian.stages.refinement.steps.device_loss import DevicePicture, device_loss
    from posegaussian.stages.refinement.steps.on_device import ROWS, DeviceWalk

pytestmark = pytest.mark.skipif(NO_GPU is not None, reason=str(NO_GPU))


@pytest.fixture(scope="module")
def person() -> PersonCapture:
    return capture_person(views=5, size=40, frames=1, held_out=0)


@pytest.fixture
def walk(person: PersonCapture) -> "DeviceWalk":
    return DeviceWalk(*begun(person), GPU_DEVICE)


def random_offsets(walk: HostWalk) -> dict[str, np.ndarray]:
    """Within the bounds."""
    random = np.random.default_rng(1)
    made = {n: random.uniform(-0.2, 0.2, o.shape).astype(np.float32) for n, o in walk.gaussians.offsets.items()}
    return {n: np.clip(o, *walk.gaussians.bounds[n]).astype(np.float32) for n, o in made.items()}


@pytest.mark.parametrize("whole", [True, False])
def test_the_slopes_of_the_loss_are_those_on_the_cpu(whole: bool) -> None:
    random = np.random.default_rng(2)
    cover = (random.random((30, 23)) > 0.4).astype(np.float32) * random.random((30, 23)).astype(np.float32)
    picture = random.random((30, 23, 3)).astype(np.float32) * cover[..., None]
    lacking = None if whole else (cover == 0) & (random.random((30, 23)) > 0.5)
    filmed = Filmed(Camera(np.eye(3), np.eye(4), 23, 30), picture, cover, lacking)
    alpha = random.random((30, 23)).astype(np.float32)
    alpha[4], alpha[5] = 0, cover[5]  # nothing drawn, and as it should be
    color = random.random((30, 23, 3)).astype(np.float32) * alpha[..., None]
    color[6] = picture[6]
    there = DevicePicture.of(filmed, GPU_DEVICE)
    found = device_loss(*(torch.from_numpy(a).to(GPU_DEVICE) for a in (color, alpha)), there)
    expected = loss(color, alpha, filmed)
    for slope, wanted in zip(found, (expected.by_color, expected.by_alpha), strict=True):
        # SSIM divides differences of squares, which cancel, by variances of as little as 1e-3
        np.testing.assert_allclose(slope.cpu().numpy(), wanted, rtol=1e-3, atol=1e-5)


def test_gaussians_and_their_slopes_are_those_on_the_cpu(person: PersonCapture, walk: "DeviceWalk") -> None:
    host = HostWalk(*begun(person))
    host.gaussians.offsets = random_offsets(host)
    offsets = torch.from_numpy(np.concatenate([host.gaussians.offsets[n] for n in CHANNELS])).to(GPU_DEVICE)
    expected, found = host.gaussians.gaussians(), walk.there.moved(offsets)
    torch.manual_seed(0)
    for name in vars(expected):
        own, other = getattr(expected, name), getattr(found, name)
        torch.testing.assert_close(other.detach().cpu(), own.detach(), rtol=1e-5, atol=2e-6)  # float32
        slope = torch.randn(own.shape)
        own.backward(slope)
        other.backward(slope.to(GPU_DEVICE))
    slopes = walk.there.slopes(offsets, found).cpu().split(ROWS)
    for (name, wanted), part in zip(host.gaussians.slopes(expected).items(), slopes, strict=True):
        # as the CPU's own are held to float64's
        np.testing.assert_allclose(part.numpy(), wanted, rtol=1e-4, atol=2e-5, err_msg=name)


def test_what_has_no_length_or_no_reader_has_no_slope(walk: "DeviceWalk") -> None:
    offsets = torch.zeros_like(walk.offsets)
    base, twist = walk.there.held[0], walk.there.held[2]
    base[6:9, 4], twist[:, 5] = 0, 0
    gaussians = walk.there.moved(offsets)
    assert bool(torch.isfinite(gaussians.rotation).all())
    gaussians.rotation.sum().backward()
    slopes = walk.there.slopes(offsets, gaussians)
    assert bool(torch.isfinite(slopes).all())
    assert not slopes[6:9, 4].any()
    assert not slopes[11, 5].any()
    assert not slopes[[0, 1, 2, 3, 4, 5, 9, 10, 12, 13]].any()  # of these nothing was read


def test_slopes_move_as_on_the_cpu(person: PersonCapture, walk: "DeviceWalk") -> None:
    host, random = HostWalk(*begun(person)), np.random.default_rng(3)
    for k in range(6):
        slopes = {n: random.normal(size=o.shape).astype(np.float32) for n, o in host.gaussians.offsets.items()}
        host.adam.step(slopes, 1 + k / 5)
        walk._move(torch.from_numpy(np.concatenate([slopes[n] for n in CHANNELS])).to(GPU_DEVICE), 1 + k / 5)
        host._remember()
        walk._remember()
    for name, found in walk.reached.offsets.items():
        wanted = host.reached.offsets[name]
        # six sums in float32 of moves as large as the largest
        np.testing.assert_allclose(found, wanted, atol=1e-5 * np.abs(wanted).max(), err_msg=name)


def test_steps_lessen_the_loss_as_on_the_cpu(person: PersonCapture, walk: "DeviceWalk") -> None:
    """One by one the Gaussians part: where a slope is near 0 a rounding says which way Adam goes."""
    host = HostWalk(*begun(person))
    first = whole_loss(host)
    for _ in range(20):
        host.step()
        walk.step()
    assert whole_loss(host) < 0.7 * first
    assert whole_loss(walk) == pytest.approx(whole_loss(host), rel=0.02)
    assert walk.masked == host.masked == 0


def whole_loss(walk: Walk) -> float:
    """Of what was reached, over all pictures."""
    with torch.no_grad():
        drawn = [rasterize(walk.reached.gaussians(), [p.camera]) for p in walk.pictures]
    pairs = zip(drawn, walk.pictures, strict=True)
    return sum(loss(d.color[0].numpy(), d.alpha[0].numpy(), p).value for d, p in pairs)


def test_slopes_that_are_not_finite_are_counted_and_move_nothing(walk: "DeviceWalk") -> None:
    slopes = torch.ones_like(walk.offsets)
    slopes[0, 3], slopes[7, 5], slopes[9, 0] = torch.nan, torch.inf, -torch.inf
    walk._move(slopes, slower=1.0)
    still = walk.offsets == 0
    assert walk.masked == 3
    assert bool(still[[0, 7, 9], [3, 5, 0]].all())
    free = torch.ones_like(still)
    free[:3] = False  # a colour of 0 may not fall
    free[[0, 7, 9], [3, 5, 0]] = False
    assert not still[free].any()
    assert bool(torch.isfinite(walk.offsets).all())


def test_offsets_stay_within_their_bounds(walk: "DeviceWalk") -> None:
    for sign in (-1, 1):
        walk.mean.zero_()
        walk.square.zero_()
        for _ in range(12):
            walk._move(torch.full_like(walk.offsets, sign), slower=0.01)
        rows = dict(zip(CHANNELS, walk.offsets.cpu().split(ROWS), strict=True))
        for name, offsets in rows.items():
            lower, upper = (np.broadcast_to(b, offsets.shape) for b in walk.gaussians.bounds[name])
            np.testing.assert_allclose(offsets.numpy(), lower if sign > 0 else upper, rtol=1e-6, err_msg=name)


def test_equal_arguments_give_equal_bits(person: PersonCapture) -> None:
    first, second = (DeviceWalk(*begun(person), GPU_DEVICE) for _ in range(2))
    for _ in range(3):
        first.step()
        second.step()
    assert torch.equal(first.average, second.average)


def test_a_worker_takes_its_steps_on_its_device(person: PersonCapture, monkeypatch: pytest.MonkeyPatch) -> None:
    assert isinstance(rehearsal.begin(*begun(person)), DeviceWalk if GPU_DEVICE.type == "cuda" else HostWalk)
    monkeypatch.setattr(rehearsal, "device", lambda: torch.device("cpu"))
    assert isinstance(rehearsal.begin(*begun(person)), HostWalk)
