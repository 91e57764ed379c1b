"""Killed at any write, sync or rename, or with a full disk there: the next run completes it, as if undisturbed."""

import errno
import json
import os
import re
import shutil
import warnings
from pathlib import Path

import pytest

from gaitopt import load_problem
from gaitopt.cli.main import main
from gaitopt.store.formats import Table
from gaitopt.store.run import Run

pytestmark = pytest.mark.skipif(os.name != "posix", reason="a process is forked for every crash point")

WHEEL = "rimless-wheel-slip"
GAIT = {"problem": WHEEL, "status": "converged", "period": 1 / 3}
TABLE = Table(header=("t", "mode", "theta"), rows=((0.0, "stick", -0.1), (1 / 3, "stick", 0.1)))
COMMANDS = {
    "solve": ("solve", WHEEL, "-o", "run"),
    "starts": ("solve", WHEEL, "--starts", "2", "--spread", "0.01", "--workers", "1", "-o", "run"),
    "continue": ("continue", WHEEL, "--param", "friction", "--to", "0.401", "-o", "run"),
    "sweep": ("sweep", WHEEL, "--over", "friction=0.40:0.42:2", "--workers", "1", "-o", "run"),
    "basin": ("basin", WHEEL, "--over", "dtheta=0.8:1.0:4", "--engine", "scipy", "--workers", "1", "-o", "run"),
    "attractors": (
        *("attractors", WHEEL, "--over", "friction=0.36:0.44:2", "--starts", "2", "--transient", "20", "--keep", "4"),
        *("--workers", "1", "-o", "run"),
    ),
    "front": (
        *("front", "rimless-wheel-slope", "--set", "objective=walker.slope", "--set", "constraints={}"),
        *("--over", "constraints.speed.min=0.8:0.81:2", "-o", "run"),
    ),
    "robustness": ("robustness", WHEEL, "--what", "sensitivity", "--engine", "scipy", "--workers", "1", "-o", "run"),
    "simulate": ("simulate", WHEEL, "-o", "run"),
    "plot": ("plot", WHEEL, "--what", "slip", "--format", "svg"),
    "report": ("report", WHEEL),
}
REST = (("kill", False), ("tear", True), ("tear", False), ("full", True), ("full", False))
TIMES = re.compile(rb'(, )?"seconds": [^,}\s]+|(, )?"crc": "[^"]+"|seconds</th><td>[^<]+|[\w+/=]{200,}')
"""How long something took, the checksums of lines that say so, and the packed frames of an animation: those of a gait
that is read differ in their last digits from those of the gait that was just solved."""
SAME = 1e-9
"""A walk along a family that was taken up agrees with one that was not, to this, and everything else exactly."""
KILLED = 77
"""Exit code of a process that died at its crash point."""


