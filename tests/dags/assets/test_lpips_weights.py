"""`posegaussian models fetch lpips`: a local server in the place of torchvision's, a made wheel in pip's."""

from __future__ import annotations

import hashlib
import http.server
import pickle
import threading
import zipfile
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
import torch

from posegaussian.dags.assets import downloads, lpips, wheels
from posegaussian.dags.config.settings import load_configuration
from posegaussian.dags.evaluation.asked import asked
from posegaussian.stages.metrics.measures.lpips_network import STACKS
from posegaussian.stages.metrics.measures.lpips_weights import load_network
from posegaussian.storage.model.errors import SourceError
from tests.dags.assets.test_models import pip_gives
from tests.stages.metrics.test_lpips import made_weights


class Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, format: str, *args: object) -> None:
        pass


@pytest.fixture
def server(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The folder that is served; the cache is empty."""
    folder = tmp_path / "served"
    folder.mkdir()
    monkeypatch.delenv("POSEGAUSSIAN_MODELS", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    for name in ("http_proxy", "HTTP_PROXY", "all_proxy", "ALL_PROXY"):
        monkeypatch.delenv(name, raising=False)
    serving = http.server.ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(folder)))
    threading.Thread(target=serving.serve_forever, daemon=True).start()
    monkeypatch.setattr(lpips, "PUBLISHED", f"http://127.0.0.1:{serving.server_port}")
    yield folder
    serving.shutdown()
    serving.server_close()


@pytest.fixture
def published(server: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Made weights of the right shape, under names and hashes of their own: the wheel's file, which pip gives."""
    networks, heads, file = [], [], tmp_path / wheels.Wheel("lpips", lpips.WHEEL.file, "", "").file
    with zipfile.ZipFile(file, "w") as z:
        for network, head, stack in zip(lpips.NETWORKS, lpips.HEADS, STACKS.values(), strict=True):
            trunk, linear = made_weights(stack)
            torch.save(trunk, server / "trunk.pth")
            digest = hashlib.sha256((server / "trunk.pth").read_bytes()).hexdigest()
            networks.append(replace(network, name=f"{network.key}-{digest[:8]}.pth", sha256=digest[:8]))
            (server / "trunk.pth").rename(server / networks[-1].name)
            torch.save(linear, tmp_path / "linear.pth")
            content = (tmp_path / "linear.pth").read_bytes()
            heads.append(replace(head, sha256=hashlib.sha256(content).hexdigest()))
            z.writestr(str(head.member), content)
    monkeypatch.setattr(lpips, "NETWORKS", tuple(networks))
    monkeypatch.setattr(lpips, "HEADS", tuple(heads))
    monkeypatch.setattr(lpips, "WHEEL", replace(lpips.WHEEL, sha256=hashlib.sha256(file.read_bytes()).hexdigest()))
    return file


def cached() -> set[str]:
    return {f.name for f in lpips.folder().iterdir()} if lpips.folder().is_dir() else set()


def test_the_names_of_the_networks_end_with_what_is_checked() -> None:
    for network in lpips.NETWORKS:
        assert network.name.endswith(f"-{network.sha256}.pth")
        assert len(network.sha256) == 8
        assert network.is_it(network.sha256 + 56 * "0")
        assert not network.is_it("0" + network.sha256 + 55 * "0")


def test_fetch_brings_networks_and_linear_layers_that_lpips_reads(
    published: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = pip_gives_lpips(monkeypatch, published)
    said = "\n".join(downloads.fetch("lpips"))
    assert cached() == {p.name for p in (*lpips.NETWORKS, *lpips.HEADS)}
    assert "--platform" not in calls[0]
    settings = load_configuration(None, lpips.settings(), folder=Path("/")).default.metrics
    for measure in STACKS:
        network = measure.removeprefix("lpips_")
        files = [
            value
            for key in (network, f"{network}_linear")
            for value in (settings.lpips_weights[key], settings.lpips_sha256[key])
        ]
        assert load_network(measure, *files).stack is STACKS[measure]
    assert "metrics.lpips_weights" in said
    again = downloads.fetch("lpips")
    assert "nothing was fetched" in again[0]
    assert len(calls) == 1
    assert "missing" not in "\n".join(lpips.listing())


def pip_gives_lpips(monkeypatch: pytest.MonkeyPatch, file: Path) -> list[list[str]]:
    monkeypatch.setattr(downloads, "MEDIAPIPE", lpips.WHEEL)  # the name under which the made pip puts what it gives
    return pip_gives(monkeypatch, file)


def test_a_file_of_another_hash_is_refused_and_not_kept(
    server: Path, published: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pip_gives_lpips(monkeypatch, published)
    (server / lpips.NETWORKS[0].name).write_bytes(b"something else")
    with pytest.raises(SourceError, match=r"gave a file with sha256 .*begins with .*its name says; nothing was kept"):
        downloads.fetch("lpips")
    assert cached() == {p.name for p in lpips.HEADS}, "nothing of the network is left, not even a part"


def test_without_a_network_or_the_file_the_other_way_is_named(
    server: Path, published: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    pip_gives_lpips(monkeypatch, published)
    moved = (server / lpips.NETWORKS[0].name).rename(tmp_path / "mine.pth")
    with pytest.raises(
        SourceError, match=rf"could not be fetched \(File not found\).*models add {lpips.NETWORKS[0].name}"
    ):
        downloads.fetch("lpips")
    monkeypatch.setattr(lpips, "PUBLISHED", "http://127.0.0.1:9")  # nobody listens there
    with pytest.raises(SourceError, match=r"could not be fetched \(.*refused\)"):
        downloads.fetch("lpips")
    downloads.add([moved, published])
    assert lpips.NETWORKS[0].name in cached()
    other = tmp_path / "other.pth"
    other.write_bytes(b"no weights")
    with pytest.raises(SourceError, match="none of LPIPS' files"):
        downloads.add([other])


def test_more_bytes_than_such_a_file_has_are_not_taken(published: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pip_gives_lpips(monkeypatch, published)
    monkeypatch.setattr(lpips, "MOST", 1000)
    with pytest.raises(SourceError, match="no such file is that large, nothing was kept"):
        downloads.fetch("lpips")


class Bomb:
    def __reduce__(self) -> tuple[object, tuple[str]]:
        return (Path.touch, (Path("exploded"),))  # type: ignore[return-value]


def test_a_pickle_runs_no_code(server: Path, published: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Even one whose hash is what its name says."""
    monkeypatch.chdir(tmp_path)
    content = pickle.dumps({"features.0.weight": Bomb()})
    digest = hashlib.sha256(content).hexdigest()
    bad = replace(lpips.NETWORKS[0], name=f"alex-{digest[:8]}.pth", sha256=digest[:8])
    (server / bad.name).write_bytes(content)
    monkeypatch.setattr(lpips, "NETWORKS", (bad, lpips.NETWORKS[1]))
    pip_gives_lpips(monkeypatch, published)
    downloads.fetch("lpips")
    found = lpips.there()
    files = [str(part) for key in ("alex", "alex_linear") for part in found[key]]  # type: ignore[index]
    with pytest.raises(SourceError, match="cannot be read as PyTorch weights"):
        load_network("lpips_alex", *files)
    assert not (tmp_path / "exploded").exists()


def test_evaluate_takes_what_was_fetched_unless_the_settings_name_files(
    published: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pip_gives_lpips(monkeypatch, published)
    plain = load_configuration(None, [], folder=Path("/"))
    assert asked(plain, "lpips_alex") == ['metrics.measures=["psnr", "ssim", "delta_ssim", "lpips_alex"]']
    downloads.fetch("lpips")
    named = load_configuration(None, asked(plain, "lpips_alex, flip"), folder=Path("/"))
    own = named.default.metrics
    assert own.measures == ["psnr", "ssim", "delta_ssim", "lpips_alex", "flip"]
    assert set(own.lpips_weights) == set(own.lpips_sha256) == {"alex", "alex_linear", "vgg", "vgg_linear"}
    assert asked(plain, "flip") == ['metrics.measures=["psnr", "ssim", "delta_ssim", "flip"]']
    assert len(asked(named, "lpips_vgg")) == 1, "files that the settings name stay"
