"""A browser without a window that is driven from here: it opens, answers, clicks, photographs.

It speaks the Chrome DevTools protocol over tornado's websocket, which meshcat brings along. The
websocket has a thread and an event loop of its own, so that a notebook's running loop is no matter.
"""

from __future__ import annotations

import asyncio
import base64
import contextlib
import json
import os
import queue
import shutil
import signal
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
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
    "--remote-debugging-port=0",  # any that is free, on the loopback interface
)
ANSWERED_IN = 60.0  # longest that one thing may take [s]: large pages take many seconds
GRACE = 5.0  # time for a browser to end by itself [s]
POLL = 0.01  # between two looks at something that is not ready yet [s]: short to who waits
LARGEST_MESSAGE = 1 << 28  # [bytes]: a picture is one message, of 16384 x 16384 at most
DOMAINS = ("Page", "Runtime", "Log", "Network")  # whose events are wanted
# its standard input is our pipe: it ends when we do; the browser's children take a moment longer,
# and what they still write keeps the folder from being removed
COMPANION = """folder=$1; shift; exec 3<&0
(cat <&3 >/dev/null; kill -KILL $$
for again in 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 20; do
  rm -rf "$folder"; [ -e "$folder" ] || break; sleep 0.2
done
kill -KILL 0) >/dev/null 2>&1 &
exec "$@" </dev/null 3<&-
"""
NEXT_PICTURE = "new Promise(done => requestAnimationFrame(() => done(true)))"


def find_browser() -> str | None:
    """Return the program of a Chromium or Chrome on this machine, or None."""
    return next((path for name in BROWSERS if (path := shutil.which(name))), None)


def start(command: Sequence[str], folder: str) -> subprocess.Popen[bytes]:
    """Start a browser that ends with us, however we end.

    It has a process group of its own, and where there is a shell a companion in it, which holds
    the other end of our pipe: once we are gone it ends the group and removes the folder.

    Args:
        command: program and options.
        folder: the browser's own; its messages are written to `stderr` there.
    """
    with (Path(folder) / "stderr").open("wb") as errors:
        if os.name != "posix":
            return subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
                                    stderr=errors)
        return subprocess.Popen(["/bin/sh", "-c", COMPANION, "sh", folder, *command],
                                stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=errors,
                                start_new_session=True)


def address_of(process: subprocess.Popen[bytes], program: str, note: Path) -> str:
    """Return the URL of a browser's websocket, once it has written it into a file."""
    def written() -> list[str]:
        if process.poll() is not None:
            complaint = (note.parent / "stderr").read_text(errors="replace")[-2000:]
            raise SpatialPinError(f"{program} ended at once:\n{complaint}")
        lines = note.read_text().split() if note.is_file() else []
        return lines if len(lines) == 2 else []

    port, path = _patiently(written, f"{program} to start")
    return f"ws://127.0.0.1:{port}{path}"


def end(process: subprocess.Popen[bytes]) -> None:
    """End a browser and its group of processes."""
    if hasattr(os, "killpg"):
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)
    process.kill()
    process.wait()
    if process.stdin is not None:
        process.stdin.close()


class _Websocket:
    """The line to the browser, with a thread and an event loop of its own."""

    def __init__(self, url: str) -> None:
        from tornado.websocket import websocket_connect

        self._messages: queue.SimpleQueue[Any] = queue.SimpleQueue()  # the last one is None
        self._ended = False
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(
            target=self._loop.run_forever, name="spatial_pin devtools", daemon=True
        )
        self._thread.start()

        async def connect() -> Any:
            return await websocket_connect(
                url,
                connect_timeout=ANSWERED_IN,
                on_message_callback=self._messages.put,
                max_message_size=LARGEST_MESSAGE,
            )

        try:
            connection = asyncio.run_coroutine_threadsafe(connect(), self._loop)
            self._socket = connection.result(ANSWERED_IN)
        except BaseException:
            self._end()
            raise

    def send(self, text: str) -> None:
        """Send a message; if the other end is gone, `receive` raises."""
        from tornado.websocket import WebSocketClosedError

        async def write() -> None:
            with contextlib.suppress(WebSocketClosedError):
                await self._socket.write_message(text)

        asyncio.run_coroutine_threadsafe(write(), self._loop).result(ANSWERED_IN)

    def receive(self, timeout: float = ANSWERED_IN) -> str | None:
        """Return the next message, None when there will be no more.

        Raises:
            queue.Empty: there is none within `timeout` [s].
        """
        text = None if self._ended else self._messages.get(timeout=timeout)
        self._ended = text is None
        return text

    def close(self) -> None:
        """Close the websocket and end its thread."""
        self._loop.call_soon_threadsafe(self._socket.close)
        deadline = time.monotonic() + GRACE  # a page may report without end
        with contextlib.suppress(queue.Empty):
            while time.monotonic() < deadline and self.receive(GRACE) is not None:
                pass
        self._end()

    def _end(self) -> None:
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(GRACE)
        self._loop.close()


