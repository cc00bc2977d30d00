"""A page in a real browser: Chromium without a window, driven by its own protocol."""

from __future__ import annotations

import asyncio
import base64
import json
import re
import shutil
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from tornado.websocket import WebSocketClientConnection, websocket_connect

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")
FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",  # without it newer versions have no WebGL where there is no GPU
    "--remote-debugging-port=0",
    "--disable-extensions",
    "--disable-background-networking",
    "--no-first-run",
    "--hide-scrollbars",
    "--disable-dev-shm-usage",
)
LIMIT = 60.0
"""Seconds for one answer."""


def found() -> str | None:
    """The browser's command."""
    return next((path for name in BROWSERS if (path := shutil.which(name))), None)


def needed() -> str:
    """The browser's command; skips the test where there is none."""
    command = found()
    if command is None:
        pytest.skip("no Chromium to open pages with: apt-get install chromium")
    return command


class Browser:
    """One page of its own browser; `with Browser() as b: b.open(file)`."""

    def __init__(self, width: int = 640, height: int = 480) -> None:
        self.command, self.size = needed(), (width, height)
        self.complaints: list[str] = []
        """Errors and warnings of the console, exceptions, and requests that failed, since the page was opened."""
        self.requests: list[str] = []
        """Addresses that the page asked for."""

    def __enter__(self) -> Browser:
        self.loop = asyncio.new_event_loop()
        self.profile = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        self.log = open(Path(self.profile.name) / "log", "w+b")
        flags = (*FLAGS, f"--user-data-dir={self.profile.name}", f"--window-size={self.size[0]},{self.size[1]}")
        self.process = subprocess.Popen([self.command, *flags, "about:blank"], stderr=self.log)
        try:
            self.answered, self.session = 0, None
            self.socket = self.loop.run_until_complete(self._connected(self._address()))
            target = self.call("Target.createTarget", url="about:blank")["targetId"]
            self.session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
            for domain in ("Page", "Runtime", "Log", "Network"):
                self.call(f"{domain}.enable")
            self.resize(*self.size)
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.wait()
        self.log.close()
        self.profile.cleanup()
        self.loop.close()

    @staticmethod
    async def _connected(address: str) -> WebSocketClientConnection:
        return await websocket_connect(address, max_message_size=1 << 28)

    def _address(self) -> str:
        """Where the browser listens; it says so when it is up."""
        end = time.monotonic() + LIMIT
        while time.monotonic() < end:
            said = Path(self.log.name).read_text(errors="replace")
            if match := re.search(r"DevTools listening on (ws://\S+)", said):
                return match[1]
            if self.process.poll() is not None:
                break
            time.sleep(0.05)
        raise RuntimeError(f"{self.command} did not start: {said[-2000:]}")

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        """One command of the protocol; its result."""
        return self.loop.run_until_complete(asyncio.wait_for(self._call(method, params), LIMIT))

    async def _call(self, method: str, params: dict[str, Any]) -> dict[str, Any]:
        self.answered += 1
        own = self.answered
        message: dict[str, Any] = {"id": own, "method": method, "params": params}
        if self.session:
            message["sessionId"] = self.session
        await self.socket.write_message(json.dumps(message))
        while True:
            text = await self.socket.read_message()
            assert text is not None, "the browser went away"
            answer = json.loads(text)
            if answer.get("id") == own:
                assert "error" not in answer, f"{method}: {answer['error']}"
                return dict(answer["result"])
            self._noted(answer.get("method", ""), answer.get("params", {}))

    def _noted(self, event: str, said: dict[str, Any]) -> None:
        if event == "Runtime.exceptionThrown":
            details = said["exceptionDetails"]
            self.complaints.append(details.get("exception", {}).get("description", details["text"]))
        elif event == "Runtime.consoleAPICalled" and said["type"] in ("error", "warning", "assert"):
            self.complaints.append(" ".join(str(a.get("value", a.get("description"))) for a in said["args"]))
        elif event == "Log.entryAdded" and said["entry"]["level"] in ("error", "warning"):
            self.complaints.append(f"{said['entry']['text']} {said['entry'].get('url', '')}".strip())
        elif event == "Network.requestWillBeSent":
            self.requests.append(said["request"]["url"])

    def resize(self, width: int, height: int, mobile: bool = False) -> None:
        """Size of the page in px, one a CSS px."""
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=mobile)

    def open(self, file: Path | str) -> None:
        """Open a file, or an address, and wait until it has run."""
        self.complaints.clear()
        self.requests.clear()
        self.call("Page.navigate", url=file if isinstance(file, str) else file.resolve().as_uri())
        self.wait("document.readyState === 'complete'")

    def run(self, code: str) -> Any:
        """Value of an expression; a promise is waited for."""
        said = self.call("Runtime.evaluate", expression=code, awaitPromise=True, returnByValue=True)
        assert "exceptionDetails" not in said, json.dumps(said["exceptionDetails"])[:2000]
        return said["result"].get("value")

    def wait(self, code: str, seconds: float = LIMIT) -> None:
        """Until an expression holds."""
        end = time.monotonic() + seconds
        while not self.run(code):
            assert time.monotonic() < end, f"{code} did not come true in {seconds:.0f} s; {self.complaints}"
            time.sleep(0.05)

    def screenshot(self) -> bytes:
        """PNG of what is seen."""
        return base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])

    def pointer(self, kind: str, x: float, y: float, **more: Any) -> None:
        """A mouse event: mousePressed, mouseMoved, mouseReleased, mouseWheel."""
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **more)

    def key(self, name: str, **more: Any) -> None:
        """A key pressed and released."""
        text = {"text": name} if len(name) == 1 else {}
        self.call("Input.dispatchKeyEvent", type="keyDown", key=name, **text, **more)
        self.call("Input.dispatchKeyEvent", type="keyUp", key=name, **more)


def sized(browser: Browser, width: int, height: int) -> None:
    """Give the canvas of an exported page a size in px, whatever the window's."""
    style = f"flex: none; width: {width}px; height: {height}px"
    browser.run(f"document.getElementById('canvas').style.cssText = '{style}'")
    browser.wait(f"posegaussian.canvas.width === {width} && posegaussian.canvas.height === {height}")


def decoded(address: str) -> np.ndarray:
    """[h, w, 3] uint8 sRGB of a picture as a data address."""
    data = np.frombuffer(base64.b64decode(address.partition(",")[2]), np.uint8)
    picture = cv2.imdecode(data, cv2.IMREAD_COLOR)
    assert picture is not None
    return np.ascontiguousarray(picture[..., ::-1])
