"""Options of all commands with a MODEL that say how it is to be read, and the reading."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from geodrake.errors import ArgumentError

if TYPE_CHECKING:
    from geodrake.cli.progress import Activity
    from geodrake.effects import Effect
    from geodrake.model import Given, RobotModel

_MOST_REPAIRS = 5  # that are said one by one; notes have all


@dataclass(frozen=True, kw_only=True)
class ModelOptions:
    """How a model file is to be read.

    Attributes:
        lock (JOINT=VALUE): Hold a joint there, rad or m: it is no joint of the model. Joints that
            no log has are held unasked. Repeatable.
        robot (NAME): The robot of a file that has several; an unknown name such as x lists them.
        package (NAME=FOLDER): Where a ROS package is that the model names, beside those of
            ROS_PACKAGE_PATH, AMENT_PREFIX_PATH and of folders above it. Repeatable.
        xacro_arg (NAME:=VALUE): Argument of a xacro file. Repeatable.
        trust_xacro: Evaluate any expression of a xacro file and let it read any file, where you
            trust who wrote it. If absent, expressions of values and xacro's own functions, and
            files in its folder and packages.
        transmission (FILE.yaml|file|none): What moves joints in their place: gears, coupled wrists,
            linkages, between the logged actuators and the model's joints; `file` takes what MODEL
            itself states of motors. If absent, ARM.transmission.yaml beside ARM.urdf, if there is
            one.
        floating: Leave roots free that nothing fixes to the world.
    """

    PANEL: ClassVar = "models"

    lock: list[str] | None = None
    robot: str | None = None
    package: list[str] | None = None
    xacro_arg: list[str] | None = None
    trust_xacro: bool = False
    transmission: str | None = None
    floating: bool = False

    @property
    def given(self) -> Given:
        """Return how the file is to be read."""
        from geodrake.model import Given

        return Given.of_words(
            self.robot, self.package or (), self.xacro_arg or (), trust_xacro=self.trust_xacro
        )

    @property
    def transmission_files(self) -> list[Path]:
        """Return the transmission file that is named, which no output may replace."""
        words = self.transmission
        return [Path(words)] if words is not None and Path(words).is_file() else []

    @property
    def held(self) -> dict[str, float]:
        """Joint -> where it is to be held, rad or m."""
        found: dict[str, float] = {}
        for text in self.lock or ():
            joint, sign, value = text.rpartition("=")
            try:
                number = float(value)
            except ValueError:
                sign = ""
            if not sign or not joint:
                raise ArgumentError(
                    f"--lock has {text!r}, which cannot be read.",
                    advice="Write --lock JOINT=VALUE, in rad or m, such as --lock finger=0.04.",
                )
            if joint in found:
                raise ArgumentError(f"--lock names {joint!r} twice.", advice="Name it once.")
            found[joint] = number
        return found


def read_model(
    path: Path, options: ModelOptions, told: Activity, extra: Sequence[type[Effect]] = ()
) -> RobotModel:
    """Read the model of a command, and report at once what was repaired in its file."""
    from geodrake.model import load_model
    from geodrake.robot.files.named_robots import planned_download

    download = planned_download(path)
    if download:
        told.warning(download)
    model = load_model(
        path,
        floating=options.floating,
        extra=extra,
        lock=options.held,
        given=options.given,
        transmission=options.transmission,
    )
    tell_repairs(model, told)
    return model


def tell_repairs(model: RobotModel, told: Activity) -> None:
    """Say what of a model's file is not believed."""
    for repair in repairs_in_short(model.repairs):
        told.warning(f"Warning: {model.path.name} is not used as it stands. {repair}")


def repairs_in_short(repairs: Sequence[str]) -> tuple[str, ...]:
    """Describe the first of many repairs, and count them."""
    more = len(repairs) - _MOST_REPAIRS
    rest = [f"{more} more of its parts were replaced or left out."] if more > 0 else []
    return (*repairs[:_MOST_REPAIRS], *rest)
