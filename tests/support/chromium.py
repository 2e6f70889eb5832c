"""The one browser that all tests of pages share, and when its pages are ready.

It is the browser with which the library itself takes pictures: nothing else drives one here.
"""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from spatial_pin.view.browser import NEXT_PICTURE, Browser, find_browser
from spatial_pin.view.pictures import READY, open_page, shoot

__all__ = ["NEXT_PICTURE", "READY", "Browser", "browser", "click_at", "complaints", "find_browser",
           "needs_browser", "one_browser", "open_page", "shoot"]

needs_browser = pytest.mark.skipif(
    find_browser() is None, reason="no Chromium or Chrome on this machine: pictures not checked"
)


@pytest.fixture(scope="session")
def one_browser() -> Iterator[Browser]:
    """The browser of all tests; each makes its page as large as it needs it."""
    with Browser() as browser:
        yield browser


def click_at(browser: Browser, x: float, y: float) -> None:
    """Click at a point of the page [pixels from its left and upper edge]."""
    for kind, pressed in (("mouseMoved", 0), ("mousePressed", 1), ("mouseReleased", 1)):
        browser.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, clickCount=pressed,
                     button="left" if pressed else "none")


def complaints(browser: Browser) -> list[str]:
    """Errors on the console, exceptions, and requests that leave the page."""
    browser.evaluate("1")  # what was reported before has arrived now
    found = []
    for event in browser.events:
        method, said = event["method"], event["params"]
        if method == "Runtime.exceptionThrown":
            found.append(str(said["exceptionDetails"]))
        elif method == "Runtime.consoleAPICalled" and said["type"] in ("error", "assert"):
            found.append(str(said["args"]))
        elif method == "Log.entryAdded" and said["entry"]["level"] == "error":
            found.append(said["entry"]["text"])
        elif method == "Network.requestWillBeSent":
            url = said["request"]["url"]
            own = url.startswith(("file:", "data:", "blob:", "about:", "http://127.0.0.1:"))
            found += [] if own else [url]
    return found


@pytest.fixture
def browser(one_browser: Browser, request: pytest.FixtureRequest) -> Iterator[Browser]:
    """The browser of all tests, as large as the module says, without a complaint after each."""
    one_browser.resize(request.module.SIZE)
    yield one_browser
    assert complaints(one_browser) == []
