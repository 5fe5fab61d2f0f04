"""Good files with one value or part wrong, missing or repeated.

A reader refuses the file in one line that names it, or returns finite numbers and physical bodies.
"""

import copy
import math
import re
import warnings
from collections import defaultdict
from functools import cache
from itertools import product
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml
from good_files import FLEET, FULL_DIRECTIVES, FULL_URDF, MANY_EFFECTS, MAPPING, MJCF, SDF
from hostile import fill
from processes import time_limit

from geodrake import load_model
from geodrake.errors import GeodrakeError
from geodrake.fleet import read_fleet
from geodrake.inertia import is_physical
from geodrake.logs import Motion
from geodrake.logs.files import read_mapping

Dumper = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
NUMBERS = ("nan", "inf", "-inf", "-7", "0", "1e-300", "1e300", "1e400", "0x10", "1,5", "many", "")
WORDS = ("", "nobody", "world", "a::b", "a  b", "../x", "關節", "1", "x" * 300, "__root__", "-")
VALUES = (None, True, -1.0, 0, 0.5, 1e200, math.nan, math.inf, 10**30, "", "words", "a\0b")
VALUES += ("!!python/name:os.system", [], {}, [1, 2], [[]], {"a": 1}, "geodrake model 99", ["x"])


def is_numbers(text):
    return re.fullmatch(r"\s*([-+]?[\d.]+(e[-+]?\d+)?\s*)+", text) is not None


def wrong_texts(text):
    """Return replacements for numbers or a word, by name."""
    if not is_numbers(text):
        return {f"word {word[:9]!r}": word for word in WORDS}
    parts = text.split()
    found = {f"number {new!r}": " ".join([new] * len(parts)) for new in NUMBERS}
    return found | {"one less": " ".join(parts[1:]), "one more": f"{text} 1"}


def xml_changes(text):
    """Yield (name, text) of an XML file with one change, in the last of similar elements."""
    root = _root(text)
    parents = {child: parent for parent in root.iter() for child in parent}
    last = {(node.tag, getattr(parents.get(node), "tag", "")): node for node in root.iter()}
    for node in last.values():
        parent = parents.get(node)
        if parent is not None:
            place = [*parent].index(node)
            parent.remove(node)
            yield "element gone", _text(root)
            for _ in range(2):
                parent.insert(place, node)
            yield "element twice", _text(root)
            parent.remove(node)
        for key, value in [*node.attrib.items()]:
            others = {other.get(key) for other in root.iter(node.tag)} - {value, None}
            texts = wrong_texts(value) | {"that of another": min(others, default="")}
            for name, new in texts.items():
                node.set(key, new)
                yield name, _text(root)
            del node.attrib[key]
            yield "attribute gone", _text(root)
            node.set(key, value)
        if (value := node.text) and value.strip():
            for name, new in wrong_texts(value).items():
                node.text = new
                yield name, _text(root)
            node.text = value


def _root(text):
    return ElementTree.fromstring(text.replace("drake:", "drake-"))


def _text(root):
    return ElementTree.tostring(root, encoding="unicode").replace("drake-", "drake:")


def yaml_changes(text):
    """Yield (name, text) of a YAML file with one change, at the ends of long lists."""
    data = yaml.safe_load(text)
    for owner, key in list(_places(data)):
        kept = copy.copy(owner)
        for value in VALUES:
            owner[key] = value
            yield f"{value!r:.20}", _dumped(data)
            owner[key] = kept[key]
        if isinstance(owner, dict):
            owner["nobody"] = owner.pop(key)
        else:
            owner.append(owner[key])
        yield "renamed or twice", _dumped(data)
        del owner["nobody" if isinstance(owner, dict) else -1]
        if isinstance(owner, list):
            del owner[key]
        yield "gone", _dumped(data)
        owner.clear()
        (owner.update if isinstance(owner, dict) else owner.extend)(kept)


def _places(data):
    """Yield the owner and the key of each value."""
    pairs = list(data.items()) if isinstance(data, dict) else []
    if isinstance(data, list) and data:
        pairs = [(k, data[k]) for k in sorted({0, len(data) - 1})]
    for key, value in pairs:
        yield data, key
        yield from _places(value)


def _dumped(data):
    return yaml.dump(data, Dumper=Dumper, allow_unicode=True, sort_keys=False)


def read_model(path):
    """Read a model, whose efforts must be finite."""
    model = load_model(path)
    n = len(model.joints)
    assert n and np.all(is_physical(model.with_volume.phi)), model.phi
    assert not any(np.isnan(each).any() for each in model.position_limits)
    for fitted in model.effects:
        assert np.isfinite(fitted.parameters).all()
    q = np.full((3, model.tree.num_positions), 0.1)
    effort = model.effort(Motion(q, np.full((3, n), 0.2), np.full((3, n), 0.3)))
    assert np.isfinite(effort).all(), effort


FILES = {
    "two.urdf": (FULL_URDF, xml_changes, read_model),
    "two.sdf": (SDF, xml_changes, read_model),
    "two.xml": (MJCF, xml_changes, read_model),
    "two.dmd.yaml": (FULL_DIRECTIVES, yaml_changes, read_model),
    "saved.yaml": (MANY_EFFECTS, yaml_changes, read_model),
    "fleet.yaml": (FLEET, yaml_changes, read_fleet),
    "mapping.yaml": (MAPPING, yaml_changes, read_mapping),
}


PARTS = 6  # of the kinds of changes
MANY = 20  # places at most in which one change is tried, which differ between changes


@cache
def changed_texts(name):
    """Return the texts of a file by the name of the change, one for each place."""
    good, changes, _ = FILES[name]
    found = defaultdict(list)
    for change, text in changes(good):
        found[change].append(text)
    return found


def ended(path, read):
    """Return whether a file is read or refused, in one line that names it."""
    try:
        with warnings.catch_warnings(), time_limit(path.name):
            warnings.simplefilter("error")
            read(path)
    except GeodrakeError as error:
        assert len(str(error).splitlines()) == 1 and path.name in str(error), error
        return "refused"
    return "read"


@pytest.mark.parametrize("name", FILES)
def test_the_good_file(name, tmp_path):
    fill(tmp_path)
    text, _, read = FILES[name]
    (tmp_path / name).write_text(text, encoding="utf-8")
    assert ended(tmp_path / name, read) == "read"


@pytest.mark.sampled(PARTS)
@pytest.mark.parametrize(("name", "part"), list(product(FILES, range(PARTS))))
def test_one_change(name, part, tmp_path):
    """Test a part of the kinds of changes, each at some places of the file."""
    fill(tmp_path)
    path, read, changes = tmp_path / name, FILES[name][-1], changed_texts(name)
    for first, change in list(enumerate(sorted(changes)))[part::PARTS]:
        texts = changes[change]
        step = 1 + len(texts) // MANY
        for text in texts[first % step :: step]:
            path.write_text(text, encoding="utf-8")
            try:
                ended(path, read)
            except BaseException as error:
                error.add_note(f"{change}:\n{text}")
                raise
