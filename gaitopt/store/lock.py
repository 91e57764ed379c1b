"""One writer at a time: a lock on the run folder that the system itself lets go of when its holder dies."""

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
from gaitopt.store.files import clear_leftovers, entries, parsed, read_bytes, reason, write_whole
from gaitopt.store.records import validated
from gaitopt.store.text import json_text, parse_object

LOCK_FILE = ".lock"
WRITER_FILE = ".writer"
"""Says who holds the lock."""
PATIENCE, LOOK_EVERY = 5.0, 0.02
"""Time that a reader waits for another process to finish a file, and between two looks at it [s]."""
LOOKS = 5
"""Looks in a row without a writer after which there is none: one writer may follow another."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Writer:
    """Who writes."""

    pid: int
    command: str
    since: str


@contextmanager
def only_writer(folder: Path) -> Iterator[None]:
    """Hold a folder that exists for writing, and remove what killed writers left; may be nested.

    Raises
    ------
    StorageError
        If another process holds it, it cannot be locked, or it was deleted since this process locked it.
    """
    try:
        lock = FileLock(folder.resolve() / LOCK_FILE, timeout=0, is_singleton=True)
        lock.acquire()
    except Timeout as error:
        remedy = "wait for it, or name another folder"
        raise StorageError(f"{folder} is being written by {_holder(folder)}; {remedy}").about("output") from error
    except (OSError, ValueError) as error:
        raise StorageError(f"cannot lock {folder}: {reason(error)}") from error
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
            _leave(folder)
        with suppress(OSError):  # the folder may be gone
            lock.release()


def written_elsewhere(folder: Path) -> bool:
    """Whether another process, which is alive, writes a run folder now."""
    try:
        pid = _writer(folder).pid
    except StorageError:
        return False
    import psutil  # takes long to import, and is rarely needed

    return pid != os.getpid() and psutil.pid_exists(pid)


def wait_for_writer(folder: Path, ready: Callable[[], bool]) -> None:
    """Return once ``ready()`` is true, or no other process writes the folder.

    Raises
    ------
    StorageError
        If another process still writes it after ``PATIENCE``.
    """
    deadline, alone = time.monotonic() + PATIENCE, 0
    while not ready() and alone < LOOKS:
        alone = 0 if written_elsewhere(folder) else alone + 1
        if time.monotonic() > deadline:
            raise StorageError(f"{folder} is being written by {_holder(folder)}: wait until it has finished")
        time.sleep(LOOK_EVERY)


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
    except StorageError:  # it has the lock, but has not yet said who it is
        return "another process"
    return f"process {writer.pid} ({writer.command}, since {writer.since})"


def _leave(folder: Path) -> None:
    """Take our name and the lock away while it is held; a folder in which nothing was written goes too."""
    with suppress(OSError):  # Windows removes no open file: there the lock stays, which does no harm
        (folder / WRITER_FILE).unlink()
        (folder / LOCK_FILE).unlink()
        if not any(folder.iterdir()):
            folder.rmdir()
