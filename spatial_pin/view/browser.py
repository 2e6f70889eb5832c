"""A browser without a window that is driven from here: it opens, answers, photographs.

It speaks the Chrome DevTools protocol over two pipes: messages end with a zero byte.
"""

from __future__ import annotations

import base64
import contextlib
import json
import os
import select
import shutil
import signal
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

from spatial_pin.errors import SpatialPinError

BROWSERS = (
    "chromium",
    "chromium-browser",
    "google-chrome",
    "google-chrome-stable",
    "chrome",
    "/Applications/Google Chrome.app/Contents/MacOS/Google Chrome",
    "/Applications/Chromium.app/Contents/MacOS/Chromium",
)
OPTIONS = (
    "--headless=new",
    "--no-sandbox",  # the pages are our own and refuse the network
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-dev-shm-usage",  # containers have little of it
    "--disable-extensions",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--hide-scrollbars",
    "--remote-debugging-pipe",  # it reads its file 3, writes its file 4, and ends with them
)
ANSWERED_IN = 60.0  # longest that one thing may take [s]: large pages take many seconds
GRACE = 5.0  # time for a browser to end by itself [s]
POLL = 0.01  # between two looks at something that is not ready yet [s]: short to who waits
PART = 1 << 20  # of a message that is read at a time [bytes]
DOMAINS = ("Page", "Runtime", "Log", "Network")  # whose events are wanted
# The browser ends when our end of its pipes is closed, however that happens. Its children take a
# moment longer, and what they still write keeps the folder from being removed. What it has
# complained about comes last.
STARTER = """folder=$1; shift
"$@" 3<&0 4>&1 </dev/null >/dev/null 2>"$folder/complaints"
tail -c 2000 "$folder/complaints"
for again in 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 20; do
  rm -rf "$folder"; [ -e "$folder" ] || break; sleep 0.2
done
kill -KILL 0
"""
NEXT_PICTURE = "new Promise(done => requestAnimationFrame(() => done(true)))"


def find_browser() -> str | None:
    """Return the program of a Chromium or Chrome on this machine, or None."""
    return next((path for name in BROWSERS if (path := shutil.which(name))), None)


