"""Files that appear whole or not at all: written beside their place, synced, then renamed into it."""

import os
from contextlib import suppress
from pathlib import Path

from gaitopt.errors import StorageError

TEMPORARY_SUFFIX = ".tmp"


def write_whole(path: Path, content: str | bytes) -> None:
    """Write ``content`` to ``path``; whoever looks finds the old file or the new one, even after a crash.

    Raises
    ------
    StorageError
        If the disk is full or the folder cannot be written; what was there before is unchanged.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}{TEMPORARY_SUFFIX}")
    try:
        with temporary.open("wb") as file:
            file.write(content.encode() if isinstance(content, str) else content)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
        sync_folder(path.parent)
    except OSError as error:
        raise StorageError(f"cannot write {path}: {reason(error)}; {_kept(path.parent)}") from error
    finally:
        with suppress(OSError):  # a disk that refused the file may refuse this too
            temporary.unlink(missing_ok=True)


def make_folder(folder: Path) -> None:
    """Make ``folder`` and its parents, durably; one that exists is left as it is.

    Raises
    ------
    StorageError
        If it cannot be made.
    """
    if folder.is_dir():
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
        sync_folder(folder.parent)
    except OSError as error:
        raise StorageError(f"cannot make the folder {folder}: {reason(error)}; nothing was written") from error


def read_text(path: Path) -> str:
    """Read a file verbatim, line ends included.

    Raises
    ------
    StorageError
        If it is missing, unreadable or not text.
    """
    try:
        return path.read_bytes().decode("utf-8")
    except FileNotFoundError as error:
        raise StorageError(f"{path} is missing; the run is broken and was left alone") from error
    except (OSError, UnicodeDecodeError) as error:
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


def reason(error: OSError | UnicodeDecodeError) -> str:
    """Say why the operating system refused, in its own words."""
    if isinstance(error, UnicodeDecodeError):
        return "it is not UTF-8 text"
    return error.strerror or str(error)


def _kept(folder: Path) -> str:
    names = sorted(path.name for path in folder.glob("[!.]*")) if folder.is_dir() else []
    return f"kept whole in {folder}: {', '.join(names)}" if names else "nothing was written"
