"""Public measurements and models that some tests need and the project does not contain.

Such a test is marked with their paths, and skipped where they are absent:

    @pytest.mark.measurements("data/tx40.csv", "reference/tx40.urdf")
"""

import os
from pathlib import Path

MEASUREMENTS = Path(
    os.environ.get("GEODRAKE_MEASUREMENTS", Path(__file__).parents[2] / "shared")
).absolute()
DATA, REFERENCE = MEASUREMENTS / "data", MEASUREMENTS / "reference"


def absent(names):
    """Return the absent ones of some names, which may be patterns such as data/tx40*.csv."""
    return [name for name in names if not any(MEASUREMENTS.glob(name))]
