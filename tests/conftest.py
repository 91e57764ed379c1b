"""Settings of the whole test suite: generated examples are the same in every run; and what tests of commands share."""

import pytest
from hypothesis import settings

from gaitopt.cli.main import main

settings.register_profile("reproducible", derandomize=True, deadline=None)
settings.load_profile("reproducible")


@pytest.fixture
def empty_folder(tmp_path, monkeypatch):
    """Work in a folder of the test's own."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def run(capsys):
    """Run the command line; exit code, stdout and stderr."""

    def call(*argv):
        code = main(argv)
        out, err = capsys.readouterr()
        return code, out, err

    return call
