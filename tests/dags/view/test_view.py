"""The served page: what it serves is what an exported page holds, it changes nothing, and it leads nowhere else."""

from __future__ import annotations

import http.client
import json
import re
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import pytest
from typer.testing import CliRunner

from posegaussian.dags.cli.app import app
from posegaussian.dags.export import page
from posegaussian.dags.export.background import parse
from posegaussian.dags.planning.results import Results
from posegaussian.dags.view.live import LiveSequences
from posegaussian.dags.view.server import Server
from posegaussian.storage.archive.receipts import receipt_file
from posegaussian.storage.model.errors import ConfigError
from tests.dags.view.conftest import FRAMES
from tests.support.pipeline import NAME, Pipeline


@contextmanager
def serving(pipeline: Pipeline, *names: str) -> Iterator[Server]:
    with Server(LiveSequences(pipeline.session, names or (NAME,)), "127.0.0.1", 0) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.02,))
        thread.start()
        try:
            yield server
        finally:
            server.shutdown()
            thread.join()


def asked(server: Server, address: str, method: str = "GET", **headers: str) -> tuple[int, bytes]:
    """Status and body; the address goes out as it stands."""
    connection = http.client.HTTPConnection("127.0.0.1", server.server_address[1], timeout=60)
    try:
        connection.request(method, address, headers=headers)
        answer = connection.getresponse()
        return answer.status, answer.read()
    finally:
        connection.close()


def got(server: Server, address: str) -> dict:
    status, body = asked(server, address)
    assert status == 200, body
    return json.loads(body)


def elements(document: str) -> dict[str, str]:
    return dict(re.findall(r'<script type="text/plain" id="([\w-]+)">(.*?)</script>', document, re.DOTALL))


def contents(folder: Path) -> dict[str, tuple[bytes, int]]:
    return {
        str(f.relative_to(folder)): (f.read_bytes() if f.is_file() else b"", f.stat().st_mtime_ns)
        for f in sorted(folder.rglob("*"))
    }


def unfinish(pipeline: Pipeline, partition: int) -> tuple[Path, bytes]:
    """Take a receipt away, as a worker does before it makes a partition anew; where it was, and what it said."""
    file = receipt_file(pipeline.context().sequence, "gaussians", partition, None, None)
    said = file.read_bytes()
    file.unlink()
    return file, said


def test_frames_are_those_of_an_exported_page_and_the_archive_stays_as_it_is(made: Pipeline, tmp_path: Path) -> None:
    page.export_page(Results(made.context()), (), tmp_path / "a.html", None, parse("none"))
    exported = elements((tmp_path / "a.html").read_text(encoding="utf-8"))
    before = contents(made.root)
    with serving(made) as server:
        status, body = asked(server, f"/{NAME}/")
        assert status == 200
        served = elements(body.decode())
        state = got(server, f"/{NAME}/state.json")
        assert len(state["frames"]) == FRAMES
        with ThreadPoolExecutor(4) as clients:
            frames = list(clients.map(lambda n: got(server, f"/{NAME}/frames/{n}"), range(FRAMES)))
        for method in ("POST", "PUT", "DELETE", "PATCH", "OPTIONS", "TRACE", "PROPFIND"):
            assert asked(server, f"/{NAME}/", method)[0] == 405, method
        assert asked(server, f"/{NAME}/", "HEAD") == (200, b"")
    assert contents(made.root) == before
    for number, frame in enumerate(frames):
        assert frame["key"] == state["frames"][number]
        assert frame["coded"] == exported[f"frame-{number}"]
        assert frame["pictures"] == exported[f"pictures-{number}"]
    for part in ("splat-vert", "splat-frag", "worker"):
        assert served[part] == exported[part]
    told, shown = json.loads(exported["head"]), json.loads(served["head"])
    assert state["version"] == shown["version"]
    same = set(told) - {"target", "info"}
    assert {key: shown[key] for key in same} == {key: told[key] for key in same}


def test_what_is_unfinished_comes_when_it_is_done(made: Pipeline, tmp_path: Path) -> None:
    archive = made.copy(tmp_path / "archive")
    file, said = unfinish(archive, 1)
    with serving(archive) as server:
        first = got(server, f"/{NAME}/state.json")
        assert [key is not None for key in first["frames"]] == [True, True, False, False]
        assert asked(server, f"/{NAME}/frames/2")[0] == 404
        assert got(server, f"/{NAME}/frames/1")["key"] == first["frames"][1]
        file.write_bytes(said)
        server.sequences.moment(NAME, age=0)
        second = got(server, f"/{NAME}/state.json")
        assert second["version"] == first["version"]
        assert second["frames"][:2] == first["frames"][:2]
        assert got(server, f"/{NAME}/frames/2")["key"] == second["frames"][2]


