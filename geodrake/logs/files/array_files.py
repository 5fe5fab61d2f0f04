"""Logs in files of arrays: JSON, YAML, MATLAB, HDF5, Parquet, LeRobot, Feather, NPY and NPZ."""

from __future__ import annotations

import json
import math
import re
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import chain, islice
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import msgspec
import numpy as np
import yaml  # type: ignore[import-untyped]
from numpy.lib import format as npy
from scipy.io import loadmat

from geodrake.boundary.arguments import Array
from geodrake.boundary.input_files import (
    open_regular,
    read_regular,
    regular_file,
    regular_files,
)
from geodrake.boundary.memory import machine_memory
from geodrake.boundary.optional_packages import optional_package
from geodrake.errors import LogError
from geodrake.logs.files.column_mapping import MOST_COLUMNS, check_once, is_used, listed
from geodrake.logs.files.grouped_arrays import (
    content_table,
    describes_columns,
    fields_of,
    is_of_episode,
    neither,
    records_table,
)
from geodrake.logs.files.name_rules import (
    OF_JOINTS,
    PREVIOUS,
    is_time,
    meaning_of,
    names_joints,
    numbers_joints,
    quantity_of,
    tells,
)
from geodrake.logs.files.packed_files import open_log, unpacked
from geodrake.logs.files.reading import Reading
from geodrake.logs.files.table import (
    LogTable,
    check_room,
    number_in,
    numbered,
    numeric_table,
    readable,
    rows_of,
)
from geodrake.logs.files.text_file import renamed
from geodrake.logs.files.topics import messages_table

_LINES = (".jsonl", ".ndjson")
_JSON_SHARE = 0.05  # fraction of the memory for text, as parsed content is far larger
_SHOWN = 40  # characters of a truncated record in messages
_BEGINNING, _NO_RECORDS = 1000, re.compile(rb"(\xef\xbb\xbf)?\s*\[\s*[^\s{\]]")
_JSON_ADVICE = (
    'Write {"time": [...], "joint.position": [...], ...}, or a record of these in each line.'
)


def read_json(path: Path, reading: Reading) -> LogTable:
    """Read a JSON file; fields of records are named by paths such as `state.q[0]`."""
    with readable(path, "JSON file", _JSON_ADVICE):
        with open_log(path) as file:
            if _NO_RECORDS.match(file.read(_BEGINNING)):
                raise neither(path, _JSON_ADVICE)
        text = _text_of(path, "JSON").decode("utf-8-sig")
        values, remainder = _json_values(text)
        if len(values) < 2 and remainder:
            json.loads(text)  # raises with the position of the error
        is_single = len(values) == 1 and unpacked(path).suffix.lower() not in _LINES
        content = _frame_rows(path, values[0]) if is_single else values
        if len(text) > _LONG and reading.mapping is None:  # shorter files get a proposed mapping
            _check_recognized(path, content, _JSON_ADVICE)
        table = messages_table(path, content, reading)
        table = table or content_table(path, content, reading, _JSON_ADVICE)
        note = f"the last record is cut off and not used: {remainder[:_SHOWN]!r}"
        return table.noting(*[note] * bool(remainder))


def _json_values(text: str) -> tuple[list[Any], str]:
    """Return the consecutive values in a text, such as lines, and the truncated last one."""
    if '"0":' not in text:
        with suppress(msgspec.DecodeError):  # several values, NaN or errors
            return [msgspec.json.decode(text)], ""
    values, index, blank = list[Any](), 0, re.compile(r"\s*")
    decoder = json.JSONDecoder(object_hook=_as_list)
    while (index := blank.match(text, index).end()) < len(text):  # type: ignore[union-attr]
        try:
            value, index = decoder.raw_decode(text, index)
        except json.JSONDecodeError:
            if "\n" in text[index:].strip():
                raise
            return values, text[index:].strip()
        values.append(value)
    return values, ""


def _as_list(content: dict[str, Any]) -> Any:
    """Convert scalars with the keys 0, 1, …, JavaScript's typed arrays, to a list.

    Keys of objects and lists may be numbers of motors or recordings instead.
    """
    is_counted = "0" in content and [*content] == [*map(str, range(len(content)))]
    if not is_counted or any(isinstance(value, dict | list) for value in content.values()):
        return content
    return [*content.values()]


