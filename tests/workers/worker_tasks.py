"""What workers do in tests; in a module that imports nothing, as every worker process imports it."""

import os
import signal
import time
from pathlib import Path


def work(argument, parent):
    """Say who is at it, take a moment, and give the square; a deadly job kills its worker instead."""
    number, diary, deadly = argument
    with Path(diary).open("a", encoding="utf-8") as file:
        file.write(f"{number} {os.getpid()}\n")
    if deadly:
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(0.01)
    return number**2 + (parent or 0)


def refuse(argument, parent):
    """Fail."""
    raise ArithmeticError(f"no root of {argument}")


def square(argument, _):
    return argument**2


def slow_square(argument, _):
    time.sleep(0.2)
    return argument**2
