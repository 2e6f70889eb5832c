"""A live page without a browser: opened, and asked as its own script asks."""

from __future__ import annotations

import http.client
import json
import re
import urllib.request

import spatial_pin as sp

LONGEST_QUESTION = 4096  # of a page to its server [bytes]


def opened(name: str, *, dimensions=None, **options) -> sp.Viewer:
    return sp.live(sp.load(name, **(dimensions or {})), open_browser=False, **options)


def text_of(viewer: sp.Viewer) -> str:
    with urllib.request.urlopen(viewer.url, timeout=10) as answer:
        return answer.read().decode()


def live_data(viewer: sp.Viewer) -> dict:
    pattern = r'<script type="application/json" id="live">(.*?)</script>'
    return json.loads(re.search(pattern, text_of(viewer), re.S)[1])


def headers_of(viewer: sp.Viewer) -> dict[str, str]:
    return {"Origin": viewer.url.rstrip("/"), "X-Token": live_data(viewer)["token"]}


def post(viewer: sp.Viewer, body: bytes, headers: dict[str, str]) -> tuple[int, bytes]:
    """Status and body of the answer to a question."""
    port = int(viewer.url.rsplit(":", 1)[1].strip("/"))
    line = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
    line.request("POST", "/", body, headers)
    answer = line.getresponse()
    found = answer.status, answer.read()
    line.close()
    return found


class Page:
    """What the script of the page does, without a browser."""

    def __init__(self, viewer: sp.Viewer) -> None:
        self.viewer, self.headers = viewer, headers_of(viewer)

    def ask(self, kind: str, **question) -> dict:
        body = json.dumps({"ask": kind, **question}).encode()
        status, answer = post(self.viewer, body, self.headers)
        assert status == 200
        return json.loads(answer)

    def move(self, driver: str, value: float) -> dict:
        return self.ask("move", driver=driver, value=value)


def port_of(viewer: sp.Viewer) -> str:
    return viewer.url.rsplit(":", 1)[1].strip("/")
