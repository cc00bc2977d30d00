"""The served page in a real browser: a frame shows once it is written, and one that is made anew is said."""

from __future__ import annotations

import numpy as np
import pytest

from tests.dags.view.test_view import serving, unfinish
from tests.support.browser import Browser
from tests.support.drawn import decoded_picture
from tests.support.pipeline import NAME, Pipeline

SAID = "document.getElementById('live').textContent"


def test_a_frame_shows_once_it_is_written(made: Pipeline, tmp_path_factory: pytest.TempPathFactory) -> None:
    archive = made.copy(tmp_path_factory.mktemp("live") / "archive")
    with Browser(800, 700) as browser, serving(archive) as server:
        taken = [unfinish(archive, partition) for partition in (0, 1)]
        browser.open(f"{server.url}{NAME}/")
        browser.wait(f"document.getElementById('live') && {SAID}.startsWith('Live: 0 of 4 frames.')")
        assert "No frame is finished yet" in browser.run("document.getElementById('message').textContent")
        assert browser.run("document.getElementById('time').textContent").startswith("no frame yet")

        taken[0][0].write_bytes(taken[0][1])
        browser.wait(f"{SAID}.startsWith('Live: 2 of 4 frames.')")
        browser.wait("document.getElementById('message').hidden")
        browser.run("posegaussian.seek(2)")  # not there: the last one before it is shown, and said
        second = decoded_picture(browser)
        assert browser.run("document.getElementById('time').textContent").startswith("frame 1 ")
        assert len(np.unique(second.reshape(-1, 3), axis=0)) > 10, "somebody is there"

        taken[1][0].write_bytes(taken[1][1])
        browser.wait(f"{SAID}.startsWith('Live: 4 of 4 frames.')")
        third = decoded_picture(browser)
        assert browser.run("document.getElementById('time').textContent").startswith("frame 2 ")
        assert (second != third).any(axis=-1).mean() > 0.005

        unfinish(archive, 0)
        browser.wait(f"{SAID}.includes('2 of them made anew just now, shown as before')")
        assert browser.complaints == []
        outside = {a for a in browser.requests if not a.startswith((server.url, "blob:", "data:"))}
        assert outside == set()
    with Browser(800, 700) as browser:  # a server that has ended is said, too
        with serving(made) as server:
            browser.open(f"{server.url}{NAME}/")
            browser.wait(f"document.getElementById('live') && {SAID}.startsWith('Live: 4 of 4 frames.')")
        browser.wait(f"{SAID}.startsWith('The server does not answer')")
