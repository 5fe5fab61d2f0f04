"""Commands run in a folder of their test, where they may leave proposals of mappings."""

import pytest


@pytest.fixture(autouse=True)
def folder(tmp_path_factory, monkeypatch):
    """Change to an empty folder."""
    monkeypatch.chdir(tmp_path_factory.mktemp("working"))