def read_yaml(path: Path, reading: Reading) -> LogTable:
    """Read YAML like JSON; its documents may be messages from ROS's `topic echo`."""
    model = "Is it the model? `geodrake log` takes that with --model."
    advice = f"Is it cut off? Remove the last message. {model}"
    with readable(path, "YAML file", advice):
        text = _text_of(path, "YAML")
        complete = text.rpartition(b"\n---")[0] or text  # drop a truncated message
        content, *more = yaml.load_all(complete, yaml.CSafeLoader)
        documents = [each for each in (content, *more) if isinstance(each, Mapping)]
        _check_recognized(path, documents or content, model)
        table = messages_table(path, documents, reading)
        return table or content_table(path, documents if more else content, reading, advice)


_LONG = 1_000_000  # characters of JSON above which fields are checked first
_FIRST = 3000  # fields checked


def _check_recognized(path: Path, content: Any, advice: str) -> None:
    """Raise if none of the first fields belongs to joints or time."""
    fields = fields_of({"log": content}, lists=True)
    inside = (re.sub(r"\[\d+\]", "", name) for name, _ in fields)
    names = islice(chain(content if isinstance(content, Mapping) else (), inside), _FIRST)
    if not any(meaning_of(part) for name in names for part in (name, name.rpartition(".")[2])):
        raise LogError(f"Log {str(path)!r} has neither time nor joints.", advice=advice)


_OF_MESSAGE = re.compile(r'(\w+)\s*(?::\s*("(?:[^"\\]|\\.)*"|[^\s{}"]+)|:?\s*\{)|\}')


def read_gazebo(path: Path, reading: Reading) -> LogTable:
    """Read the output of Gazebo's `gz topic --echo`, messages in protobuf's text format.

    Each message starts with the same field as the first. Zeros, which protobuf omits, are restored.
    """
    messages, stack = list[dict[str, Any]](), list[dict[str, Any]]()
    for match in _OF_MESSAGE.finditer(_text_of(path, "text").decode()):
        name, value = match.groups()
        if name is None:
            stack = stack[:-1]
            continue
        if not messages or (not stack and name == next(iter(messages[0]))):
            messages.append({})
        field: Any = {} if value is None else value.strip('"')
        (stack[-1] if stack else messages[-1]).setdefault(name, []).append(field)
        stack += [field] if value is None else []
    records = [dict(fields_of(_unlisted(each), lists=True)) for each in messages]
    zeros = {n: 0.0 for each in records for n, x in each.items() if number_in(x) is not None}
    return records_table(path, [zeros | each for each in records])


def _unlisted(fields: Mapping[str, list[Any]]) -> dict[str, Any]:
    """Return the fields of a message, with lists of one item replaced by the item."""
    lists = {n: [_unlisted(x) if isinstance(x, dict) else x for x in f] for n, f in fields.items()}
    return {name: found[0] if len(found) == 1 else found for name, found in lists.items()}


_MOST_OF_RANGE = 1e8  # most numbers of a range


def read_octave(path: Path, reading: Reading) -> LogTable:
    """Read the matrices in a text file of Octave's `save`."""
    variables = dict[str, Any]()
    for part in _text_of(path, "text").decode().split("# name: ")[1:]:
        name, *lines = part.splitlines()
        rows = [line.split() for line in lines if line.strip() and not line.startswith("#")]
        rows = [["nan" if cell == "NA" else cell for cell in row] for row in rows]
        with suppress(ValueError):  # texts, and structs, whose fields follow by name
            numbers = np.squeeze(np.array(rows, float))
            if any(line.startswith("# type:") and line.endswith("range") for line in lines):
                begin, end, step = numbers  # such as `0:0.01:10`
                if not 0.0 <= (end - begin) * step < step**2 * _MOST_OF_RANGE:
                    continue
                count = 1 + int((end - begin) / step * (1.0 + 1e-12))
                numbers = begin + step * np.arange(count)
            variables[name.strip()] = numbers if numbers.ndim else float(numbers)
    return content_table(path, variables, reading)


def read_rsi(path: Path, reading: Reading) -> LogTable:
    """Read XML messages of KUKA's robot sensor interface (RSI)."""
    with readable(path, "XML of a robot", "Remove a last element that is cut off."):
        root = ElementTree.fromstring(b"<log>" + _text_of(path, "XML") + b"</log>")
    return records_table(path, [_element_fields(element) for element in root])


