"""Ctrl-C and SIGTERM end every command with 130 and 143, and the same command then completes what was begun."""

import os
import signal
import subprocess
import sys
import time

import pytest
from rich.console import Console

from gaitopt.cli.main import main

pytestmark = [
    pytest.mark.skipif(os.name != "posix", reason="signals of POSIX"),
    pytest.mark.usefixtures("empty_folder"),
]

WHEEL = "rimless-wheel-slip"
COMMANDS = {
    "solve": ("solve", WHEEL),
    "starts": ("solve", WHEEL, "--starts", "2", "--spread", "0.01", "--workers", "1"),
    "simulate": ("simulate", WHEEL),
    "verify": ("verify", WHEEL),
    "continue": ("continue", WHEEL, "--param", "friction", "--to", "0.41"),
    "sweep": ("sweep", WHEEL, "--over", "friction=0.40:0.42:2", "--workers", "1"),
    "basin": ("basin", WHEEL, "--over", "dtheta=0.8:1.0:4", "--engine", "scipy", "--workers", "1"),
    "plot": ("plot", WHEEL, "--what", "slip", "--format", "svg"),
    "report": ("report", WHEEL),
}


def at_print(monkeypatch, n, signum):
    """Send a signal when something is printed for the n-th time; the number of times so far."""
    count, printed = [0], Console.print

    def show(self, *arguments, **settings):
        count[0] += 1
        if count[0] == n:
            signal.raise_signal(signum)
        printed(self, *arguments, **settings)

    monkeypatch.setattr(Console, "print", show)
    return count


@pytest.mark.parametrize("n", [1, pytest.param("all", marks=pytest.mark.slow)])
@pytest.mark.parametrize(("signum", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
@pytest.mark.parametrize("command", COMMANDS.values(), ids=COMMANDS)
def test_a_signal_while_something_is_shown_ends_the_command(monkeypatch, command, signum, code, n):
    last = n
    if n == "all":
        with monkeypatch.context() as patch:
            count = at_print(patch, -1, signum)
            assert main(command) == 0
        last = count[0]
    for number in range(1, last + 1):
        with monkeypatch.context() as patch:
            at_print(patch, number, signum)
            assert main(command) in ((code,) if number == 1 else (code, 0)), number
    if n == "all":
        assert main(command) == 0


SWEEP = ("sweep", WHEEL, "--over", "friction=0.3:0.5:300", "--workers", "1", "-o", "run")
ATTRACTORS = ("attractors", WHEEL, "--over", "friction=0.3:0.5:1000", "--workers", "1", "-o", "run")
BASIN = ("basin", WHEEL, "--over", "dtheta=0.4:1.4:100000", "--engine", "scipy", "--workers", "1", "-o", "run")


@pytest.mark.parametrize(
    ("command", "signum", "code"),
    [
        pytest.param(ATTRACTORS, signal.SIGTERM, 143, id="attractors-terminated", marks=pytest.mark.slow),
        pytest.param(SWEEP, signal.SIGINT, 130, id="sweep-interrupted"),
        pytest.param(BASIN, signal.SIGTERM, 143, id="basin-terminated", marks=pytest.mark.slow),
        pytest.param(SWEEP, signal.SIGTERM, 143, id="sweep-terminated", marks=pytest.mark.slow),
        pytest.param((*SWEEP, "--workers", "2"), signal.SIGINT, 130, id="workers-interrupted", marks=pytest.mark.slow),
        pytest.param(BASIN, signal.SIGINT, 130, id="basin-interrupted", marks=pytest.mark.slow),
    ],
)
def test_a_command_and_its_workers_end_at_once_in_silence_and_keep_what_is_done(empty_folder, command, signum, code):
    """Ctrl-C of a terminal goes to all processes of the command."""
    begun = {"sweep": "jobs.jsonl", "basin": "basin-*", "attractors": "attractors-*/settled.jsonl"}[command[0]]
    process = subprocess.Popen(
        [sys.executable, "-m", "gaitopt", *command], start_new_session=True, stderr=subprocess.PIPE, text=True
    )
    until = time.monotonic() + 100
    while not any(path.is_dir() or path.read_text() for path in empty_folder.glob(f"run/{begun}")):
        assert time.monotonic() < until
        time.sleep(0.05)
    os.killpg(process.pid, signum)
    before = os.times().elapsed
    words = process.communicate(timeout=60)[1]
    assert process.returncode == code, words
    assert os.times().elapsed - before < 2 * max(1.0, os.getloadavg()[0])  # two seconds where a core is free
    assert "Traceback" not in words
    assert words.splitlines()[-1] == {130: "gaitopt: interrupted", 143: "gaitopt: terminated"}[code]
    assert not (empty_folder / "run" / ".writer").exists()
