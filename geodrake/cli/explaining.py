"""The commands `compare`, `diagnose`, `add` and `explain`."""

from __future__ import annotations

from contextlib import suppress
from functools import partial
from importlib.resources import as_file, files
from typing import TYPE_CHECKING

from geodrake.cli.command import Command, Input, Output, run
from geodrake.cli.options import AddOptions, DemoOptions, ExplainOptions, Options
from geodrake.cli.progress import step_teller
from geodrake.diagnosis.add import add, check_places
from geodrake.diagnosis.diagnose import diagnose
from geodrake.diagnosis.drafting import draft_effects, rest_correlates, source_of
from geodrake.diagnosis.explain import investigate
from geodrake.diagnosis.results import Explanation
from geodrake.effects import effect_class
from geodrake.errors import LogError, ModelError
from geodrake.identification.logs.case import prepare_case
from geodrake.identification.logs.compare import compare
from geodrake.report.explaining import Explained

if TYPE_CHECKING:
    from geodrake.control.rollout import Rollout


_DEMO_TIME = "This takes about 15 seconds; a minute the first time, as code is compiled."
_DEMO_NEXT = "Next: geodrake explain robot.urdf log.csv --save robot.yaml --report robot.html"


def run_compare(options: Options) -> None:
    """Run `geodrake compare`: compare a model with logs."""
    run(
        Command(
            "compare", "Comparing", lambda given: compare(given.model, given.logs, **given.settings)
        ),
        options,
    )


def run_diagnose(options: Options) -> None:
    """Run `geodrake diagnose`: rank the effects that a model may lack."""
    run(
        Command(
            "diagnose",
            "Diagnosing",
            lambda given: diagnose(given.model, given.logs, extra=given.extra, **given.settings),
        ),
        options,
    )


def run_add(options: AddOptions) -> None:
    """Run `geodrake add`: add an effect to a model."""
    effect, where = options.addition

    def added(given: Input) -> Explained:
        found = add(
            effect, given.model, given.logs, where=where, extra=given.extra, **given.settings
        )
        return Explained.of(found, added=True)

    command = Command(
        "add",
        f"Adding {effect}",
        added,
        check_effects=lambda extra: effect_class(effect, extra),
        check=lambda model: check_places(model, where or ()),
    )
    run(command, options)


def run_explain(options: ExplainOptions | Options, promise: str = "", last: str = "") -> None:
    """Run `geodrake explain`: explain logs, with formulas for the remaining error if requested."""
    drafts = getattr(options, "draft_effect", None) is not None
    every_step = any((options.details, options.report, options.json))  # these show every step
    command = Command(
        "explain",
        "Explaining",
        _drafted if drafts else partial(_explained, every_step=every_step),
        outputs={
            "draft_effect": Output(
                "drafted effects",
                (".py",),
                lambda found, path: source_of(found.draft) if found.draft.effects else None,
            )
        },
        promise=promise,
        last=last,
    )
    run(command, options)


def run_demo(options: DemoOptions) -> None:
    """Run `geodrake demo`: explain the log that comes with the package."""
    folder = files("geodrake") / "demo"
    with as_file(folder / "demo.urdf") as model, as_file(folder / "demo.csv") as data:
        run_explain(Options(model=model, logs=[data], **vars(options)), _DEMO_TIME, _DEMO_NEXT)


def _drafted(given: Input) -> Explained:
    explanation, draft = draft_effects(
        given.model,
        given.logs,
        extra=given.extra,
        progress=step_teller(given.progress),
        **given.settings,
    )
    return Explained.of(explanation, draft=draft)


def _explained(given: Input, *, every_step: bool) -> Explained:
    case = prepare_case(
        given.model, given.logs, candidates=True, extra=given.extra, **given.settings
    )
    found = investigate(case, progress=step_teller(given.progress))
    explanation = found.explanation
    if explanation.is_interrupted:
        return Explained.of(explanation)
    motions = _motions(given, explanation, every_step=every_step)
    if explanation.verdict != "unexplained":
        return Explained.of(explanation, motions=motions)
    given.progress("Looking for what the remaining error varies with")
    return Explained.of(explanation, correlates=rest_correlates(found), motions=motions)


def _motions(given: Input, found: Explanation, *, every_step: bool) -> tuple[Rollout, ...] | None:
    """Return motions under commands before, between and after the steps; None without commands."""
    from geodrake.control.rollout import commanded_motions  # not needed by other commands

    steps = found.steps if every_step else ()
    between = [step.model for step in steps if step.model is not None]
    for models in (between, []):  # an intermediate effect may not support simulation
        with suppress(LogError, ModelError):  # for example without motion as long as a window
            return commanded_motions(given.model, found.model, given.logs, between=models)
    return None