def _element_fields(element: ElementTree.Element) -> dict[str, Any]:
    """Return the attributes and children of an element."""
    children = {child.tag: _element_fields(child) or child.text for child in element}
    return {**element.attrib, **children}


def _text_of(path: Path, kind: str) -> bytes:
    """Return the text of a file, if the memory is sufficient for the parsed content."""
    with open_log(path) as file:
        text = file.read(1 + int(_JSON_SHARE * machine_memory()))  # may be compressed
    check_room(path, int(len(text) / (8.0 * _JSON_SHARE)), f"{len(text) / 1e9:.3g} GB of {kind}")
    return text


def _frame_rows(path: Path, content: Any) -> Any:
    """Return records if content is a data frame in JSON, or names above rows."""
    if not isinstance(content, Mapping):
        return content
    lists = [x for x in content.values() if isinstance(x, list) and x]
    if {"columns", "data"} <= content.keys() <= {"columns", "index", "data"}:
        return _named_rows(path, content["columns"], content["data"])
    if len(lists) == 2 and all(isinstance(name, str) and meaning_of(name) for name in lists[0]):
        names, rows = lists
        if all(isinstance(row, list) for row in rows) and len(rows[0]) == len(names):
            return _named_rows(path, names, rows)
    return content


def _named_rows(path: Path, names: Sequence[Any], rows: Sequence[Any]) -> list[dict[str, Any]]:
    """Convert rows of values to records."""
    for k, row in enumerate(rows, 1):
        if not isinstance(row, list) or len(row) != len(names):
            has = f"is {str(row)[:_SHOWN]!r}, not a list"
            has = f"has {len(row)} values" if isinstance(row, list) else has
            raise LogError(
                f"Row {k} of log {str(path)!r} {has}, but there are {len(names)} names of columns.",
                advice="Write a list of as many values. Is the recording truncated?",
            )
    fields = [".".join(map(str, n)) if isinstance(n, list) else str(n) for n in names]
    return [dict(zip(fields, row, strict=True)) for row in rows]


_DEEPEST = 30
_HDF5 = b"\x89HDF\r\n\x1a\n"
_HDF5_WITHIN = 520  # bytes that include MATLAB's own header before it
_MAT_ADVICE = "Save arrays or structs of them: save('log.mat', 'time', 'q', 'tau', '-v7')."


def read_mat(path: Path, reading: Reading) -> LogTable:
    """Read a MATLAB file."""
    with readable(path, "MATLAB file", _MAT_ADVICE):
        with open_regular(path, "log", LogError) as file:
            is_hdf5 = _HDF5 in file.read(_HDF5_WITHIN)
        variables = _objects(path, reading) if is_hdf5 else loadmat(path, simplify_cells=True)
        own = {name: value for name, value in variables.items() if not name.startswith(("__", "#"))}
        table = content_table(path, own, reading)
    if not table.columns:
        raise LogError(
            f"Log {str(path)!r} has no numeric arrays; its variables are {listed([*own])}.",
            advice=f"Tables and timeseries cannot be read. {_MAT_ADVICE}",
        )
    return table


def read_hdf5(path: Path, reading: Reading) -> LogTable:
    """Read the arrays of an HDF5 file by path, without images and the like."""
    with readable(path, "HDF5 file"):
        content = _objects(path, reading, matlab=False)
        return content_table(path, {n: _frame(path, x) for n, x in content.items()}, reading)


def _frame(path: Path, group: Any) -> Any:
    """Return the columns of a data frame written by pandas; leave other groups unchanged."""
    if not isinstance(group, Mapping):
        return group
    if any(name.startswith("values_block") for name in group.get("table", ())):
        raise LogError(
            f"Log {str(path)!r} has a table of pandas, whose columns are named in pickles, which "
            "may run any program when read.",
            advice="Write the frame with to_parquet, or to_hdf(…, data_columns=True).",
        )
    blocks = [name.removesuffix("_values") for name in group if re.match(r"block\d+_values", name)]
    index = group.get("axis1")
    columns = {"time": index} if blocks and np.asarray(index).dtype.kind == "f" else {}
    for block in blocks:
        names = (name.decode() for name in group[f"{block}_items"])
        columns |= dict(zip(names, group[f"{block}_values"].T, strict=True))
    return columns or group


