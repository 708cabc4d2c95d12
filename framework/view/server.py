"""Serves one page on this machine; every path but `/` is an error.

The server is bound to 127.0.0.1, so other machines cannot reach it. Requests with another host name
are refused. Otherwise a web page whose name resolves to 127.0.0.1 could read what is served (DNS
rebinding).
"""

import os
import sys
import threading
import webbrowser
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from framework.errors import UserError

HOST = "127.0.0.1"
PATIENCE_S = 30.0  # for an incomplete request


class PageServer(ThreadingHTTPServer):
    """Serves `page` under `address`.

    Args:
        port: 0 for any free one.

    Raises:
        UserError: if the port is not available.
    """

    daemon_threads = True

    def __init__(self, page: str, port: int = 0) -> None:
        self.page = page.encode("utf-8")
        try:
            super().__init__((HOST, port), _Handler)
        except OSError as error:
            reason = error.strerror or str(error)
            raise UserError(
                f"--port: expected a free port, got {port} ({reason}); leave it out to take any"
            ) from None

    @property
    def address(self) -> str:
        """The URL of the page."""
        return f"http://{HOST}:{self.server_port}/"

    @property
    def hosts(self) -> set[str]:
        """Host names that requests may use."""
        return {f"{name}:{self.server_port}" for name in (HOST, "localhost")}

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore browsers that closed the connection."""
        if not isinstance(sys.exception(), OSError):
            super().handle_error(request, client_address)


class _Handler(BaseHTTPRequestHandler):
    server: PageServer
    timeout = PATIENCE_S
    server_version, sys_version = "fishersplat", ""

    def do_GET(self) -> None:
        self._answer(body=True)

    def do_HEAD(self) -> None:
        self._answer(body=False)

    def _answer(self, body: bool) -> None:
        if self.headers.get("Host") not in self.server.hosts:
            return self.send_error(403, "Use localhost")
        if self.path.partition("?")[0] != "/":
            return self.send_error(404)
        self.send_response(200)
        self.send_header("Content-Type", "text/html; charset=utf-8")
        self.send_header("Content-Length", str(len(self.server.page)))
        self.send_header("Cache-Control", "no-store")
        self.send_header("X-Content-Type-Options", "nosniff")
        self.send_header("Cross-Origin-Resource-Policy", "same-origin")
        self.end_headers()
        if body:
            self.wfile.write(self.server.page)

    def log_message(self, format: str, *arguments: Any) -> None:
        """Log nothing."""


def show(page: str, port: int, browse: bool) -> None:
    """Serve the page until Ctrl-C and print its URL.

    Args:
        browse: open a browser, if there is one.
    """
    with PageServer(page, port) as server:
        seen = browse and _has_screen()
        hint = "" if seen or not browse else "; no screen here: open it where there is one"
        print(f"view: {server.address} (Ctrl-C ends it{hint})", flush=True)
        if seen:
            threading.Thread(target=_open, args=(server.address,), daemon=True).start()
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            print("view: ended")


def _has_screen() -> bool:
    """Whether a browser would have a window."""
    if os.environ.get("BROWSER") or not sys.platform.startswith("linux"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def _open(address: str) -> None:
    try:
        opened = webbrowser.open(address)
    except (OSError, webbrowser.Error):
        opened = False
    if not opened:
        print(f"view: no browser was found; open {address} in one", flush=True)
