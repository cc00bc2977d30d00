"""Pages over HTTP: who may ask for what. Answers come from memory and from finished frames; no address is a file's."""

from __future__ import annotations

import errno
import html
import ipaddress
import json
import re
import socket
import sys
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import quote, unquote, urlsplit

from posegaussian.dags.view.live import LiveSequences, NotThere
from posegaussian.storage.model.errors import ConfigError, UserError

ADDRESS = re.compile(r"/(?P<name>[^/]+)/(?:(?P<state>state\.json)|frames/(?P<frame>[0-9]{1,9}))?")
"""A sequence's page, what is there of it, and one frame."""
LIST = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; style-src 'unsafe-inline'">
<title>Sequences</title><style>
:root {{ color-scheme: dark; font: 16px/1.5 system-ui, sans-serif; }}
body {{ max-width: 40em; margin: 24px auto; padding: 0 16px; background: #101418; color: #e8ecf0; }}
h1 {{ font-size: 20px; }} ul {{ padding: 0; list-style: none; }}
a {{ display: block; margin: 8px 0; padding: 10px 14px; border: 1px solid #3a424c; border-radius: 8px; color: #58b0ff;
 overflow-wrap: anywhere; }}
</style></head><body><h1>Sequences of this archive</h1><ul>{items}</ul></body></html>
"""


class Server(ThreadingHTTPServer):
    """Serves the pages of some sequences until it is shut down; each request has a thread of its own."""

    def __init__(self, sequences: LiveSequences, host: str, port: int) -> None:
        """Listens already. Raises ConfigError for a port in use and for an address that is not this machine's."""
        self.sequences = sequences
        try:
            self.address_family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
            super().__init__((host, port), Handler)
        except (OSError, OverflowError) as e:
            raise ConfigError(_unheard(host, port, e)) from e

    @property
    def local(self) -> bool:
        """Whether this machine alone reaches it."""
        return ipaddress.ip_address(str(self.server_address[0]).partition("%")[0]).is_loopback

    @property
    def url(self) -> str:
        """Where its list of sequences is."""
        host, port = str(self.server_address[0]), self.server_address[1]
        return f"http://{f'[{host}]' if ':' in host else host}:{port}/"

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A client that went away is nothing to report."""
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)


def _unheard(host: str, port: int, error: Exception) -> str:
    if getattr(error, "errno", None) == errno.EADDRINUSE:
        return f"view --port {port}: the port is in use on {host}; name another one, or --port 0 for a free one"
    if getattr(error, "errno", None) == errno.EACCES:
        return f"view --port {port}: this user may not listen there; name one from 1024 on, or --port 0 for a free one"
    return f"view --host {host} --port {port}: {error}; --host takes an address or a name of this machine"


class Handler(BaseHTTPRequestHandler):
    """One request: GET and HEAD, everything else is refused."""

    server: Server
    server_version = "posegaussian"
    sys_version = ""

    def do_GET(self) -> None:
        """Answer."""
        self._answer(*self._found())

    do_HEAD = do_GET

    def log_message(self, format: str, *args: Any) -> None:
        """Requests are not told: pages ask every second."""

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
        """A refusal as a sentence; a method that there is no answer to is one that is not allowed."""
        if code == HTTPStatus.NOT_IMPLEMENTED:
            self.close_connection = True  # what it sends besides is not read
            code, message = HTTPStatus.METHOD_NOT_ALLOWED, "only GET and HEAD: nothing is changed here"
        self._answer(code, "text/plain", message or HTTPStatus(code).phrase)

    def _found(self) -> tuple[int, str, str]:
        """Status, type and text for an address."""
        if self.server.local and not self._asked_here():
            return HTTPStatus.FORBIDDEN, "text/plain", "asked for under a name that is not this machine's"
        address = urlsplit(self.path).path
        sequences = self.server.sequences
        if address == "/":
            return HTTPStatus.OK, "text/html", _listed(sequences.names)
        match = ADDRESS.fullmatch(address)
        name = unquote(match["name"]) if match else ""
        if match is None or name not in sequences.names:
            return HTTPStatus.NOT_FOUND, "text/plain", "nothing is there; / lists the sequences"
        try:
            if match["state"]:
                return HTTPStatus.OK, "application/json", json.dumps(sequences.moment(name).state)
            if match["frame"]:
                return HTTPStatus.OK, "application/json", json.dumps(sequences.frame(name, int(match["frame"])))
            return HTTPStatus.OK, "text/html", sequences.document(name)
        except NotThere as e:
            return HTTPStatus.NOT_FOUND, "text/plain", str(e)
        except UserError as e:
            return HTTPStatus.SERVICE_UNAVAILABLE, "text/plain", str(e)

    def _asked_here(self) -> bool:
        """Whether the name in the request is this machine's: pages of the web that have their own name lead here are
        told nothing."""
        host = urlsplit(f"//{self.headers.get('Host', '')}").hostname or ""
        return host in ("localhost", "127.0.0.1", "::1", str(self.server.server_address[0]))

    def _answer(self, status: int, kind: str, text: str) -> None:
        data = text.encode("utf-8", "replace")
        self.send_response(status)
        self.send_header("Content-Type", f"{kind}; charset=utf-8")
        self.send_header("Content-Length", str(len(data)))
        self.send_header("Cache-Control", "no-store")
        self.send_header("X-Content-Type-Options", "nosniff")
        if status == HTTPStatus.METHOD_NOT_ALLOWED:
            self.send_header("Allow", "GET, HEAD")
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(data)


def _listed(names: tuple[str, ...]) -> str:
    return LIST.format(items="".join(f'<li><a href="/{quote(n, safe="")}/">{html.escape(n)}</a></li>' for n in names))
