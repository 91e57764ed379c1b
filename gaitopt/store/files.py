"""Files that appear whole or not at all: written beside their place under a random name, synced, then renamed into it.

No link is followed: what is planted under the name of a file is replaced, never written through.
"""

import os
import re
import secrets
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TypeVar

from gaitopt.errors import StorageError

Parsed = TypeVar("Parsed")

TEMPORARY_SUFFIX = ".tmp"
TEMPORARY_NAME = re.compile(r"\..+\.(?P<pid>\d+)-[0-9a-f]{16}\.tmp")
"""Of the temporary file of a process; those of killed processes are leftovers."""
OWN_FILE = os.O_NOFOLLOW | os.O_CLOEXEC if os.name == "posix" else os.O_BINARY  # type: ignore[attr-defined]
"""Flags with which every file is opened for writing."""


def write_whole(path: Path, content: str | bytes) -> None:
    """Write ``content`` to ``path``; a reader finds the old file or the new one, even after a crash.

    Raises
    ------
    StorageError
        If the disk is full or the folder cannot be written; what was there before is unchanged.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}-{secrets.token_hex(8)}{TEMPORARY_SUFFIX}")
    try:
        descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL | OWN_FILE, 0o666)
        try:
            write_all(descriptor, content.encode() if isinstance(content, str) else content)
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
        temporary.replace(path)
        sync_folder(path.parent)
    except (OSError, ValueError) as error:
        raise StorageError(f"cannot write {path}: {reason(error)}; {_kept(path.parent)}") from error
    finally:
        with suppress(OSError, ValueError):  # a disk that refused the file may refuse this too
            temporary.unlink(missing_ok=True)


def write_all(descriptor: int, content: bytes) -> None:
    """Write all bytes: the system may take fewer at a time than it is given."""
    rest = memoryview(content)
    while rest:
        rest = rest[os.write(descriptor, rest) :]


def make_folder(folder: Path, *, parents: bool = True) -> None:
    """Make ``folder`` and its parents, durably; one that exists is left alone.

    Raises
    ------
    StorageError
        If it cannot be made, or without ``parents`` if its parent is not there.
    """
    try:
        if folder.is_dir():
            return
        folder.mkdir(parents=parents, exist_ok=True)
        sync_folder(folder.parent)
    except (OSError, ValueError) as error:
        raise StorageError(f"cannot make the folder {folder}: {reason(error)}; nothing was written") from error


def entries(folder: Path) -> list[Path]:
    """What a folder holds; nothing if it is not there."""
    try:
        return list(folder.iterdir())
    except FileNotFoundError:
        return []
    except OSError as error:
        words = f"cannot use {folder} as a run folder: {reason(error)}; name another"
        raise StorageError(words).about("output") from error


def clear_leftovers(*folders: Path) -> None:
    """Remove the temporary files of killed writers; those of processes that are alive are left."""
    for folder in folders:
        with suppress(OSError):  # what cannot be listed or removed does no harm
            for path in folder.iterdir():
                matched = TEMPORARY_NAME.fullmatch(path.name)
                if matched:
                    import psutil  # takes as long to import as all writing takes, and is rarely needed

                    pid = int(matched["pid"])
                    if pid == os.getpid() or not psutil.pid_exists(pid):
                        path.unlink(missing_ok=True)


def read_bytes(path: Path) -> bytes:
    """Read a file."""
    try:
        return path.read_bytes()
    except FileNotFoundError as error:
        raise StorageError(f"{path} is missing; the run is broken and was left alone") from error
    except OSError as error:
        raise StorageError(f"cannot read {path}: {reason(error)}; the run is broken and was left alone") from error


def sync_folder(folder: Path) -> None:
    """Make new names in ``folder`` survive a power cut (POSIX; elsewhere a rename is all there is)."""
    if os.name != "posix":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def parsed(parse: Callable[[str], Parsed], content: bytes, path: Path) -> Parsed:
    """What a file holds, read by ``parse``.

    Raises
    ------
    StorageError
        If it is not text, or ``parse`` raises a ValueError; the message names the file.
    """
    try:
        return parse(content.decode("utf-8"))
    except ValueError as error:  # of which a UnicodeDecodeError is one
        raise StorageError(f"{path}: {reason(error)}; the run is broken and was left alone") from error


def reason(error: OSError | ValueError) -> str:
    """Say why the operating system or a parser refused, in its own words."""
    if isinstance(error, UnicodeDecodeError):
        return "it is not UTF-8 text"
    return getattr(error, "strerror", None) or str(error)


def _kept(folder: Path) -> str:
    names = sorted(path.name for path in folder.glob("[!.]*")) if folder.is_dir() else []
    return f"kept whole in {folder}: {', '.join(names)}" if names else "nothing was written"
