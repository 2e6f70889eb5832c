"""A page in the browser, served from this process to this machine only."""

from __future__ import annotations

import atexit
import html
import json
import os
import secrets
import sys
import threading
import warnings
import webbrowser
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import TYPE_CHECKING, Any, NamedTuple

from spatial_pin._support.checks import checked
from spatial_pin.errors import SpatialPinError
from spatial_pin.view.page.cards import framed, watched
from spatial_pin.view.page.html import page

if TYPE_CHECKING:
    from spatial_pin.assembly.state import State
    from spatial_pin.motion.motion import Motion
    from spatial_pin.synthesis.ranked_designs import Design, Designs
    from spatial_pin.view.scene.look import Look

HOST = "127.0.0.1"
NAMES = (HOST, "localhost")  # that we answer to
FETCHED_IN = 15.0  # longest wait for the browser to fetch the page [s]: a cold one takes seconds
LONGEST_QUESTION = 4096  # of a page to its server [bytes]: a value for each of a hundred drivers
TOKEN = "X-Token"  # header that a question carries its token in


class Service(NamedTuple):
    """Answers of a server to its page: `answer` maps questions to answers, both plain data.

    Its errors go to the page; `token` is a secret that the page sends with every question.
    """

    answer: Callable[[Any], Any]
    token: str


class _Handler(BaseHTTPRequestHandler):
    """Answers with the server's one page, and its page's questions; nothing else, nobody else."""

    server: _Server
    timeout = 10  # a silent connection is closed [s]

    def do_GET(self) -> None:
        """Send the page to who calls us by our name: another site may have its own lead here.

        A page without a service may be seen through a tunnel, whose port is another.
        """
        name, _, port = self.headers.get("Host", "").partition(":")
        is_ours = self._host() is not None or (
            self.server.service is None and name in NAMES and (not port or port.isdigit()))
        if self.path.partition("?")[0] != "/":
            self.send_error(404)
        elif not is_ours:
            self.send_error(403, explain=f"The address of this page is {self.server.url}")
        else:
            self._send("text/html", self.server.body)
            self.server.fetched.set()

    def do_POST(self) -> None:
        """Answer a question of the page."""
        service, host = self.server.service, self._host()
        if service is None or self.path != "/":
            self.send_error(404)
        elif host is None or self.headers.get("Origin") != f"http://{host}" or (
                not secrets.compare_digest(self.headers.get(TOKEN, "").encode(),
                                           service.token.encode())):
            self.send_error(403)  # it is not from the page that we have served
        else:
            given = self.headers.get("Content-Length", "")
            length = int(given) if given.isascii() and given.isdigit() and len(given) < 10 else -1
            if not 0 <= length <= LONGEST_QUESTION:  # also when it is missing
                self.send_error(413)
                return
            try:  # nothing may end the server
                answer = service.answer(json.loads(self.rfile.read(length)))
            except (SpatialPinError, ValueError) as error:
                answer = {"error": str(error)}
            except Exception as error:
                answer = {"error": f"{type(error).__name__}: {error}"}
            self._send("application/json", json.dumps(answer, allow_nan=False).encode())

    def _host(self) -> str | None:
        """Return the name we were called by; None for one that is not ours."""
        host = self.headers.get("Host", "")
        port = self.server.server_address[1]
        return host if host in [f"{name}:{port}" for name in NAMES] else None

    def _send(self, kind: str, body: bytes) -> None:
        self.send_response(200)
        self.send_header("Content-Type", f"{kind}; charset=utf-8")
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: Any) -> None:
        """Say nothing on stderr."""


