"""The command `geodrake play`: logs replayed on the robot, coloured by error, or served."""

from __future__ import annotations

import sys
from dataclasses import replace
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from geodrake.boundary.arguments import positive
from geodrake.cli.command import Command, Input, Output, run
from geodrake.cli.options import PlayOptions
from geodrake.cli.rollout import other_model
from geodrake.errors import ArgumentError, OutputError
from geodrake.model.robot_model import read_again
from geodrake.model.saved_model import is_saved_model
from geodrake.report.meshcat_scene import play_page
from geodrake.report.playback import Playback, play_back
from geodrake.report.recordings import check_viewer, recording
from geodrake.report.videos import check_video, video

DEFAULT_OUT = Path("play.html")
_HOST = "localhost"
_LOCAL = (_HOST, "127.0.0.1", "::1")
_LARGEST_PORT = 65535


def run_play(options: PlayOptions) -> None:
    """Run `geodrake play`: replay logs on the robot, in files or on a local port."""
    positive(options.speed, "--speed")
    positive(options.seconds, "--seconds")
    if options.ghost is not None:
        positive(options.ghost, "--ghost")
    if options.video is not None:
        check_video(options.video)
    to, recorded = options.to or (None, None)
    if to is not None and recorded is not None:
        check_viewer(to, recorded)
    if (options.out, options.live, options.video, recorded) == (None,) * 4:
        options = replace(options, out=DEFAULT_OUT)
    server = None if options.live is None else page_server(options.live)

    title, speed = f"{options.model.name}: play", options.speed

    def played(given: Input) -> Playback:
        before = None
        if options.before is not None:
            before = other_model(options.before, given)
        elif is_saved_model(options.model):  # compare with its base file
            before = read_again(given.model)
        return play_back(
            given.model,
            given.logs,
            before=before,
            extra=given.extra,
            seconds=options.seconds,
            ghost=options.ghost,
            progress=given.progress,
            **given.settings,
        )

    def page(found: Playback) -> str:
        return play_page(
            found, title=title, log_names=[log.name for log in options.logs], speed=speed
        )

    outputs = {
        "out": Output("page that plays the logs", make=lambda found, path: page(found)),
        "video": Output(
            "video",
            (".mp4", ".gif"),
            lambda found, path: video(found, path.suffix.lower(), speed=speed),
        ),
        "to": Output(
            "recording",
            (".rrd", ".mcap"),
            lambda found, path: recording(to or "", found, title=title),
        ),
    }
    command = Command("play", "Comparing", played, outputs=outputs)
    try:
        found = run(command, options)
        if server is not None:
            serve_page(server, page(found))
    finally:
        if server is not None:
            server.server_close()


class PageServer(ThreadingHTTPServer):
    """A server of a single page."""

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
        """Send the page, or 404 for any other path."""
        hosts = self.headers.get_all("Host", [])
        try:
            is_local = [urlsplit(f"//{host}").hostname in _LOCAL for host in hosts] == [True]
        except ValueError:
            is_local = False
        if not is_local:  # prevents DNS rebinding
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

    do_HEAD = do_GET  # noqa: N815

    def version_string(self) -> str:
        """Return the name of the server without versions."""
        return "geodrake"

    def log_message(self, *words: object) -> None:
        """Log nothing."""


def page_server(port: int) -> PageServer:
    """Return a server bound to a port, which must be free."""
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
