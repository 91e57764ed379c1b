"""Settings of the whole test suite: generated examples are the same in every run; and what tests of commands share."""

import gc
import importlib.util
import os
import signal
import sys

# before numpy is imported: the processes of the suite share the cores, and threads would fight over them
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.pop("COLUMNS", None)  # of the terminal that the suite runs in; what is printed here goes to pipes
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # the many processes of the suite share their compiled modules

import dask
import pytest
from hypothesis import settings

from gaitopt.cli.main import main

sys.dont_write_bytecode = False
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # as in the background of a shell; commands inherit it
    signal.signal(signal.SIGINT, signal.default_int_handler)

settings.register_profile("reproducible", derandomize=True, deadline=None)
settings.load_profile("reproducible")


def pytest_xdist_auto_num_workers(config):
    """One worker more than cores: a fifth of the suite waits for commands, workers and schedulers that it starts."""
    return (os.cpu_count() or 1) + 1


def pytest_collection_finish():
    """Modules and tests stay until the end: the garbage collector need not look at them again and again."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session", autouse=True)
def forked_workers():
    """Workers are forked from a process that has imported Dask, within a tenth of a second; commands spawn theirs."""
    method = "forkserver" if sys.platform == "linux" else "spawn"
    with dask.config.set({"distributed.worker.multiprocessing-method": method}):
        yield


@pytest.fixture(scope="session", autouse=True)
def quickly_compiled(request):
    """Short series are unrolled as in commands, longer ones are loops; the quick tests do not optimise their code."""
    if importlib.util.find_spec("heyoka") is None:
        yield
        return
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("gaitopt.simulation.heyoka_code.LONGEST_UNROLLED", 100)
        if request.config.option.markexpr == "not slow":
            patch.setattr("gaitopt.simulation.heyoka_code.OPTIMISATION", 0)
        yield


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
