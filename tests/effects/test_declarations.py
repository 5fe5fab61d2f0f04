"""An effect is one class, which declares what others need; no other module names it."""

import ast
import inspect
import os
import re
import sys
from functools import cache
from pathlib import Path

import pytest
from processes import PACKAGES, ended, start

import geodrake
from geodrake import effects
from geodrake.effects import Role, Shape, catalogue
from geodrake.effects.declarations import when_sliding
from geodrake.effects.lookup import (
    FAMILIES,
    effect_of,
    file_effects,
    servo_effects,
    table_rows,
)
from geodrake.errors import ArgumentError
from geodrake.identification.logs.servo_motion import PARAMETERS

PACKAGE = Path(geodrake.__file__).parent
TESTS = Path(__file__).parents[1]
PATHS = f"{PACKAGES}{os.pathsep}{TESTS}"
TABLE = TESTS.parent / "docs" / "effects.md"
EFFECTS = PACKAGE / "effects"
FILES = sorted(path for path in PACKAGE.rglob("*.py") if EFFECTS not in path.parents)
NAMES = {effect.name for effect in catalogue()}
LONG_NAMES = re.compile(rf"\b(?:{'|'.join(sorted(name for name in NAMES if '_' in name))})\b")
CLASSES = {effect.__name__ for effect in catalogue()}
ANY_NAME = re.compile(rf"\b(?:{'|'.join(sorted(NAMES | CLASSES))})\b")

ALLOWED = {
    "control/export_proof/formats.py": "viscous_friction is a key of Isaac's actuators",
    "robot/files/model_edits.py": "drake:rotor_inertia is a tag of Drake's",
    "robot/files/checks.py": "drake:rotor_inertia is a tag of Drake's",
    "robot/files/mjcf_source.py": "contact is a tag of MuJoCo's",
    "robot/files/texts.py": "contact is a tag of PyBullet's",
}
"""Files where the name of an effect is a word of somebody else's."""


def docstrings(tree):
    """Yield strings that are statements of modules, classes, functions and constants."""
    return {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}


def names_in(text):
    """Return the names of effects in a string, without those that are common words."""
    return {*LONG_NAMES.findall(text)} | ({text} & NAMES)


def mentions(path):
    """Yield where a module names an effect or its class, outside of docstrings and comments."""
    text = path.read_text(encoding="utf-8")
    tree = ast.parse(text if ANY_NAME.search(text) else "")
    words, drakes = docstrings(tree), set()
    for node in ast.walk(tree):
        found = set()
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in words:
            found = names_in(node.value)
        elif isinstance(node, ast.ImportFrom):
            imported = {alias.name for alias in node.names}
            if (node.module or "").startswith("pydrake"):  # which has a CoulombFriction too
                drakes |= imported & CLASSES
                continue
            found = imported & CLASSES
        elif isinstance(node, ast.Name):
            found = {node.id} & (CLASSES - drakes)
        elif isinstance(node, ast.Attribute):
            found = {node.attr} & CLASSES
        yield from (f"{path.relative_to(PACKAGE)}:{node.lineno} names {name}" for name in found)


@cache
def all_mentions():
    """Return every place of the package that names an effect."""
    return [place for path in FILES for place in mentions(path)]


def test_nobody_else_names_an_effect():
    assert not {place for place in all_mentions() if place.partition(":")[0] not in ALLOWED}


def test_what_may_name_effects_does():
    assert set(ALLOWED) == {place.partition(":")[0] for place in all_mentions()}


