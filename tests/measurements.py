"""Where the public measurements and models are that some tests need and the project does not have.

A test that needs some is marked with their paths, and skipped where they are absent:

    @pytest.mark.measurements("data/tx40.csv", "reference/tx40.urdf")
"""

import os
from pathlib import Path

MEASUREMENTS = Path(
    os.environ.get("GEODRAKE_MEASUREMENTS", Path(__file__).parents[2] / "shared")
).absolute()
DATA, REFERENCE = MEASUREMENTS / "data", MEASUREMENTS / "reference"


def absent(names):
    """Those of the names that are not there; a name may be a pattern, such as data/tx40*.csv."""
    return [name for name in names if not any(MEASUREMENTS.glob(name))]
