"""One page on a port of this machine, from memory, for browsers of this machine alone."""

from __future__ import annotations

import socket
import sys
import threading
from contextlib import suppress
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import urlsplit

from geodrake.errors import ArgumentError, OutputError

_HOST = "localhost"
_LOCAL = (_HOST, "127.0.0.1", "::1")
_LARGEST_PORT = 65535
_MOST_CONNECTIONS = 16  # at once
_SECONDS = 20.0  # for a connection from its begin to its end


class PageServer(ThreadingHTTPServer):
    """A server of one page, to a few clients at once, each of which has a limited time."""

    daemon_threads = True
    page: bytes = b""  # UTF-8
    seconds = _SECONDS  # for which a connection may last

    def __init__(self, port: int) -> None:
        super().__init__((_HOST, port), _PageHandler)
        self._free = threading.Semaphore(_MOST_CONNECTIONS)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer in a thread of its own, or hang up if there are too many clients."""
        if self._free.acquire(blocking=False):
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Answer, and hang up on a client that takes too long, however little it sends at once."""
        limit = threading.Timer(self.seconds, _hang_up, [request])
        limit.daemon = True
        limit.start()
        try:
            super().process_request_thread(request, client_address)
        finally:
            limit.cancel()
            self._free.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing of a client that leaves."""
        if not isinstance(sys.exception(), OSError):
            super().handle_error(request, client_address)


class _PageHandler(BaseHTTPRequestHandler):
    server: PageServer

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


def _hang_up(request: socket.socket) -> None:
    with suppress(OSError):  # it has hung up itself
        request.shutdown(socket.SHUT_RDWR)


def page_server(port: int) -> PageServer:
    """Return a server that has its port and serves nothing yet; refuse a port that is not free."""
    if not 0 <= port <= _LARGEST_PORT:
        raise ArgumentError(
            f"--live {port} is no port.",
            advice=f"Ports are 1 to {_LARGEST_PORT}; 0 is any free one.",
        )
    try:
        return PageServer(port)
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