class Browser:
    """One headless Chromium or Chrome with one page; `close` it, or use it in a `with` statement.

    Attributes:
        events: what the page has reported since it was opened, as the protocol words it:
            console messages, exceptions, requests.
    """

    def __init__(self, size: tuple[int, int] = (960, 720)) -> None:
        """Start a browser whose page has a width and a height [pixels]."""
        program = find_browser()
        if program is None:
            raise SpatialPinError(
                "a picture needs Chromium or Chrome, and none was found on the PATH"
            )
        self.events: list[dict[str, Any]] = []
        self._program, self._session, self._questions = program, "", 0
        self._messages, self._parts = list[bytes](), list[bytes]()  # whole ones, and of the next
        self._folder = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        command = [program, *OPTIONS, f"--user-data-dir={self._folder.name}", "about:blank"]
        self._process = subprocess.Popen(
            ["/bin/sh", "-c", STARTER, "sh", self._folder.name, *command], stdin=subprocess.PIPE,
            stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, start_new_session=True)
        assert self._process.stdin is not None and self._process.stdout is not None
        self._to, self._from = self._process.stdin, self._process.stdout
        try:
            pages = self.call("Target.getTargets")["targetInfos"]
            page = next((p["targetId"] for p in pages if p["type"] == "page"), None)
            page = page or self.call("Target.createTarget", url="about:blank")["targetId"]
            attached = self.call("Target.attachToTarget", targetId=page, flatten=True)
            self._session = attached["sessionId"]
            for domain in DOMAINS:
                self.call(f"{domain}.enable")
            self.resize(size)
        except BaseException:
            self.close()
            raise

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Return the result of a method of the DevTools protocol."""
        if self._to.closed:
            raise SpatialPinError("the browser is closed")
        self._questions += 1
        question = {"id": self._questions, "method": method, "params": parameters}
        if self._session:
            question["sessionId"] = self._session
        with contextlib.suppress(BrokenPipeError):  # there is no answer either
            self._to.write(json.dumps(question).encode() + b"\0")
            self._to.flush()
        deadline, answer = time.monotonic() + ANSWERED_IN, dict[str, Any]()
        while answer.get("id") != self._questions:  # what else comes before it is an event
            while not self._messages:
                self._read(method, deadline)
            answer = json.loads(self._messages.pop(0))
            if "method" in answer:
                self.events.append(answer)
        if "error" in answer:
            raise SpatialPinError(f"the browser refuses {method}: {answer['error']['message']}")
        result: dict[str, Any] = answer["result"]
        return result

    def _read(self, method: str, deadline: float) -> None:
        """Read a part of the messages; `method` is what is waited for."""
        left = deadline - time.monotonic()
        if left < 0.0 or not select.select([self._from], [], [], left)[0]:
            raise SpatialPinError(f"the browser has not answered {method} for {ANSWERED_IN:g} s")
        part = os.read(self._from.fileno(), PART)
        if not part and self._session:
            raise SpatialPinError(f"the browser went away during {method}")
        if not part:
            complaint = b"".join(self._parts).decode(errors="replace")
            raise SpatialPinError(f"{self._program} ended at once:\n{complaint}")
        *ends, rest = part.split(b"\0")
        for end in ends:
            self._messages.append(b"".join([*self._parts, end]))
            self._parts.clear()
        self._parts.append(rest)

    # ------------------------------------------------------------ the page

    def resize(self, size: tuple[int, int]) -> None:
        """Make the page width by height pixels; a page asks for it when it is opened."""
        width, height = size
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height,
                  deviceScaleFactor=1, mobile=False)

    def open(self, address: Path | str, ready: str = "true") -> None:
        """Open a file or URL and wait until it is loaded and JavaScript `ready` is true."""
        url = address.resolve().as_uri() if isinstance(address, Path) else address
        self.call("Page.navigate", url="about:blank")  # the same page again begins anew
        self.events.clear()
        failure = self.call("Page.navigate", url=url).get("errorText")
        if failure:
            raise SpatialPinError(f"the browser cannot open {url}: {failure}")
        self.wait_until(f"document.readyState === 'complete' && ({ready})")

    def evaluate(self, script: str) -> Any:
        """Return the value, as plain data, of JavaScript in the page; promises are awaited."""
        answer = self.call("Runtime.evaluate", expression=script, returnByValue=True,
                           awaitPromise=True)
        if "exceptionDetails" in answer:
            details = answer["exceptionDetails"]
            words = details.get("exception", {}).get("description") or details["text"]
            raise SpatialPinError(f"the page fails: {words}")
        return answer["result"].get("value")

    def wait_until(self, condition: str) -> None:
        """Wait until JavaScript in the page is true."""
        end = time.monotonic() + ANSWERED_IN
        while not self.evaluate(f"Boolean({condition})"):
            if time.monotonic() > end:
                raise SpatialPinError(f"waited {ANSWERED_IN:g} s in vain for the page: {condition}")
            time.sleep(POLL)

    def screenshot(self) -> bytes:
        """Return a picture of the page, PNG."""
        self.evaluate(NEXT_PICTURE)
        shot = self.call("Page.captureScreenshot", format="png", optimizeForSpeed=True)
        return base64.b64decode(shot["data"])

    # ------------------------------------------------------------ the end

    def close(self) -> None:
        """End the browser and everything it has started; closing it twice does no harm."""
        with contextlib.suppress(BrokenPipeError):
            self._to.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(GRACE)
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        self._from.close()
        self._folder.cleanup()

    def __enter__(self) -> Browser:
        """Return the browser."""
        return self

    def __exit__(self, *_: object) -> None:
        """End the browser."""
        self.close()

