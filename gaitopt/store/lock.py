"""The lock of a run folder: one process writes it at a time, readers wait for a file that is about to be finished.

The operating system locks a file for the writing process, and releases it when the process ends. A second file names
the writer for the messages of other processes.
"""

import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from datetime import datetime
from pathlib import Path

from filelock import FileLock, Timeout

from gaitopt.errors import StorageError
from gaitopt.store.files import clear_leftovers, entries, read_bytes, write_whole
from gaitopt.store.formats import json_text, parse_object, parsed, reason, validated

LOCK_FILE = ".lock"
WRITER_FILE = ".writer"
"""The file that names the process that holds the lock."""
PATIENCE, POLLING_TIME = 5.0, 0.02
"""Time that a reader waits for another process to finish a file, and time between two checks [s]."""
CHECKS_WITHOUT_WRITER = 5
"""Number of checks in a row that must find no writer, because one writer may follow another."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Writer:
    """The process that writes a folder."""

    pid: int
    command: str
    since: str


@contextmanager
def only_writer(folder: Path) -> Iterator[None]:
    """Lock an existing folder for writing, and remove the temporary files of killed writers. Blocks may be nested.

    A folder in which nothing was written is removed at the end.

    Raises
    ------
    StorageError
        If another process holds the lock, if the folder cannot be locked, or if it was deleted after it was locked.
    """
    try:
        lock = FileLock(folder.resolve() / LOCK_FILE, timeout=0, is_singleton=True)
        lock.acquire()
    except Timeout as error:
        remedy = "wait for it, or name another folder"
        raise StorageError(f"{folder} is being written by {_holder(folder)}; {remedy}").concerning("output") from error
    except (OSError, ValueError) as error:
        message = f"cannot lock {folder}: {reason(error)}; choose another folder"
        raise StorageError(message).concerning("output") from error
    outermost = lock.lock_counter == 1
    try:
        if outermost:
            clear_leftovers(folder, *(path for path in entries(folder) if path.is_dir() and not path.is_symlink()))
            since = datetime.now().astimezone().isoformat(timespec="seconds")
            writer = Writer(pid=os.getpid(), command=" ".join(sys.argv), since=since)
            write_whole(folder / WRITER_FILE, json_text(asdict(writer)) + "\n")
        elif not _is_ours(folder):
            raise StorageError(f"{folder} was deleted or replaced while this command was writing it")
        yield
    finally:
        if outermost and _is_ours(folder):
            with suppress(OSError):  # Windows does not remove open files; a lock file that stays is harmless
                (folder / WRITER_FILE).unlink()
                (folder / LOCK_FILE).unlink()
                if not any(folder.iterdir()):
                    folder.rmdir()
        with suppress(OSError):  # the folder may be gone
            lock.release()


def written_elsewhere(folder: Path) -> bool:
    """Whether another running process is writing the folder now."""
    try:
        pid = _writer(folder).pid
    except StorageError:
        return False
    import psutil  # slow to import and rarely needed

    return pid != os.getpid() and psutil.pid_exists(pid)


def wait_for_writer(folder: Path, ready: Callable[[], bool]) -> None:
    """Wait until ``ready()`` is true, or no other process writes the folder.

    Raises
    ------
    StorageError
        If another process still writes the folder after ``PATIENCE``.
    """
    deadline, alone = time.monotonic() + PATIENCE, 0
    while not ready() and alone < CHECKS_WITHOUT_WRITER:
        alone = 0 if written_elsewhere(folder) else alone + 1
        if not alone and time.monotonic() > deadline:
            raise StorageError(f"{folder} is being written by {_holder(folder)}: wait until it has finished")
        time.sleep(POLLING_TIME)


def _writer(folder: Path) -> Writer:
    path = folder / WRITER_FILE
    return validated(Writer, parsed(parse_object, read_bytes(path), path), path)


def _is_ours(folder: Path) -> bool:
    try:
        return _writer(folder).pid == os.getpid()
    except StorageError:
        return False


def _holder(folder: Path) -> str:
    try:
        writer = _writer(folder)
    except StorageError:  # the process holds the lock, but has not written its name yet
        return "another process"
    return f"process {writer.pid} ({writer.command}, since {writer.since})"
