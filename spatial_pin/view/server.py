"""The page of a motion in the browser, served from this process on this machine only."""

from __future__ import annotations

import atexit
import os
import sys
import threading
import warnings
import webbrowser
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from types import TracebackType
from typing import TYPE_CHECKING, Any

from spatial_pin.errors import SpatialPinError
from spatial_pin.view.html import page

if TYPE_CHECKING:
    from spatial_pin.kinematics.motion import Motion
    from spatial_pin.kinematics.state import State

HOST = "127.0.0.1"
PATIENCE = 15.0  # longest wait for the browser to fetch the page [s]


class _Handler(BaseHTTPRequestHandler):
    """Answers with the server's one page, and with nothing else."""

    server: _Server
    timeout = 10  # a connection that says nothing is closed [s]

    def do_GET(self) -> None:
        """Send the page."""
        if self.path.partition("?")[0] != "/":
            self.send_error(404)
            return
        self.send_response(200)
        self.send_header("Content-Type", "text/html; charset=utf-8")
        self.send_header("Content-Length", str(len(self.server.body)))
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        self.wfile.write(self.server.body)
        self.server.fetched.set()

    def log_message(self, format: str, *args: Any) -> None:
        """Say nothing on stderr."""


class _Server(ThreadingHTTPServer):
    """A server of one page; `fetched` is set once it has been sent."""

    def __init__(self, body: bytes, port: int) -> None:
        super().__init__((HOST, port), _Handler)
        self.body = body
        self.fetched = threading.Event()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore a browser that goes away before it has read the page."""


class Viewer:
    """A page that is being served; `stop` it, or use it in a `with` statement.

    The page plays in the browser without the server, which is only asked for it again when it is
    reloaded. The server is gone when the interpreter exits.

    Attributes:
        url: where the page is.
    """

    def __init__(self, text: str, port: int = 0) -> None:
        """Serve a page.

        Args:
            text: the page.
            port: port on the loopback interface, 0 for any that is free.

        Raises:
            SpatialPinError: the port cannot be had.
        """
        try:
            self._server = _Server(text.encode(), port)
        except OSError as error:
            raise SpatialPinError(
                f"cannot serve a page on {HOST}, port {port}: {error}; "
                f"`export_html` writes the same page to a file"
            ) from error
        self.url = f"http://{HOST}:{self._server.server_address[1]}/"
        self._thread = threading.Thread(
            target=self._server.serve_forever, args=(0.05,), name="spatial_pin viewer", daemon=True
        )
        self._thread.start()
        atexit.register(self.stop)

    @property
    def running(self) -> bool:
        """Whether the page is being served."""
        return self._thread.is_alive()

    def stop(self) -> None:
        """Stop serving; a page already in a browser goes on playing."""
        atexit.unregister(self.stop)
        if self.running:
            self._server.shutdown()
            self._thread.join()
        self._server.server_close()

    def wait(self, timeout: float | None = None) -> None:
        """Wait until `stop` is called or the user presses Ctrl-C, which stops it.

        Args:
            timeout: longest wait [s].
        """
        try:
            self._thread.join(timeout)
        except KeyboardInterrupt:
            self.stop()

    def wait_until_fetched(self, timeout: float) -> bool:
        """Wait until a browser has fetched the page; return whether one did in `timeout` [s]."""
        return self._server.fetched.wait(timeout)

    def __enter__(self) -> Viewer:
        """Return the viewer."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Stop serving."""
        self.stop()

    def __repr__(self) -> str:
        """Return the address, or that it is no longer served."""
        return f"<Viewer at {self.url}>" if self.running else "<Viewer, stopped>"


def _open(viewer: Viewer) -> bool:
    """Open the page in the user's browser; return whether a browser has fetched it."""
    named = any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"))
    if sys.platform.startswith("linux") and not named:
        return False  # only browsers that write text are left, and they would take the terminal
    return webbrowser.open(viewer.url) and viewer.wait_until_fetched(PATIENCE)


def show(motion_or_state: Motion | State, *, open_browser: bool = True) -> Viewer:
    """Show a motion, or a state, in the browser.

    Serves the page of `export_html` on a free port of the loopback interface and returns when the
    browser has it; it then plays on its own. No process is started except the browser. A script
    that ends takes the address away: `show(motion).wait()` keeps it until Ctrl-C.

    Args:
        motion_or_state: what to show.
        open_browser: whether to open a browser; if none can be, a warning gives the address.

    Raises:
        SpatialPinError: no port can be had.
    """
    viewer = Viewer(page(motion_or_state))
    try:
        if open_browser and not _open(viewer):
            message = f"no browser has opened the page: open {viewer.url}"
            warnings.warn(f"{message} (`show(...).wait()` keeps it there)", stacklevel=2)
    except BaseException:
        viewer.stop()
        raise
    return viewer
