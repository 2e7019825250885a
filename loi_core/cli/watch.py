"""``loi fit --watch``: a page on this machine alone that follows a fit."""

from __future__ import annotations

import contextlib
import json
import os
import socketserver
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, ClassVar, Final
from urllib.parse import parse_qs, urlsplit

from loi_core.errors import OptionError
from loi_core.report.live import Live, live_page
from loi_core.scenes.scene import Scene

__all__ = ["Watched", "check_port", "watched"]

LOOPBACK: Final = "127.0.0.1"
LAST_PORT: Final = 65535
GRACE: Final = 3.0  # seconds that a page which is open has to fetch the report
OPEN: Final = 2.0  # seconds since it last asked

HEADERS: Final = {
    "Cache-Control": "no-store",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "X-Frame-Options": "DENY",
}


def check_port(port: int | None, *, watch: bool) -> None:
    """Raise :class:`OptionError` for a port that is none, or that nobody would listen on."""
    if port is None:
        return
    if not watch:
        msg = "`--port` goes with `--watch`; without it nothing is served"
        raise OptionError(msg)
    if not 1 <= port <= LAST_PORT:
        msg = f"`--port` must be from 1 to {LAST_PORT}, got {port}"
        raise OptionError(msg)


@dataclass(frozen=True)
class Watched:
    """A page that is served.

    Attributes
    ----------
    live : Live
        What it follows.
    address : str
    """

    live: Live
    address: str

    def stay(self) -> None:
        """Serve it until Ctrl-C."""
        print(f"loi: {self.address} is the report now; Ctrl-C ends", file=sys.stderr, flush=True)
        with contextlib.suppress(KeyboardInterrupt):
            while True:
                time.sleep(1.0)


@contextlib.contextmanager
def watched(scene: Scene, port: int | None) -> Iterator[Watched]:
    """Serve a page that follows a fit, and print its address on standard error.

    At the end a page that is open gets the report before nobody answers it any more.

    Parameters
    ----------
    scene : Scene
    port : int, optional
        A free one by default.

    Raises
    ------
    OptionError
        If the port is taken.
    """
    live = Live(scene)
    try:
        server = _Server((LOOPBACK, port or 0), _handler(live, live_page(scene, live)))
    except OSError as error:
        msg = f"`--port` {port} cannot be used ({error.strerror}); name another, or leave it out for a free one"
        raise OptionError(msg) from error
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.1}, daemon=True)
    thread.start()
    address = f"http://{LOOPBACK}:{server.server_address[1]}/"
    print(f"loi: follow the fit at {address}", file=sys.stderr, flush=True)
    try:
        yield Watched(live, address)
        if live.page and live.followed(OPEN):
            server.fetched.wait(GRACE)
    finally:
        server.shutdown()
        server.server_close()


class _Server(ThreadingHTTPServer):
    """On this machine alone, and without asking for its name."""

    daemon_threads = True
    allow_reuse_address = os.name != "nt"  # on Windows two could have one port

    def __init__(self, *arguments: Any) -> None:
        self.fetched = threading.Event()  # the report
        super().__init__(*arguments)

    def server_bind(self) -> None:
        """As that of TCP: that of HTTP looks the name of the machine up, which may take long."""
        socketserver.TCPServer.server_bind(self)
        self.server_name, self.server_port = LOOPBACK, int(self.server_address[1])

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A browser that goes away is no error of the fit."""


def _handler(live: Live, page: str) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        """The page, its state and its newest image: nothing else, and nothing from the disk."""

        server: _Server
        server_version = "loi"
        sys_version = ""
        timeout: ClassVar[float] = 10.0

        def do_GET(self) -> None:
            port = self.server.server_port
            # A name that somebody else has made lead here is not ours.
            if self.headers.get("Host") not in (f"{LOOPBACK}:{port}", f"localhost:{port}"):
                self._answer(HTTPStatus.FORBIDDEN, "text/plain", b"this address only\n")
                return
            asked = urlsplit(self.path)
            if asked.path == "/":
                done = live.page
                self._answer(HTTPStatus.OK, "text/html; charset=utf-8", (done or page).encode("utf-8", "replace"))
                if done:
                    self.server.fetched.set()
            elif asked.path == "/state":
                known = parse_qs(asked.query).get("known", ["0"])[0]
                state = live.state(int(known) if known.isascii() and known.isdecimal() and len(known) < 12 else 0)
                self._answer(HTTPStatus.OK, "application/json", json.dumps(state).encode("ascii"))
            elif asked.path == "/frame.png" and (picture := live.picture()):
                self._answer(HTTPStatus.OK, "image/png", picture)
            elif asked.path == "/favicon.ico":  # every browser asks for one
                self._answer(HTTPStatus.NO_CONTENT, "image/x-icon", b"")
            else:
                self._answer(HTTPStatus.NOT_FOUND, "text/plain", b"no such page\n")

        def _answer(self, status: HTTPStatus, kind: str, content: bytes) -> None:
            self.send_response(status)
            for name, value in {**HEADERS, "Content-Type": kind, "Content-Length": str(len(content))}.items():
                self.send_header(name, value)
            self.end_headers()
            self.wfile.write(content)

        def log_message(self, *_: object) -> None:
            """Say nothing: the terminal shows the fit."""

    return Handler
