import importlib.util
from functools import cache
from importlib.metadata import packages_distributions

import pytest

collect_ignore_glob = [] if importlib.util.find_spec("flint") else ["test_*.py"]
"""Proofs need python-flint, which is optional."""


@pytest.fixture(scope="session", autouse=True)
def packages_listed_once():
    """A proof of a class that is not the package's asks for the package of its module, by a list of all files."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("gaitopt.proof.statement.packages_distributions", cache(packages_distributions))
        yield