class CrashPoint:
    """Counts what reaches the disk: writes, syncs and renames. At the n-th the process dies, or the disk is full.

    Only a write can tear.
    """

    def __init__(self, kind, n):
        self.kind, self.n, self.count = kind, n, 0

    def guarded(self, call):
        def guard(*arguments, **options):
            self.count += 1
            if self.count != self.n:
                return call(*arguments, **options)
            if self.kind == "full":
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            if self.kind == "tear":
                descriptor, content = arguments
                call(descriptor, bytes(content)[: len(content) // 2])
            os._exit(KILLED)

        return guard

    def install(self):
        os.write = self.guarded(os.write)
        if self.kind != "tear":
            os.fsync, os.ftruncate = self.guarded(os.fsync), self.guarded(os.ftruncate)
            Path.replace, Path.unlink = self.guarded(Path.replace), self.guarded(Path.unlink)


def forked(kind, n, work):
    """Exit code of a child that dies or fails at its n-th point, and how many points it reached."""
    read, write = os.pipe()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of forks beside threads, of which ours do nothing
        child = os.fork()
    if child == 0:
        code = 1
        try:
            os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
            os.dup2(1, 2)
            point, output = CrashPoint(kind, n), os.write
            point.install()
            code = work() or 0
            output(write, str(point.count).encode())
        finally:
            os._exit(code)
    os.close(write)
    with os.fdopen(read) as answer:
        count = answer.read()
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), int(count or 0)


def write_everything():
    """What the commands do to a disk, without the mathematics."""
    problem = load_problem(WHEEL)
    run = Run(Path("run"))
    run.write_result(problem, GAIT, TABLE)
    with run.appending("jobs.jsonl") as lines:
        for job in {0, 1} - {record["job"] for record in lines.records}:
            lines.append({"job": job, "period": 1 / 3})


def everything():
    run = Run(Path("run"))
    return *run.read_result(), list(run.lines("jobs.jsonl")), sorted(Path("run").iterdir())


@pytest.mark.parametrize(
    ("kind", "again", "every"),
    [("kill", True, 5), *(pytest.param(*case, 1, marks=pytest.mark.slow) for case in (("kill", True), *REST))],
    ids=lambda value: {True: "replaced", False: "new"}.get(value, value),
)
@pytest.mark.usefixtures("empty_folder")
def test_store_is_completed_after_a_crash_at_any_point(kind, again, every):
    write_everything()
    whole = everything()
    shutil.rmtree("run")
    code, points = forked(kind, 0, write_everything)
    assert (code, points > 5) == (0, True)
    for n in range(1, points + 1, every):
        if not again:
            shutil.rmtree("run", ignore_errors=True)
        code, _ = forked(kind, n, write_everything)
        assert code != 0 or n > 1
        write_everything()
        assert everything() == whole, n
    assert not list(Path("run").rglob("*.tmp"))


def state(folder):
    """What a run folder holds, but for what tells when it was written."""
    contents = {}
    for path in sorted(folder.rglob("*")):
        if path.is_file() and path.name not in ("manifest.json", ".lock", ".writer"):
            contents[path.relative_to(folder).as_posix()] = TIMES.sub(b"", path.read_bytes())
    return contents


def numbers(value):
    if isinstance(value, dict):
        return [number for key in sorted(value) for number in numbers(value[key])]
    if isinstance(value, list):
        return [number for entry in value for number in numbers(entry)]
    return [float(value)] if isinstance(value, int | float) else []


def same_branch(text, other):
    """Whether two files of records hold the same points and special points, but for what Newton's method left."""
    rows, others = ([json.loads(line) for line in lines.splitlines()] for lines in (text, other))
    assert [(r["record"], r.get("type")) for r in rows] == [(r["record"], r.get("type")) for r in others]
    for row, again in zip(rows, others, strict=True):
        for key in ("value", "state", "period", "multipliers"):
            assert numbers(row.get(key)) == pytest.approx(numbers(again.get(key)), rel=SAME, abs=SAME)


def commands(names, **marks):
    return [pytest.param(COMMANDS[name], id=name, **marks) for name in names]


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["kill", "tear", "full"])
@pytest.mark.parametrize("command", commands(COMMANDS))
@pytest.mark.usefixtures("empty_folder")
def test_every_command_is_completed_after_a_crash_at_any_point(command, kind):
    quiet = [*command, "--quiet"]
    main(quiet)  # what it builds in memory, the children share
    for folder in ("run", "results"):
        shutil.rmtree(folder, ignore_errors=True)
    code, points = forked(kind, 0, lambda: main(quiet))
    assert (code, points > 5) == (0, True)
    whole = {path: state(path) for path in (Path("run"), Path("results")) if path.exists()}
    for n in range(1, points + 1):
        for folder in whole:
            shutil.rmtree(folder, ignore_errors=True)
        code, _ = forked(kind, n, lambda: main(quiet))
        assert code in ((0, 6) if kind == "full" else (0, KILLED)), n
        assert forked(kind, 0, lambda: main(quiet))[0] == 0, n
        assert not list(Path().rglob("*.tmp")), n
        for folder, files in whole.items():
            again = state(folder)
            assert again.keys() == files.keys(), n
            for name, content in files.items():
                if name == "branch.jsonl":
                    same_branch(content, again[name])
                elif name != "branch.csv":
                    assert again[name] == content, (n, name)
