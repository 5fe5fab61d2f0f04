"""One page on a port of this machine, from memory."""

from __future__ import annotations

import sys
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

from geodrake.errors import ArgumentError, OutputError

_HOST = "localhost"
_LARGEST_PORT = 65535


class PageServer(ThreadingHTTPServer):
    """A server of one page.

    Attributes:
        page: The page, UTF-8.
    """

    daemon_threads = True
    page: bytes = b""


class _PageHandler(BaseHTTPRequestHandler):
    server: PageServer

    def do_GET(self) -> None:
        """Answers with the page, or that there is nothing else."""
        found = self.path.partition("?")[0] in ("/", "/index.html")
        body = self.server.page if found else b""
        self.send_response(200 if found else 404)
        self.send_header("Content-Type", "text/html; charset=utf-8")
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *words: object) -> None:
        """Says nothing: what a browser asks for is no news."""


def page_server(port: int) -> PageServer:
    """A server that has its port, and serves nothing yet.

    Args:
        port: The port; 0 for any that is free.

    Raises:
        ArgumentError: It is none.
        OutputError: It cannot be had.
    """
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
    """Serve a page until the command is interrupted.

    Args:
        server: What `page_server` gave.
        page: The page.
    """
    server.page = page.encode()
    address = f"http://{_HOST}:{server.server_address[1]}/"
    print(f"Playing at {address}; Ctrl-C ends it.", file=sys.stderr, flush=True)
    server.serve_forever()