class Browser:
    """One headless Chromium or Chrome with one page; `close` it, or use it in a `with` statement.

    Attributes:
        events: what the page has reported since it was opened, as the protocol words it:
            console messages, exceptions, requests.
    """

    def __init__(self, size: tuple[int, int] = (960, 720)) -> None:
        """Start a browser.

        Args:
            size: width and height of its page [pixels].
        """
        program = find_browser()
        if program is None:
            raise SpatialPinError(
                "a picture needs Chromium or Chrome, and none was found on the PATH"
            )
        self.events: list[dict[str, Any]] = []
        self._session = ""
        self._questions = 0
        self._line: _Websocket | None = None
        self._folder = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        note = Path(self._folder.name) / "DevToolsActivePort"  # where it writes its address down
        self._process = start([program, *OPTIONS, f"--user-data-dir={note.parent}", "about:blank"],
                              str(note.parent))

        try:
            self._line = _Websocket(address_of(self._process, program, note))
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
        if self._line is None:
            raise SpatialPinError("the browser is closed")
        self._questions += 1
        message = {"id": self._questions, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        self._line.send(json.dumps(message))
        answer = self._answer(method)
        if "error" in answer:
            raise SpatialPinError(f"the browser refuses {method}: {answer['error']['message']}")
        return answer["result"]

    def _answer(self, method: str) -> dict[str, Any]:
        """Return the answer to the last question; what else comes before it is an event."""
        assert self._line is not None
        deadline = time.monotonic() + ANSWERED_IN
        while True:
            try:
                if time.monotonic() > deadline:
                    raise queue.Empty
                text = self._line.receive()
            except queue.Empty:
                raise SpatialPinError(
                    f"the browser has not answered {method} for {ANSWERED_IN:g} s"
                ) from None
            if text is None:
                raise SpatialPinError(f"the browser went away during {method}")
            message = json.loads(text)
            if message.get("id") == self._questions:
                return message
            if "method" in message:
                self.events.append(message)

    # ------------------------------------------------------------ the page

    def resize(self, size: tuple[int, int]) -> None:
        """Make the page width by height pixels; a page asks for it when it is opened."""
        width, height = size
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height,
                  deviceScaleFactor=1, mobile=False)

    def open(self, address: Path | str, ready: str = "true") -> None:
        """Open a page and wait until it is loaded and `ready`.

        Args:
            address: a file, or a URL.
            ready: JavaScript that is true once the page can be used.
        """
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
        """Wait until JavaScript in the page is true.

        Raises:
            SpatialPinError: it is not true in time; the message holds the messages of the page.
        """
        _patiently(lambda: self.evaluate(f"Boolean({condition})"), f"the page: {condition}")

    def screenshot(self) -> bytes:
        """Return a picture of the page, PNG."""
        self.evaluate(NEXT_PICTURE)
        shot = self.call("Page.captureScreenshot", format="png", optimizeForSpeed=True)
        return base64.b64decode(shot["data"])

    def click(self, x: float, y: float) -> None:
        """Click at a point of the page [pixels from its left and upper edge]."""
        for kind, pressed in (("mouseMoved", 0), ("mousePressed", 1), ("mouseReleased", 1)):
            self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, clickCount=pressed,
                      button="left" if pressed else "none")

    # ------------------------------------------------------------ the end

    def close(self) -> None:
        """End the browser and everything it has started; closing it twice does no harm."""
        if self._line is not None:
            self._session = ""
            with contextlib.suppress(Exception):
                self.call("Browser.close")
                self._process.wait(GRACE)
            self._line.close()
            self._line = None
        end(self._process)
        self._folder.cleanup()

    def __enter__(self) -> Browser:
        """Return the browser."""
        return self

    def __exit__(self, *_: object) -> None:
        """End the browser."""
        self.close()


def _patiently(look: Callable[[], Any], what: str) -> Any:
    """Return the first true result of `look`."""
    end = time.monotonic() + ANSWERED_IN
    while not (result := look()):
        if time.monotonic() > end:
            raise SpatialPinError(f"waited {ANSWERED_IN:g} s in vain for {what}")
        time.sleep(POLL)
    return result