class _Server(ThreadingHTTPServer):
    """A server of one page; `fetched` is set once it has been sent."""

    def __init__(self, body: bytes, port: int, service: Service | None) -> None:
        super().__init__((HOST, port), _Handler)
        self.body, self.service = body, service
        self.url = f"http://{HOST}:{self.server_address[1]}/"
        self.fetched = threading.Event()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore a browser that goes away before it has read the page."""


class Viewer:
    """A page that is being served; `stop` it, or use it in a `with` statement.

    The page plays in the browser without the server, which computes it again only when it is
    reloaded, or when it has a service. The server is gone when the interpreter exits. In a notebook
    the viewer, as the last value of a cell, is the page itself, stored and exported with it; one
    with a service is shown while it is served, and where it is not, a still page takes its place.

    Attributes:
        url: where the page is.

    Example:
        >>> state = sp.assemble(sp.load("rssr"), {"crank": 1.0})
        >>> viewer = sp.show(state, open_browser=False)
        >>> viewer.running, viewer.url.startswith("http://127.0.0.1:")
        (True, True)
        >>> viewer.stop()
    """

    def __init__(
        self, text: str, port: int = 0, service: Service | None = None,
        still: Callable[[], str] | None = None,
    ) -> None:
        """Serve a page.

        Args:
            text: the page.
            port: port on the loopback interface, 0 for any that is free.
            service: answers to the page.
            still: makes a page that a notebook shows where that of a service is not served.

        Raises:
            SpatialPinError: the port cannot be had.
            ValueError: it is no port.
        """
        try:
            self._server = _Server(text.encode(), port, service)
        except OverflowError:
            raise ValueError(f"port is {port}; it is 0 for any that is free, to 65535") from None
        except OSError as error:
            raise SpatialPinError(
                f"cannot serve a page on {HOST}, port {port}: {error}; "
                f"`export_html` writes the same page to a file"
            ) from error
        self.url, self._still = self._server.url, still
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
        """Stop serving; a page already in a browser goes on playing.

        Example:
            >>> viewer = sp.show(sp.assemble(sp.load("rssr"), {"crank": 1.0}), open_browser=False)
            >>> viewer.stop()
        """
        atexit.unregister(self.stop)
        if self.running:
            self._server.shutdown()
            self._thread.join()
        self._server.server_close()

    def wait(self, timeout: float | None = None) -> None:
        """Wait until `stop` is called or the user presses Ctrl-C, which stops it.

        Args:
            timeout: longest wait [s].

        Example:
            >>> viewer = sp.show(sp.assemble(sp.load("rssr"), {"crank": 1.0}), open_browser=False)
            >>> viewer.wait(timeout=0.01)  # [s]
            >>> viewer.stop()
        """
        try:
            self._thread.join(timeout)
        except KeyboardInterrupt:
            self.stop()

    def wait_until_fetched(self, timeout: float) -> bool:
        """Wait until a browser has fetched the page.

        Args:
            timeout: longest wait [s].

        Returns:
            Whether one has.

        Example:
            >>> viewer = sp.show(sp.assemble(sp.load("rssr"), {"crank": 1.0}), open_browser=False)
            >>> viewer.wait_until_fetched(timeout=0.01)  # [s]; no browser was opened
            False
            >>> viewer.stop()
        """
        return self._server.fetched.wait(timeout)

    def __enter__(self) -> Viewer:
        """Return the viewer."""
        return self

    def __exit__(self, *_: object) -> None:
        """Stop serving."""
        self.stop()

    def __repr__(self) -> str:
        """Return the address, or that it is no longer served."""
        return f"<Viewer at {self.url}>" if self.running else "<Viewer, stopped>"

    def _repr_html_(self) -> str:
        """Return the page in a frame, for a notebook."""
        if self._server.service is None:
            return framed(self._server.body.decode())
        if not self.running:
            return html.escape(repr(self))
        return watched(self.url, self._still() if self._still else html.escape(repr(self)))


def open_in_browser(viewer: Viewer, verb: str) -> None:
    """Open a page in the user's browser; if none can be, stop it or warn with the address.

    In a notebook nothing is opened: there the viewer shows itself. `verb` is what the user called.
    """
    named = any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"))
    # without one only browsers that write text are left, and they would take the terminal
    has_browser = named or not sys.platform.startswith("linux")
    ipython = sys.modules.get("IPython")  # a kernel: importing parts of notebooks is not it
    is_in_notebook = ipython is not None and hasattr(ipython.get_ipython(), "kernel")
    try:
        if is_in_notebook or (has_browser and webbrowser.open(
                viewer.url) and viewer.wait_until_fetched(FETCHED_IN)):
            return
        message = f"no browser has opened the page: open {viewer.url}"
        warnings.warn(f"{message} (`{verb}(...).wait()` keeps it there)", stacklevel=3)
    except BaseException:
        viewer.stop()
        raise


@checked
def show(
    motion_or_state: Motion | State | Design | Designs,
    *,
    look: Look | None = None,
    open_browser: bool = True,
) -> Viewer:
    """Show a motion, a state, or a design with its goals in the browser.

    Serves the page of `export_html` on a free port of the loopback interface and returns when the
    browser has it; it then plays on its own. No process is started except the browser. The page
    ends with the script: `show(motion).wait()` keeps it until Ctrl-C.

    Args:
        motion_or_state: a motion or a state; a design as in `export_html`.
        look: extras of the picture besides the bodies.
        open_browser: whether to open a browser; if none can be, a warning gives the address.

    Returns:
        The Viewer that serves the page.

    Raises:
        SpatialPinError: no port can be had.
        UnknownNameError: `look` names a point or vector that does not exist.

    Example:
        >>> state = sp.assemble(sp.load("rssr"), {"crank": 1.0})
        >>> viewer = sp.show(state, open_browser=False)
        >>> viewer.url.startswith("http://127.0.0.1:")
        True
        >>> viewer.stop()  # a script that is to go on showing waits: viewer.wait()
    """
    viewer = Viewer(page(motion_or_state, look=look))
    if open_browser:
        open_in_browser(viewer, "show")
    return viewer
