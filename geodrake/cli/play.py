"""The command `geodrake play`: logs played over the robot, coloured where the model fails."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console

from geodrake.boundary.arguments import positive
from geodrake.cli.options import PlayOptions
from geodrake.cli.rollout import other_model
from geodrake.cli.serving import page_server, serve_page
from geodrake.cli.session import Command, Input, run
from geodrake.cli.tables import head, say, show_list
from geodrake.model.robot_model import RobotModel, read_again
from geodrake.model.saved_model import is_saved_model
from geodrake.report.numbers import Units, number, percent
from geodrake.report.recordings import check_viewer, recording
from geodrake.report.video import check_video, video

if TYPE_CHECKING:
    from geodrake.cli.session import Maker
    from geodrake.report.playback import Moment, Playback
    from geodrake.robot.shapes import RobotShapes

DEFAULT_OUT = Path("play.html")


def run_play(options: PlayOptions) -> None:
    """Run the command.

    Raises:
        GeodrakeError: Something about the input, or about the targets, does not do.
    """
    positive(options.speed, "--speed")
    positive(options.seconds, "--seconds")
    if options.video is not None:
        check_video(options.video)
    to, recorded = options.to or (None, None)
    if to is not None and recorded is not None:
        check_viewer(to, recorded)
    asked = (options.out, options.live, options.video, recorded)
    out = DEFAULT_OUT if asked == (None,) * 4 else options.out
    server = None if options.live is None else page_server(options.live)
    found: list[Playback] = []
    looks: list[RobotShapes] = []

    def played(given: Input) -> Playback:
        from geodrake.report.playback import play_back
        from geodrake.report.posed_links import drawn_shapes

        found.append(
            play_back(
                given.model,
                given.logs,
                before=_before(options, given),
                extra=given.extra,
                seconds=options.seconds,
                **given.settings,
            )
        )
        looks.append(drawn_shapes(found[0].models[-1].model))
        return found[0]

    def page(playback: Playback) -> str:
        from geodrake.report.play_page import play_page

        return play_page(
            playback,
            title=f"{options.model.name}: play",
            log_names=[log.name for log in options.logs],
            units=Units.of(playback.models[-1].model),
            speed=options.speed,
            shapes=looks[0],
        )

    def makers(playback: Playback) -> dict[str, Maker]:
        title, units = f"{options.model.name}: play", Units.of(playback.models[-1].model)
        made: dict[str, Maker] = {"out": lambda: page(playback)}
        if (file := options.video) is not None:
            made["video"] = lambda: video(
                playback, looks[0], file.suffix.lower(), units=units, speed=options.speed
            )
        if to is not None:
            made["to"] = lambda: recording(to, playback, looks[0], title=title, units=units)
        return made

    def show(console: Console, playback: Playback, units: Units) -> None:
        _show(console, playback, looks[0].notes, units)

    try:
        run(
            Command(
                "play",
                "Comparing",
                played,
                playback_dict,
                "render_comparison",
                show,
                paged=lambda playback: playback.models[-1].comparison,
                more={"out": out, "video": options.video, "to": recorded},
                makers=makers,
                saved={"out": "page that plays the logs", "video": "video", "to": "recording"},
            ),
            options,
        )
        if server is not None:
            serve_page(server, page(found[0]))
    finally:
        if server is not None:
            server.server_close()


def _before(options: PlayOptions, given: Input) -> RobotModel | None:
    """The model to compare with: the one named, or the file that a saved model is based on."""
    if options.before is not None:
        return other_model(options.before, given)
    if is_saved_model(options.model):
        return read_again(given.model)
    return None


def playback_dict(playback: Playback) -> dict[str, Any]:
    """What is played, and where the models err most, as JSON has it."""
    return {
        "models": [
            {
                "title": played.title,
                "file": str(played.model.path),
                "nrms": played.comparison.errors.nrms,
                "trained": played.trained,
                "worst_moments": [
                    _moment_dict(m, playback) for m in playback.moments if m.played == k
                ],
            }
            for k, played in enumerate(playback.models)
        ],
        "excerpts": [
            {"log": e.log, "start": float(e.time[0]), "end": float(e.time[-1])}
            for e in playback.excerpts
        ],
        "seconds_left_out": playback.seconds_left_out,
        "notes": list(playback.models[-1].comparison.notes),
    }


def _moment_dict(moment: Moment, playback: Playback) -> dict[str, Any]:
    log, time = playback.own_time(moment.frame)
    return {
        "joint": playback.joints[moment.joint],
        "log": log,
        "time": time,
        "error": moment.error,
        "relative": moment.relative,
    }


def _show(console: Console, playback: Playback, looks: Sequence[str], units: Units) -> None:
    head(console, "Worst moments")
    for k, played in enumerate(playback.models):
        lines = [_moment_words(m, playback, units) for m in playback.moments if m.played == k]
        data = "training data" if played.trained else "held-out data"
        nrms = number(played.comparison.errors.nrms)
        show_list(console, f"{played.title}, nrms {nrms} on {data}", lines)
    if playback.seconds_left_out > 0.5:
        say(console, "Left out", f"{playback.seconds_left_out:.0f} s of the logs; see --seconds.")
    show_list(console, "Notes", [*looks, *playback.models[-1].comparison.notes])


def _moment_words(moment: Moment, playback: Playback, units: Units) -> str:
    joint = playback.joints[moment.joint]
    log, time = playback.own_time(moment.frame)
    error = f"{number(moment.error)} {units.effort([joint])}"
    return (
        f"{joint} at {time:.2f} s of {log}: {error} off, {percent(moment.relative)} of the "
        "deviation of its effort"
    )
