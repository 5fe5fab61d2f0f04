"""A local server of one page, for browsers on this machine."""

from __future__ import annotations

import sys
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import urlsplit

from geodrake.errors import ArgumentError, OutputError

_HOST = "localhost"
_LOCAL = (_HOST, "127.0.0.1", "::1")
_LARGEST_PORT = 65535


class PageServer(ThreadingHTTPServer):
    """A server of one page."""

    daemon_threads = True
    page: bytes = b""  # UTF-8

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore clients that disconnect."""
        if not isinstance(sys.exception(), OSError):
            super().handle_error(request, client_address)


class _PageHandler(BaseHTTPRequestHandler):
    server: PageServer
    timeout = 20.0  # s without a request after which a client is disconnected

    def do_GET(self) -> None:
        """Answer with the page, and with 404 to any other path."""
        self._answer()

    def do_HEAD(self) -> None:
        """Answer as to GET, without the page itself."""
        self._answer()

    def _answer(self) -> None:
        if not self._is_local():  # against DNS rebinding
            self.send_error(HTTPStatus.FORBIDDEN, explain="This page is for localhost only.")
            return
        found = self.path.partition("?")[0] in ("/", "/index.html")
        body = self.server.page if found else b""
        self.send_response(HTTPStatus.OK if found else HTTPStatus.NOT_FOUND)
        self.send_header("Content-Type", "text/html; charset=utf-8")
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)

    def _is_local(self) -> bool:
        """Return whether the only `Host` of the request is this machine."""
        hosts = self.headers.get_all("Host", [])
        try:
            return [urlsplit(f"//{host}").hostname in _LOCAL for host in hosts] == [True]
        except ValueError:
            return False

    def version_string(self) -> str:
        """Name the server, without versions."""
        return "geodrake"

    def log_message(self, *words: object) -> None:
        """Log nothing."""


def page_server(port: int) -> PageServer:
    """Return a server bound to a port; raise if the port is not free."""
    if not 0 <= port <= _LARGEST_PORT:
        raise ArgumentError(
            f"--live {port} is not a port.",
            advice=f"Use 1 to {_LARGEST_PORT}, or 0 for any free port.",
        )
    try:
        return PageServer((_HOST, port), _PageHandler)
    except OSError as error:
        raise OutputError(
            f"Port {port} cannot be used: {error.strerror}.",
            advice="Use another port, or --live 0 for any free one.",
            port=port,
        ) from error


def serve_page(server: PageServer, page: str) -> None:
    """Serve a page until the command is interrupted."""
    server.page = page.encode()
    address = f"http://{_HOST}:{server.server_address[1]}/"
    print(f"Playing at {address}; Ctrl-C to stop.", file=sys.stderr, flush=True)
    server.serve_forever()
