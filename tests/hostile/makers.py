"""Contents of the files in rows: good files of every kind, changed, broken or malicious."""

import gzip  # noqa: F401 (for rows)
import io
import os
import zipfile
from itertools import pairwise, product
from pathlib import Path

import numpy as np
import yaml
from good_files import DIRECTIVES, MJCF, SAVED, SDF, UNINFORMED, URDF, information
from hostile import HEADER, Row, link, table, write_log  # noqa: F401 (for rows)
from numpy.lib import format as npy
from own_code import effect  # noqa: F401 (for rows)

ROWS = Path(__file__).parent / "rows"
GOOD = {"URDF": URDF, "SDF": SDF, "MJCF": MJCF, "DIRECTIVES": DIRECTIVES, "SAVED": SAVED}
GOOD["UNINFORMED"] = UNINFORMED


def changed(base, old, new, count=-1):
    """Return a good file in which one text replaces another, everywhere or `count` times."""
    assert old in GOOD[base], old
    return GOOD[base].replace(old, new, count)


def log(code, *, rows=2400, velocity=False):
    """Return a writer of a log whose time t, positions q, velocities v and efforts e change."""

    def write(path):
        data = table()[:rows]
        given = {"t": data[:, 0], "q": data[:, 1:3], "e": data[:, 3:]}
        given["v"] = np.gradient(given["q"], given["t"], axis=0)
        exec(code, {"np": np, "rng": np.random.default_rng(0)}, given)
        parts = [given[name] for name in ("tqve" if velocity else "tqe")]
        speeds = "shoulder.velocity,elbow.velocity," if velocity else ""
        names = HEADER.replace("shoulder.effort", f"{speeds}shoulder.effort")
        write_log(path, np.column_stack(parts), names)

    return write


LINES = [HEADER, *(",".join(map(repr, row)) for row in table().tolist())]
BODY = "\n".join(LINES) + "\n"


def cell(content):
    """Return a log with other content in row 6."""
    return BODY.replace("\n0.05,", f"\n{content},", 1)


def header(content):
    return "\n".join([content, *LINES[1:]])


def saved(save, *given, **more):
    """Return the bytes that a function of NumPy saves."""
    file = io.BytesIO()
    save(file, *given, **more)
    return file.getvalue()


def arrays():
    return dict(zip(HEADER.split(","), table().T, strict=True))


def npz(code=""):
    """Return an archive whose arrays `a` some code changes."""
    exec(code, {"np": np, "a": (found := arrays())})
    return saved(np.savez, **found)


def members(change=lambda name, data: data, *, called=("{}.npy",), **settings):
    """Return an archive of members with other contents or names."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", **settings) as archive:
        for (name, array), form in product(arrays().items(), called):
            archive.writestr(form.format(name), change(name, saved(np.save, array)))
    return file.getvalue()


def only(wanted, new):
    """Return an archive with other contents of one member."""
    return members(lambda name, data: new(data) if name == wanted else data)


def array_header(shape, descr="<f8"):
    fields = {"descr": descr, "fortran_order": False, "shape": shape}
    return saved(npy.write_array_header_1_0, fields)


def claiming(shape, descr="<f8"):
    """Return an archive with another header for the elbow's effort."""
    return only("elbow.effort", lambda data: array_header(shape, descr) + data[128:])


def encrypted():
    """Return an archive whose directory says that its members are encrypted."""
    first, *parts = npz().split(b"PK\x01\x02")
    return b"PK\x01\x02".join([first, *(part[:4] + b"\1" + part[5:] for part in parts)])