def _objects(path: Path, reading: Reading, *, matlab: bool = True) -> dict[str, Any]:
    """Read the arrays of a file, each object once regardless of links to it.

    The groups of episodes other than the chosen one are empty. In files with very many arrays,
    only time and the arrays in a mapping are read.
    """
    purpose = "MATLAB files of version 7.3 (or save them with -v7)" if matlab else "HDF5 files"
    h5py = optional_package("h5py", "logs", purpose, LogError)
    names: list[str] = []

    def take(name: str) -> bool | None:
        if not name.startswith("#") and is_of_episode(name.split("/")[:-1], reading):
            names.append(name)
        return name.count("/") > _DEEPEST or None

    variables: dict[str, Any] = {}
    with h5py.File(path, "r") as file:
        if file.visit(take):
            raise LogError(
                f"Log {str(path)!r} has structs nested more than {_DEEPEST} deep.",
                advice=_MAT_ADVICE,
            )
        objects = {name: file[name] for name in names}
        attributes = [(f"{k}/{n}", x) for k, v in objects.items() for n, x in _attributes(v)]
        datasets = {n: v for n, v in objects.items() if isinstance(v, h5py.Dataset)}
        attributes += _attributes(file)
        attributes += [(n, np.ravel(v[()])[0]) for n, v in datasets.items() if v.size == 1]
        arrays = {n: v for n, v in datasets.items() if matlab or _may_be_log(n, v.shape)}
        arrays = {n: v for n, v in arrays.items() if v.shape}
        mapped = [each.column for _, each in reading.mapping or ()] or [0]
        selected = arrays
        if len(arrays) > MOST_COLUMNS and all(isinstance(each, str) for each in mapped):
            ends = tuple("." + str(each).partition("[")[0] for each in mapped)
            paths = {name: "." + name.replace("/", ".") for name in arrays}
            selected = {
                n: arrays[n] for n in arrays if is_time(paths[n][1:]) or paths[n].endswith(ends)
            }
        size = sum(value.size for value in selected.values())
        check_room(path, size, f"{size} numbers")
        groups = {n for n in objects if not is_of_episode(n.split("/"), reading)} - datasets.keys()
        for name in [n for n in objects if n in arrays or n in groups]:
            array = _array(selected[name], matlab=matlab) if name in selected else None
            _put(variables, name, {} if name in groups else array)
    for name, value in attributes:
        text = value.decode(errors="replace") if isinstance(value, bytes) else value
        if describes_columns(name, text):
            _put(variables, name, text)
    return variables


def _put(variables: dict[str, Any], name: str, value: Any) -> None:
    """Store a value at its path in nested dicts; attributes of an array are stored beside it."""
    *structs, last = name.split("/")
    for k, struct in enumerate(structs):
        inside = variables.setdefault(struct, {})
        if not isinstance(inside, dict):
            last = "_".join([*structs[k:], last])
            break
        variables = inside
    variables[last] = value


def _array(dataset: Any, *, matlab: bool) -> Any:
    """Return the values of a dataset, transposed if MATLAB wrote it; None for MATLAB's texts."""
    if dataset.attrs.get("MATLAB_class", b"double") in (b"char", b"cell"):
        return None
    if names := dataset.dtype.names:
        return {name: dataset[name] for name in names}
    return np.asarray(dataset).T if matlab else np.asarray(dataset)


def _attributes(group: Any) -> list[tuple[str, Any]]:
    """Return the attributes of a group, including the fields of JSON texts, as in robomimic."""
    attributes = [*group.attrs.items()]
    for _, text in [*attributes]:
        if isinstance(text, str) and text.startswith("{"):
            with suppress(ValueError):
                attributes += fields_of(json.loads(text))
    return attributes


def read_parquet(path: Path, reading: Reading) -> LogTable:
    """Read a Parquet file; plain numbers are read lazily."""
    parquet = optional_package("pyarrow.parquet", "logs", "Parquet files", LogError)
    with readable(path, "Parquet file"):
        file = parquet.ParquetFile(path)
        rows, width = file.metadata.num_rows, file.metadata.num_columns
        check_room(path, rows * width, f"{rows} rows of {width} columns")
        names = file.schema_arrow.names
        is_plain = all(_PLAIN.fullmatch(str(field.type)) for field in file.schema_arrow)
        grouping = [n for n in names if numbers_joints(n) or tells(n, "robots", "recordings")]
        if is_plain and not grouping:
            check_once(path, names)
            return LogTable(path, ParquetColumns(path, file, names))
        return arrow_table(path, file.read())


