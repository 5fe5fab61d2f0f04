"""One module opens files, and nothing else in the package does."""

import ast
import re
from pathlib import Path

import geodrake

PACKAGE = Path(geodrake.__file__).parent
OPENERS = frozenset(
    {
        *("open", "fdopen", "read_text", "read_bytes", "fromfile", "genfromtxt", "open_memmap"),
        *(
            "File",
            "ZipFile",
            "read_excel",
            "ParquetFile",
            "ParquetDataset",
            "read_table",
            "loadmat",
            "EventLog",
        ),
        *(
            "Reader",
            "AnyReader",
            "connect",
            "read_csv",
            "read_parquet",
            "read_feather",
            "read_json",
        ),
        *("AddModels", "AddModelsFromUrl", "ProcessModelDirectives", "LoadModelDirectives"),
        *("from_xml_path", "MemoryFile", "exec_module", "run_path"),
    }
)
"""Names of functions that open files by their paths."""

ARRAYS = frozenset({"load", "loadtxt"})
"""Those that do in NumPy, of which others are called alike."""

SEEN = re.compile(rf"\b({'|'.join(OPENERS | ARRAYS)})\(")

DOOR = {"boundary/input_files.py": {"open", "fdopen"}}

CHECKED = {
    "control/export_proof/engines.py": {"AddModels", "from_xml_path", "run_path"},
    "effects/user_effects.py": {"exec_module"},
    "excitation/collisions.py": {"open"},  # to write what Drake reads
    # Of archives, what a file that the door has opened holds.
    "logs/files/array_files.py": {
        "File",
        "loadmat",
        "ParquetFile",
        "read_table",
        "ZipFile",
        "open",
        "open_memmap",
    },
    "logs/files/message_logs.py": {"Reader"},
    "robot/files/description.py": {"AddModels", "ProcessModelDirectives"},
    # Files of text.
    "robot/shapes.py": {"MemoryFile"},
}
"""Module -> what it hands to a library by its path, after the door has checked what is there."""

HELD = {
    "logs/files/packed_files.py": {"ZipFile", "open"},
    "logs/files/text_file.py": {"read_csv", "read_excel", "ZipFile"},
}
"""Module -> what it reads of a file that the door has opened, or of lines and entries of it."""

OWN = {
    "boundary/whole_files.py": {"open"},
    "cli/streams.py": {"open"},
    "compiling.py": {"fdopen", "open", "read_text"},
    "identification/solvers.py": {"open"},
    "logs/files/units.py": {"read_bytes"},
    "report/html.py": {"read_text"},
    "report/videos.py": {"read_bytes"},
    "report/recordings.py": {"read_bytes"},
    "report/json_output.py": {"read_text"},
}
"""Module -> what it opens of the package's own, or to write."""


def openers(source: str) -> set[str]:
    """Return the names of functions that open files among all calls of a module."""
    if not SEEN.search(source):
        return set()
    calls = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Call)]
    found = set()
    for function in (call.func for call in calls):
        if isinstance(function, ast.Name) and function.id in OPENERS:
            found.add(function.id)
        if isinstance(function, ast.Attribute):
            of_numpy = isinstance(function.value, ast.Name) and function.value.id == "np"
            if function.attr in (ARRAYS if of_numpy else OPENERS):
                found.add(function.attr)
    return found


def test_every_file_is_read_through_the_door():
    found = {
        str(path.relative_to(PACKAGE)): calls
        for path in PACKAGE.rglob("*.py")
        if (calls := openers(path.read_text(encoding="utf-8")))
    }
    assert found == DOOR | CHECKED | HELD | OWN