def test_a_frame_that_is_made_anew_while_it_is_read_is_not_served(
    made: Pipeline, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    archive, read = made.copy(tmp_path / "archive"), page.coded_frame

    def meanwhile(*given: object) -> object:
        unfinish(archive, 0)
        return read(*given)

    with serving(archive) as server:
        assert got(server, f"/{NAME}/state.json")["frames"][0] is not None
        monkeypatch.setattr(page, "coded_frame", meanwhile)
        status, body = asked(server, f"/{NAME}/frames/0")
    assert (status, body.decode()) == (404, f"frame 0 of sequence {NAME} is being made anew")


def test_no_address_leads_elsewhere(made: Pipeline) -> None:
    with serving(made) as server:
        for address in (
            "/../", "/..", "/%2e%2e/", f"/{NAME}/../{NAME}/", f"/{NAME}/..%2f..%2fpyproject.toml", f"/{NAME}/zarr.json",
            f"/{NAME}/frames/../state.json", f"/{NAME}/frames/{FRAMES}", f"/{NAME}/frames/-1", "/nobody/",
            "//etc/passwd", f"/{NAME}/_receipts/", "/ledger.parquet",
        ):  # fmt: skip
            assert asked(server, address)[0] == 404, address
        assert asked(server, "/", Host="somewhere.example")[0] == 403
        assert asked(server, "/", Host=f"localhost:{server.server_address[1]}")[0] == 200


def test_names_are_text(made: Pipeline) -> None:
    hostile = "<b>\"a' ü&"
    with serving(made, NAME, hostile) as server:
        listed = asked(server, "/")[1].decode()
    assert "<b>" not in listed
    assert '<a href="/%3Cb%3E%22a%27%20%C3%BC%26/">&lt;b&gt;&quot;a&#x27; ü&amp;</a>' in listed


def test_ports_and_hosts_that_cannot_be_are_sentences(made: Pipeline) -> None:
    sequences = LiveSequences(made.session, (NAME,))
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(ConfigError, match=f"--port {port}: the port is in use"):
            Server(sequences, "127.0.0.1", port)
    with pytest.raises(ConfigError, match=r"--host 192\.0\.2\.1 .*an address or a name of this machine"):
        Server(sequences, "192.0.2.1", 0)


def test_ctrl_c_ends_the_command(made: Pipeline) -> None:
    words = ["view", str(made.root), "--port", "0", "--host", "0.0.0.0", *made.options[2:]]
    heeding = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"  # the tests may run without
    process = subprocess.Popen(
        [sys.executable, "-c", f"{heeding}; from posegaussian.dags.cli.app import main; main()", *words],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        assert process.stdout is not None
        assert "anyone on the network" in process.stdout.readline()
        assert "view: 1 sequence at http://0.0.0.0:" in process.stdout.readline()
        process.send_signal(signal.SIGINT)
        said, complained = process.communicate(timeout=60)
    finally:
        process.kill()
    assert (process.returncode, complained) == (0, "")
    assert f"posegaussian export {NAME} --page person.html --archive {made.root}" in said


def test_the_archive_is_named_before_the_sequences_or_by_its_option(
    made: Pipeline, monkeypatch: pytest.MonkeyPatch
) -> None:
    def ended(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Server, "serve_forever", ended)
    archive = str(made.root)
    for words in ([archive], [archive, NAME], ["--archive", archive]):
        done = CliRunner().invoke(app, ["view", *words, "--port", "0"])
        assert done.exit_code == 0, done.output
        assert f"export {NAME} --page person.html --archive {archive}" in done.output
    for words, better in (([NAME], NAME), (["here", "a b"], "'a b'")):
        done = CliRunner().invoke(app, ["view", *words, "--archive", archive, "--port", "0"])
        assert isinstance(done.exception, ConfigError)
        assert "the archive is named twice; name it before the sequences alone" in str(done.exception)
        assert f"`posegaussian view {archive} {better}`" in str(done.exception)
