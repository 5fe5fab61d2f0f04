"""Effects and transmissions of users, as classes and as files."""

import textwrap
from collections.abc import Callable
from dataclasses import dataclass

from geodrake.effects import JointEffect, Parameter
from geodrake.inertia import Array
from geodrake.robot import Transmission


@dataclass(frozen=True, eq=False)
class OwnTransmission(Transmission):
    shape: tuple[int, int] = (1, 1)
    position: Callable[[Array], Array] = None
    derivative: Callable[[Array], Array] = None

    def joint_positions(self, q):
        return self.position(q)

    def jacobian(self, q):
        return self.derivative(q)


SIZE = (Parameter("size", "N·m"),)


def own_effect(name, kind=JointEffect, *, parameters=SIZE, **more):
    """Return a class of effects with further fields and methods by name."""
    fields = {"name": name, "parameters": parameters, **more}
    return dataclass(frozen=True)(type(_class_of(name), (kind,), fields))


FILE = """
from dataclasses import dataclass
import os, sys, warnings
import numpy as np
from geodrake.effects import BodyEffect, JointEffect, Parameter, Proposer, Role

{before}
@dataclass(frozen=True)
class {of}(JointEffect):
    name = "{name}"
    parameters = (Parameter({parameter}),)
{more}
    def {method}(self, joint):
{body}
"""


def effect(body="return [joint.q]", *, more="", method="columns", before="", **others):
    """Return the text of a valid file with one effect, apart from what is given."""
    more, body = (textwrap.indent(text, n * "    ") for text, n in ((more, 1), (body, 2)))
    told = {"name": "own", "parameter": '"size", "N·m"', **others}
    of = _class_of(told["name"])
    return FILE.format(before=before, more=more, method=method, body=body, of=of, **told)


def _class_of(name):
    return name.title().replace("_", "")
