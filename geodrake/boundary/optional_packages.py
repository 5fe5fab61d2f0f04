"""Import of optional packages on demand."""

from __future__ import annotations

import importlib
from typing import Any

from geodrake.errors import GeodrakeError


def optional_package(module: str, extra: str, what: str, error: type[GeodrakeError]) -> Any:
    """Import a module of a package that may not be installed.

    Args:
        module: The module, such as "pyarrow.parquet".
        extra: The extra of geodrake that installs it.
        what: Its purpose, for the message, such as "Parquet files".
    """
    try:
        return importlib.import_module(module)
    except ImportError as missing:
        package = module.partition(".")[0]
        if missing.name is not None and missing.name.split(".")[0] != package:
            package = f"{package} ({missing.name})"
        raise error(
            f"The package {package}, needed for {what}, is not installed.",
            advice=f'Install it: pip install "geodrake[{extra}]".',
            extra=extra,
        ) from missing
