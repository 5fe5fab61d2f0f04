"""The command `geodrake play`: logs replayed on the robot, coloured by error."""

from __future__ import annotations

from pathlib import Path

from geodrake.boundary.arguments import positive
from geodrake.cli.command import Command, Input, Output, run
from geodrake.cli.options import PlayOptions
from geodrake.cli.rollout import other_model
from geodrake.cli.serving import page_server, serve_page
from geodrake.model.robot_model import RobotModel, read_again
from geodrake.model.saved_model import is_saved_model
from geodrake.report.pictures import check_video, video
from geodrake.report.play_page import play_page
from geodrake.report.playback import Playback, play_back
from geodrake.report.recordings import check_viewer, recording

DEFAULT_OUT = Path("play.html")


def run_play(options: PlayOptions) -> None:
    """Replay logs on the robot, in files or on a local port."""
    positive(options.speed, "--speed")
    positive(options.seconds, "--seconds")
    if options.ghost is not None:
        positive(options.ghost, "--ghost")
    if options.video is not None:
        check_video(options.video)
    to, recorded = options.to or (None, None)
    if to is not None and recorded is not None:
        check_viewer(to, recorded)
    asked = (options.out, options.live, options.video, recorded)
    out = DEFAULT_OUT if asked == (None,) * 4 else options.out
    server = None if options.live is None else page_server(options.live)

    title, speed = f"{options.model.name}: play", options.speed

    def played(given: Input) -> Playback:
        return play_back(
            given.model,
            given.logs,
            before=_before(options, given),
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
        "out": Output(out, "page that plays the logs", make=page),
        "video": Output(
            options.video,
            "video",
            (".mp4", ".gif"),
            lambda found: video(found, (options.video or Path()).suffix.lower(), speed=speed),
        ),
        "to": Output(
            recorded,
            "recording",
            (".rrd", ".mcap"),
            lambda found: recording(to or "", found, title=title),
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


def _before(options: PlayOptions, given: Input) -> RobotModel | None:
    """Return the model to compare with: the one named, or the file behind a saved model."""
    if options.before is not None:
        return other_model(options.before, given)
    return read_again(given.model) if is_saved_model(options.model) else None