_PLAIN = re.compile(r"float|double|u?int\d+")


class ParquetColumns(Mapping[str, Array]):
    """Numeric columns of a Parquet file, each read when it is needed."""

    def __init__(self, path: Path, file: Any, names: Sequence[str]) -> None:
        self._path, self._file, self._names = path, file, names

    def __getitem__(self, name: str) -> Array:
        with readable(self._path, "Parquet file"):
            column = self._file.read([name]).column(0).to_numpy()
        return np.array(column, float)  # a copy, as Arrow does not release its memory

    def __contains__(self, name: object) -> bool:
        return name in self._names

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)


def read_feather(path: Path, reading: Reading) -> LogTable:
    """Read a Feather or Arrow file."""
    feather = optional_package("pyarrow.feather", "logs", "Feather files", LogError)
    with readable(path, "Feather file"):
        return arrow_table(path, feather.read_table(path))


def arrow_table(path: Path, table: Any) -> LogTable:
    """Convert an Arrow table; columns are named `<struct>.<field>` and `<list>[0]`."""
    while any(str(field.type).startswith("struct") for field in table.schema):
        table = table.flatten()
    check_once(path, table.column_names)
    arrays = {name: arrow_numbers(table[name]) for name in table.column_names}
    return numeric_table(path, arrays, table.num_rows)


def arrow_numbers(column: Any) -> Any:
    """Return the values of an Arrow column; lists of equal length as (N, n)."""
    if not hasattr(column.type, "value_type") or not hasattr(column.type, "value_field"):
        return column.to_numpy()
    values = column.combine_chunks()
    if values.null_count or len(np.unique(values.value_lengths())) != 1:
        return column.to_numpy()
    flat = values.flatten().to_numpy(zero_copy_only=False)
    return np.asarray(flat).reshape(len(values), -1)


INFO = "meta/info.json"
"""File that identifies a folder as a dataset."""

_LARGEST_INFO = 100_000_000  # bytes
_ACTION = "action"  # commands of a policy or a person


def read_lerobot(path: Path, reading: Reading) -> LogTable:
    """Read a LeRobot dataset."""
    parquet = optional_package("pyarrow.parquet", "logs", "LeRobot datasets", LogError)
    with readable(path, "LeRobot dataset"):
        text = read_regular(path / INFO, "description", LogError, largest=_LARGEST_INFO)
        features = json.loads(text)["features"]
        meaning = dict(_columns_of_features(features))
        wanted = ["timestamp", "episode_index", *dict.fromkeys(f for f, _ in meaning)]
        episode = reading.episode
        only = None if episode is None else [("episode_index", "==", episode)]
        files = [*map(str, regular_files(path.glob("data/**/*.parquet"), "log", LogError))]
        data = parquet.read_table(files, columns=wanted, filters=only)
        columns = {**arrow_table(path, data).columns}
    if not len(data):
        of, advice = ("", "") if only is None else (f" of episode {episode}", "Count them from 0.")
        raise LogError(f"LeRobot dataset {str(path)!r} has no samples{of}.", advice=advice)
    named = {name: columns[column] for (_, column), name in meaning.items() if column in columns}
    common = {"time": columns["timestamp"], "episode_index": columns["episode_index"]}
    return LogTable(path, common | named)


def _columns_of_features(features: Mapping[str, Any]) -> Iterator[tuple[tuple[str, str], str]]:
    """Yield ((feature, column), name) for observations of joints and actions."""
    for feature, description in features.items():
        parsed, is_action = meaning_of(f"{feature}[0]"), feature == _ACTION
        is_read = is_action or feature.startswith("observation")
        if not is_read or parsed is None or parsed.role >= PREVIOUS:
            continue
        (size,) = description["shape"]
        names = _names(description.get("names"), size) or [""] * size
        for k, name in enumerate(names):
            joint, _, word = name.rpartition(".")
            stated = quantity_of(word) if joint else None
            if is_action and stated not in (None, "position"):
                continue  # not a position command
            joint = joint if stated else name
            quantity = "command" if is_action else stated or parsed.quantity
            column = feature if size == 1 else f"{feature}[{k}]"
            yield (feature, column), f"{joint}.{quantity}" if joint else f"{quantity}[{k}]"


