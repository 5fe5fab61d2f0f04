"""Read a table of columns as a log."""

import pandas
import pytest

from geodrake.logs import Reading, read_log


@pytest.fixture
def read_table(tmp_path):
    """Return a function that writes columns by name to `log.csv` and reads it as a log."""

    def read(columns, joints=None, *, partial=False, **reading):
        path = tmp_path / "log.csv"
        pandas.DataFrame(columns).to_csv(path, index=False)
        return read_log(path, joints=joints, partial=partial, reading=Reading(**reading))

    return read
