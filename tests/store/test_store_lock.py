"""One process at a time writes a run folder; whoever comes second learns who is at it."""

import os
import shutil
import signal
import subprocess
import sys
import time

import pytest

from gaitopt import load_problem, load_run
from gaitopt.errors import StorageError
from gaitopt.store import lock
from gaitopt.store.lock import LOCK_FILE, only_writer
from gaitopt.store.run import Run

WHEEL = "rimless-wheel-slip"
HOLDER = """
import pathlib, sys
from gaitopt.store.lock import only_writer
with only_writer(pathlib.Path(sys.argv[1])):
    input(print("locked", flush=True))
"""


def hold(folder):
    holder = subprocess.Popen([sys.executable, "-c", HOLDER, folder], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    holder.stdout.readline()
    return holder


def end(holder, how=None):
    if how is not None:
        holder.send_signal(how)
    holder.communicate(b"\n")


def test_the_second_writer_learns_who_is_at_it_since_when(tmp_path):
    holder = hold(tmp_path)
    words = rf"{tmp_path} is being written by process {holder.pid} \(-c .*, since 20\d\d-.*\); wait for it"
    try:
        with pytest.raises(StorageError, match=words), only_writer(tmp_path):
            pass
    finally:
        end(holder)
    with only_writer(tmp_path):
        pass


@pytest.mark.skipif(os.name != "posix", reason="kills by a signal")
def test_the_lock_and_the_leftovers_of_a_killed_writer_go(tmp_path):
    holder = hold(tmp_path)
    leftovers = [
        tmp_path / f".gait.json.{holder.pid}-{'0' * 16}.tmp",
        tmp_path / "sweep-1" / f".a.{holder.pid}-{'1' * 16}.tmp",
    ]
    (tmp_path / "sweep-1").mkdir()
    (tmp_path / "gait.json").write_text("{}")
    for path in leftovers:
        path.write_text("half")
    mine = tmp_path / f".other.{os.getppid()}-{'0' * 16}.tmp"
    mine.write_text("a writer that lives")
    end(holder, signal.SIGKILL)
    with only_writer(tmp_path):
        assert not any(path.exists() for path in leftovers)
    assert {path.name for path in tmp_path.iterdir()} == {"gait.json", "sweep-1", mine.name}


def test_a_folder_in_which_nothing_was_written_goes_with_its_parents_unless_they_were_there(tmp_path):
    with Run(tmp_path / "results" / "deep" / "run").writing(load_problem(WHEEL)):
        assert (tmp_path / "results" / "deep" / "run").is_dir()
        (tmp_path / "results" / "other").mkdir()
    assert [path.name for path in tmp_path.rglob("*")] == ["results", "other"]


def test_a_folder_that_was_deleted_meanwhile_is_not_written_again(tmp_path):
    folder, problem = tmp_path / "run", load_problem(WHEEL)
    with Run(folder).writing(problem):
        shutil.rmtree(folder)
        with pytest.raises(StorageError, match="was deleted or replaced"), Run(folder).begun(problem):
            pass
    assert not folder.exists()


@pytest.mark.skipif(os.name != "posix", reason="links need rights elsewhere")
def test_a_planted_lock_is_not_followed(tmp_path):
    (tmp_path / "precious").write_text("precious")
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / LOCK_FILE).symlink_to(tmp_path / "precious")
    with pytest.raises(StorageError, match=r"cannot lock"), only_writer(tmp_path / "run"):
        pass
    assert (tmp_path / "precious").read_text() == "precious"


@pytest.mark.slow
def test_of_several_problems_for_one_folder_one_wins(tmp_path):
    solve = [sys.executable, "-m", "gaitopt", "solve", WHEEL, "-o", "run", "--quiet", "--set"]
    commands = [[*solve, f"friction=0.4{k}"] for k in range(8)]
    solvers = [
        subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        for command in commands
    ]
    words = [solver.communicate()[1] for solver in solvers]
    codes = [solver.returncode for solver in solvers]
    assert sorted(codes) == [0] + 7 * [6], words
    assert all("being written by" in said or "contains another problem" in said for said in words if said)
    winner = load_problem(WHEEL).replace({"friction": float(f"0.4{codes.index(0)}")})
    assert Run(tmp_path / "run").manifest().hash == winner.digest


SAVER = """
import sys
import gaitopt as go
gait = go.solve(go.load_problem(sys.argv[1]))
print("solved", flush=True)
for _ in range(15):
    gait.save(sys.argv[2])
"""


def test_a_reader_beside_a_writer_waits_for_it(tmp_path):
    """The same gait is written again and again: each reader finds all of it."""
    writer = subprocess.Popen([sys.executable, "-c", SAVER, WHEEL, tmp_path / "run"], stdout=subprocess.PIPE)
    writer.stdout.readline()
    while not (tmp_path / "run" / "manifest.json").exists():
        time.sleep(0.001)
    read = 0
    while writer.poll() is None:
        assert load_run(tmp_path / "run").converged
        read += 1
    assert read > 5
    writer.communicate()
    assert writer.returncode == 0


def test_a_reader_names_the_writer_that_takes_long(tmp_path, monkeypatch):
    monkeypatch.setattr(lock, "PATIENCE", 0.1)
    with Run(tmp_path / "run").begun(load_problem(WHEEL)):
        pass
    holder = hold(tmp_path / "run")
    try:
        with pytest.raises(StorageError, match=rf"is being written by process {holder.pid} .*: wait until it has fin"):
            load_run(tmp_path / "run")
    finally:
        end(holder)
    with pytest.raises(StorageError, match="contains no gaitopt result"):
        load_run(tmp_path / "run")
