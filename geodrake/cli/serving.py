"""One page on a port of this machine, from memory, for browsers of this machine alone."""

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
        """Say nothing of a client that leaves."""
        if not isinstance(sys.exception(), OSError):
            super().handle_error(request, client_address)


class _PageHandler(BaseHTTPRequestHandler):
    server: PageServer
    timeout = 20.0  # s, for which a client may say nothing

    def do_GET(self) -> None:
        """Answer with the page, and with 404 to any other path."""
        self._answer()

    def do_HEAD(self) -> None:
        """Answer as to GET, without the page itself."""
        self._answer()

    def _answer(self) -> None:
        if not self._is_asked_here():  # a name of somebody else's that leads to this machine
            self.send_error(HTTPStatus.FORBIDDEN, explain="This is for browsers at localhost.")
            return
        found = self.path.partition("?")[0] in ("/", "/index.html")
        body = self.server.page if found else b""
        self.send_response(HTTPStatus.OK if found else HTTPStatus.NOT_FOUND)
        self.send_header("Content-Type", "text/html; charset=utf-8")
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)

    def _is_asked_here(self) -> bool:
        """Return whether the request names this machine as its only `Host`."""
        hosts = self.headers.get_all("Host", [])
        try:
            return [urlsplit(f"//{host}").hostname in _LOCAL for host in hosts] == [True]
        except ValueError:
            return False

    def version_string(self) -> str:
        """Name the server, without versions."""
        return "geodrake"

    def log_message(self, *words: object) -> None:
        """Say nothing: what a browser asks for is no news."""


def page_server(port: int) -> PageServer:
    """Return a server that has its port and serves nothing yet; refuse a port that is not free."""
    if not 0 <= port <= _LARGEST_PORT:
        raise ArgumentError(
            f"--live {port} is no port.",
            advice=f"Ports are 1 to {_LARGEST_PORT}; 0 is any free one.",
        )
    try:
        return PageServer((_HOST, port), _PageHandler)
    except OSError as error:
        raise OutputError(
            f"Port {port} cannot be used: {error.strerror}.",
            advice="Name another one; --live 0 takes any that is free.",
            port=port,
        ) from error


def serve_page(server: PageServer, page: str) -> None:
    """Serve a page until the command is interrupted."""
    server.page = page.encode()
    address = f"http://{_HOST}:{server.server_address[1]}/"
    print(f"Playing at {address}; Ctrl-C ends it.", file=sys.stderr, flush=True)
    server.serve_forever()