def bomb(path):
    """Write columns of zeros, one of which claims six gigabytes."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as file:
        for name in arrays():
            shape = (750_000_000 if name == "elbow.effort" else 2**22,)
            file.writestr(f"{name}.npy", array_header(shape) + bytes(1 << 25))


def damaged():
    """Return an archive with one byte changed in an array."""
    data = bytearray(npz())
    data[data.index(b"shoulder.effort") + 3000] ^= 255
    return bytes(data)


def included(*uris):
    includes = "".join(f"<include><uri>{uri}</uri></include>" for uri in uris)
    return f'<sdf version="1.9"><model name="robot">{includes}</model></sdf>'


def adds(uri):
    return f"directives:\n- add_directives: {{file: {uri}}}\n"


def sparse(size):
    return lambda path: (path.touch(), os.truncate(path, size))


def chain(count, last):
    """Return a writer of SDF files that include each other in turn."""

    def make(path):
        names = ["bad", *map(str, range(1, count)), last]
        for name, following in pairwise(names):
            path.with_name(f"{name}.sdf").write_text(included(f"{following}.sdf"))

    return make


def doubling(path):
    for k in range(30):
        text = included(f"{k + 1}.sdf", f"{k + 1}.sdf")
        path.with_name(f"{k or 'bad'}.sdf").write_text(text)


def many_links(count):
    """Return a chain of links."""
    links = "".join(f'<link name="l{k}"/>' for k in range(count + 1))
    joints = "".join(
        f'<joint name="j{k}" type="revolute"><parent link="l{k}"/><child link="l{k + 1}"/></joint>'
        for k in range(count)
    )
    return f'<robot name="r">{links}{joints}</robot>'


LAUGHS = "".join(
    f'<!ENTITY {name} "{f"&{before};" * 10}">' for before, name in pairwise("abcdefghijklm")
)
DEEP = '<body><joint/><inertial pos="0 0 1" mass="1" diaginertia="1 1 1"/>'
HEAD = UNINFORMED.partition("inertial_parameters")[0]
DIGEST = HEAD.partition("base_sha256: ")[2][:64]
TWICE = """effects:
- {name: coulomb_friction, where: [shoulder], shape: {}, parameters: [0.3], deviations: []}
"""


def anchors(form):
    """Return anchors, each of which expands to nine of the previous one."""
    names = pairwise("abcdefghijk")
    lines = (f"_{b}: &{b} {form.format(', '.join([f'*{a}'] * 9))}\n" for a, b in names)
    return "".join(lines)


def informed(code):
    """Return a saved model with an information matrix `m` that some code changes."""
    return UNINFORMED + information(lambda matrix: exec(code, {"np": np, "m": matrix}))


def damage(good, word, head):
    """Return YAML files by the kind of damage to them, or to one word."""
    return {
        "null characters": good.replace(word, "a\0b"),
        "bytes that are no UTF-8": good.encode().replace(word.encode(), b"a\xff\xfe"),
        "tags that run": good.replace(word, '!!python/object/apply:os.system ["touch PWNED"]'),
        "an anchor in itself": good.replace(word, "&a [*a]"),
        "cut off": good[: len(good) * 6 // 10],
        "a list": "- a\n- b\n",
        "tabs": f"{head}a:\n\t- a\n",
        "lists 1,000 deep": f"{head}{'[' * 1000}{']' * 1000}",
        "lists 100,000 deep": f"{head}{'[' * 100_000}{']' * 100_000}",
        "mappings 1,500 deep": f"{head}{'{a: ' * 1500}{'}' * 1500}",
        "a bomb of anchors": f"_a: &a [x, x]\n{anchors('[{}]')}{head}*k\n",
        "merges that double": f"_a: &a {{x: 1}}\n{anchors('{{<<: [{}]}}')}{head}*k\n",
    }


class Maker(yaml.SafeLoader):
    """A loader of rows: `!made` is an expression, other tags call functions of this module."""


def _construct(loader, name, node):
    if isinstance(node, yaml.MappingNode):
        more = loader.construct_mapping(node)
        return lambda _path: globals()[name](**more)
    if name == "made":
        return lambda _path: eval(node.value, globals())
    is_list = isinstance(node, yaml.SequenceNode)
    given = loader.construct_sequence(node) if is_list else [node.value]
    return lambda _path: globals()[name](*given)


Maker.add_multi_constructor("!", _construct)


TOLD = {"rows": (), "command": "", "file": "", "says": ()}
"""Keys of a group of rows besides the fields of a `Row`."""


def read_rows():
    """Yield the rows of all files; a file's content is text or created by a tag."""
    for path in sorted(ROWS.glob("*.yaml")):
        for group in yaml.load(path.read_text(encoding="utf-8"), Maker):
            listed, command, file, says = map(group.pop, *zip(*TOLD.items(), strict=True))
            for name, *rest in listed:
                words = command or rest.pop(0)
                content, *more = rest
                files = content if isinstance(content, dict) else {file: content}
                what = f"{next(iter(files), path.stem)}: {name}"
                yield Row(what, words.format(*files), (*says, *more), files, **group)
