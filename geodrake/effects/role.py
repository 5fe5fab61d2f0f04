"""What effects do to efforts, and what in a residual proposes them."""

from __future__ import annotations

from enum import Enum


class Role(Enum):
    """What an effect does to the efforts that a model needs.

    An effect of another role than FORCE derives from the one of the catalogue that has it: from
    `EffortScale`, `EffortDelay`, `Payload` or `WrongInertia`, or from the bases `DeflectionEffect`
    and `Episode`.
    """

    FORCE = "adds effort"
    SCALE = "scales the effort of a joint"
    DELAY = "shifts efforts in time"
    BODY = "adds a body to a link"
    DEFLECTION = "bends a joint, so that the link is not where the motor is"
    EPISODE = "adds effort during a window of one log"
    INERTIA = "moves the inertias of the bodies"


class Proposer(Enum):
    """What in the residual of a model proposes an effect.

    BENDING and PLAY propose a `DeflectionEffect`, SHARED_ACTUATOR a `SharedActuatorEffect`, EPISODE
    a `PointEpisode`, HANDLING another `Episode`, the others a `JointEffect`: WAVES one whose one
    shape parameter is their order, WARMING and BRISTLES one that defines `course`.
    """

    BENDING = "all joints go with what the load of one joint would bend"
    PLAY = "a joint errs where its load changes its sign"
    SHARED_ACTUATOR = "two joints go with the motion of one actuator"
    WAVES = "waves over the position of a joint"
    WARMING = "friction that fades with time"
    BRISTLES = "dry friction that builds up over a way"
    EPISODE = "several joints err for a while"
    HANDLING = "the load of a body changes at an instant"
