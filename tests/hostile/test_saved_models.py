"""Saved models that were cut, packed or pointed elsewhere, as sweeps of one value do not."""

import os
from itertools import pairwise

import numpy as np
import pytest
from good_files import SAVED, UNINFORMED, information
from hostile import Row

HEAD = UNINFORMED.partition("inertial_parameters")[0]


def whole(name, content, *says, code=2, command="compare {} log.csv"):
    """A row of a saved model with some content, or of several files that are made."""

    def make(folder):
        found = content(folder) if callable(content) else content
        data = found.encode() if isinstance(found, str) else found
        (folder / "saved.yaml").write_bytes(data)

    says = (*says, "saved.yaml") if code else says
    return Row(name, command.format("saved.yaml"), says, make, code)


def told(name, change, *says):
    """A row of an information matrix that was changed."""
    return whole(name, UNINFORMED + information(change), "information", *says)


def entry(value, i=3, *others):
    """Puts a value into a matrix, at one place or there and at others."""

    def change(matrix):
        for j in others or (i,):
            matrix[i, j] = matrix[j, i] = value

    return change


def based(name, *says, make=lambda folder: None):
    """A row of a model that is based on another file."""

    def content(folder):
        make(folder)
        return SAVED.replace("robot.urdf", name)

    return whole(f"base {name[:20]}", content, *says)


def write(name, text):
    return lambda folder: (folder / name).write_text(text, encoding="utf-8")


def doubling(form):
    """Anchors, each of which unfolds to nine of the one before."""
    lines = (
        f"_{b}: &{b} {form.format(', '.join([f'*{a}'] * 9))}" for a, b in pairwise("abcdefghijk")
    )
    return "\n".join(lines) + "\n"


DIGEST = HEAD.partition("base_sha256: ")[2][:64]
READ = [
    whole("all in order", SAVED, code=0),
    whole("nothing but bodies", UNINFORMED.partition("effects:")[0], code=0),
    whole("base that has changed", UNINFORMED.replace(DIGEST, "a" * 64), "has changed", code=0),
    whole("off by rounding", UNINFORMED + information(lambda m: m.__setitem__((3, 4), 1e-12)),
        code=0),
    whole("byte order mark", SAVED.encode("utf-8-sig"), code=0),
    whole("comments and quotes", "# by hand\n" + SAVED.replace("geodrake model 1",
        "'geodrake model 1'"), code=0),
]  # fmt: skip
REFUSED = [
    told("an entry nan", entry(np.nan, 1, 2)),
    told("a zero on the diagonal with something beside it", lambda m: (entry(0.0)(m),
        entry(0.5, 3, 4)(m))),
    told("not symmetric", lambda m: m.__setitem__((3, 4), 0.5), "symmetric"),
    told("not positive", entry(100.0, 3, 4), "semidefinite"),
    told("all zeros", lambda m: m.fill(0.0)),
    whole("a row too few", SAVED.rsplit("- ", 1)[0], "information"),
    whole("a number too few", SAVED.replace("- [1.0, 0.0,", "- [1.0,", 1), "information"),
    based("none.urdf", "is based on"),
    based("p.urdf", "is a pipe", make=lambda f: os.mkfifo(f / "p.urdf")),
    based("other.yaml", "saved model itself", make=write("other.yaml", SAVED)),
    based("l.yaml", "saved model itself", make=lambda f: (f / "l.yaml").symlink_to("saved.yaml")),
    based("d.dmd.yaml", make=write("d.dmd.yaml",
        "directives:\n- add_model: {name: a, file: saved.yaml}\n")),
    based("/dev/zero", "is based on"),
    based("x" * 300, "is based on"),
    whole("another robot's", SAVED.replace("upper_link", "thigh").replace("lower_link", "shank"),
        "thigh"),
    whole("digest of other letters", SAVED.replace(DIGEST, f"{DIGEST.upper()}x"), "base_sha256"),
    whole("an effect twice", UNINFORMED.replace("effects:\n", "effects:\n- {name: coulomb_friction,"
        " where: [shoulder], shape: {}, parameters: [0.3], deviations: []}\n"), "twice"),
    whole("a bomb of anchors", f"format: geodrake model 1\n_a: &a [x, x]\n{doubling('[{}]')}"
        "information: *k\n", "unfold"),
    whole("merges that double", f"{HEAD}_a: &a {{x: 1}}\n{doubling('{{<<: [{}]}}')}", "unfold"),
    whole("rows of one alias", f"{HEAD}_a: &a [{', '.join(['1'] * 2000)}]\n"
        f"information: [{', '.join(['*a'] * 2000)}]\n", "unfold"),
    whole("tags that run", SAVED.replace("[abc]", '!!python/object/apply:os.system ["touch x"]')),
    whole("an anchor in itself", SAVED.replace("[abc]", "&a [*a]")),
    whole("cut off", SAVED[: len(SAVED) * 6 // 10]),
    whole("lists 1,000 deep", HEAD + "fitted_to: " + "[" * 1000 + "]" * 1000),
    whole("mappings 1,500 deep", HEAD + "fitted_to: " + "{a: " * 1500 + "}" * 1500),
    whole("null characters", SAVED.replace("abc", "a\0c"), "null"),
    whole("bytes that are no UTF-8", SAVED.encode().replace(b"abc", b"a\xff\xfe")),
    whole("UTF-16", SAVED.encode("utf-16")),
    whole("150 MB", HEAD + "#" * 150_000_000, "MB are read"),
    *(whole(f"a mass of nan for {command}", UNINFORMED.replace("[0.5235", "[.nan"), "upper_link",
        command=command) for command in ("rollout {} log.csv", "digest {} log.csv --to new",
        "rollout robot.urdf log.csv --before {}", "excite {}", "identifiable {} log.csv")),
]  # fmt: skip


@pytest.mark.sampled(2)
@pytest.mark.parametrize("row", READ + REFUSED, ids=str)
def test_row(row, tmp_path, monkeypatch):
    row.check(tmp_path, monkeypatch)
