"""One folder of generated meshes for all tests of the experiments."""

import pytest


@pytest.fixture(scope="session")
def cache(tmp_path_factory):
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(autouse=True)
def tables_kept_elsewhere(tmp_path, monkeypatch):
    """Scripts keep their tables under out/, which is no place for those of tests."""
    from experiments.shared import arguments, tables

    monkeypatch.setattr(arguments, "TABLES", tmp_path / "tables")
    yield
    tables.keep(None, "", {})