def _names(names: Any, size: int) -> list[str] | None:
    """Return the names of a feature's components, which may be nested; None if there are none."""
    if isinstance(names, Mapping):
        names = [name for each in names.values() if isinstance(each, list) for name in each]
    if isinstance(names, list) and len(names) == 1 and isinstance(names[0], list):
        names = names[0]
    if isinstance(names, list) and len(names) == size:
        return [str(name) for name in names]
    return None


def read_npy(path: Path, reading: Reading) -> LogTable:
    """Read the records or the matrix in an NPY file."""
    advice = "Write it with numpy.save: records, or a row for each sample."
    with readable(path, "NPY file", advice):
        try:
            array = npy.open_memmap(regular_file(path, "log", LogError), mode="r")
        except ValueError as error:
            if "Python objects" not in str(error):
                raise
            what = "holds Python objects, such as a dict, which may run any program when read"
            save = "Save its arrays by name: numpy.savez(file, time=time, q=q, tau=tau)."
            raise LogError(f"Log {str(path)!r} {what}.", advice=save) from error
    check_room(path, array.size, f"{array.size} numbers")
    if array.dtype.names:
        return numeric_table(path, {n: array[n] for n in array.dtype.names}, len(array))
    if array.ndim != 2:
        raise LogError(
            f"The array in log {str(path)!r} is not 2-D: its shape is {array.shape}.",
            advice="Save a row for each sample, or records with a field for each column.",
        )
    first = tuple(str(value) for value in array[:1].ravel().tolist())
    names = renamed(path, reading, first) if reading.columns else numbered(first)
    table = numeric_table(path, dict(zip(names, array.T, strict=True)), len(array))
    return table if reading.columns else replace(table, unnamed=first)


_NPZ_ADVICE = "Store one 1-D array for each column, all of the same length."


def read_npz(path: Path, reading: Reading) -> LogTable:
    """Read an NPZ file."""
    arrays, objects = dict[str, Any](), list[str]()
    with (
        readable(path, "NPZ archive", f"Write it with numpy.savez. {_NPZ_ADVICE}"),
        open_log(path) as file,
        zipfile.ZipFile(file) as archive,
    ):
        entries = {e: e.filename.removesuffix(".npy").strip() for e in archive.infolist()}
        check_once(path, [*entries.values()])
        declared = {entry: _header(archive, entry) for entry in entries}
        wanted = {e: header for e, header in declared.items() if _may_be_log(entries[e], header[0])}
        size = sum(math.prod(shape) for shape, _ in wanted.values())
        check_room(path, size, f"{size} numbers")
        for entry, name in entries.items():
            shape, dtype = declared[entry]
            if is_used(name) and len(shape) != 1:
                raise LogError(
                    f"Array {name!r} in log {str(path)!r} is not 1-D: its shape is {shape}.",
                    advice=_NPZ_ADVICE,
                )
            if dtype.hasobject:
                objects.append(name)
                if names_joints(name) and reading.mapping is None:
                    raise LogError(
                        f"Log {str(path)!r} names its joints in {name!r}, an array of Python "
                        "objects, which may run any program when read.",
                        advice="Save it as numpy.array(names, dtype=str).",
                    )
            elif entry in wanted:
                with archive.open(entry) as member, np.errstate(over="ignore"):  # long doubles
                    array = npy.read_array(member, allow_pickle=False)
                    if member.read(1):
                        raise ValueError(f"array {name!r} is longer than its header says")
                    array = np.squeeze(array) if array.ndim > 2 else array
                    arrays[name] = np.asarray(array, float) if array.dtype.kind in "fiu" else array
    table = numeric_table(path, arrays, rows_of(arrays))
    return replace(table, silent={**table.silent, **dict.fromkeys(objects, "holds objects")})


def _may_be_log(name: str, shape: Sequence[int]) -> bool:
    """Return whether an array is read: any up to 2-D, or of joints, to report its shape."""
    meaning = meaning_of(name)
    width = sum(count != 1 for count in shape) if len(shape) > 2 else len(shape)
    return width <= 2 or (meaning is not None and meaning.quantity in OF_JOINTS)


def _header(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> tuple[tuple[int, ...], Any]:
    """Return the shape and dtype of an array from its header."""
    with archive.open(entry) as file:
        is_first = npy.read_magic(file) == (1, 0)
        read = npy.read_array_header_1_0 if is_first else npy.read_array_header_2_0
        return read(file)[::2]