@pytest.mark.parametrize("effect", catalogue(), ids=lambda effect: effect.name)
class TestDeclarations:
    def test_is_in_the_file_of_a_family_and_at_the_door(self, effect):
        assert Path(inspect.getfile(effect)).stem in FAMILIES
        assert getattr(effects, effect.__name__) is effect and effect.__name__ in effects.__all__

    def test_says_what_it_is(self, effect):
        assert effect.law and effect.signature and "effort" in effect.__doc__
        assert all(parameter.unit for parameter in effect.parameters)
        assert isinstance(effect.role, Role)
        assert 0 <= effect.complexity <= 3

    def test_relations_are_to_others(self, effect):
        related = (*effect.contains, effect.companion)
        assert set(related) - {None} <= set(catalogue()) - {effect}

    def test_shapes_are_its_own(self, effect):
        fields = inspect.signature(effect).parameters
        assert {shape.name for shape in effect.shapes} <= set(fields)


def test_effects_of_files_and_servos_have_their_names():
    assert all(effect.file_term.words or effect.file_term.servo for effect in file_effects())
    assert servo_effects().keys() < {*PARAMETERS}


def test_wrong_inertia_has_no_instance():
    with pytest.raises(ArgumentError, match="stands for the inertias"):
        effect_of(Role.INERTIA)()


class TestShape:
    def test_values(self):
        scaled = Shape("width", "rad", (0.1, 0.2), "reach", 0.05)
        assert scaled.values({"reach": 10.0}) == (1.0, 2.0)
        assert scaled.values({"speed": 10.0}) == (0.05,)
        assert Shape("width", grid=(1, 3)).values({}) == (1, 3)
        assert Shape("width").values({}) == ()

    def test_bad_scale(self):
        with pytest.raises(ArgumentError, match="scale"):
            Shape("width", scale="wide")


@pytest.mark.parametrize(
    ("turning", "sliding"),
    [
        ("N·m", "N"),
        ("N·m·s/rad", "N·s/m"),
        ("kg·m²", "kg"),
        ("rad/(N·m)", "m/N"),
        ("rad/(N·m·s)", "m/(N·s)"),
        ("1", "1"),
    ],
)
def test_units_at_a_joint_that_slides(turning, sliding):
    assert when_sliding(turning) == sliding


def test_table_of_the_readme_is_that_of_the_classes():
    rows = [
        f"| `{name}` | {law.replace('|', chr(92) + '|')} | {place} |"
        for name, law, place in table_rows()
    ]
    text = TABLE.read_text(encoding="utf-8")
    assert "| effect | needed effort | place |\n|---|---|---|\n" + "\n".join(rows) + "\n\n" in text


CABLE = '''
@dataclass(frozen=True)
class WoundCable(base.JointEffect):
    """Cable that stiffens as it is wound up.

    effort = k tanh(q / a), with k ≥ 0 in N·m.
    """

    width: float

    name = "wound_cable"
    law = "k tanh(q/a)"
    signature = "a force towards the middle of the motion that saturates"
    shapes = (base.Shape("width", "rad", (0.03, 0.1)),)
    parameters = (base.Parameter("strength", "N·m", lower=0.0),)
    depends_on = frozenset({"q"})

    def columns(self, joint):
        return [np.tanh(joint.q / self.width)]
'''

USE = """
from pendulum_logs import PENDULUM, pendulum_log
import numpy as np
from geodrake import effects, load_model
from geodrake.effects import environment

exec("from geodrake.effects import base\\n" + {cable!r}, vars(environment))
from geodrake.diagnosis import explain

assert effects.make_effect("wound_cable", ["elbow"], {{"width": 0.1}}).width == 0.1
log = pendulum_log(1, lambda q, v, vd, load: 0.4 * np.tanh(q / 0.1) * [0.0, 1.0], seconds=12.0)
found = explain(load_model(PENDULUM), [log], bandwidth=6.0)
print([(step.effect, step.where) for step in found.steps])
"""


def test_one_class_is_one_more_effect():
    """A class in the file of a family is found in a log without any other change."""
    done = ended(start([sys.executable, "-c", USE.format(cable=CABLE)], PYTHONPATH=PATHS))
    assert done == (0, "[('wound_cable', ('elbow',))]\n", "")
