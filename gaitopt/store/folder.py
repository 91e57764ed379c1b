"""Who may write into a run folder: one process at a time, for the problem that the folder belongs to."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from gaitopt.errors import StorageError
from gaitopt.problem import Problem
from gaitopt.store.files import TEMPORARY_SUFFIX, clear_leftovers, entries, make_folder, reason
from gaitopt.store.lines import LineWriter, read_lines
from gaitopt.store.lock import LOCK_FILE, WRITER_FILE, only_writer
from gaitopt.store.manifest import read_manifest, seal


def check_folder(folder: Path, problem: Problem) -> None:
    """Refuse a folder that may not be written for this problem, before anything is computed or written.

    Raises
    ------
    StorageError
        If it holds another problem's run, anything that is not a run, a broken run, or a newer one.
    """
    names = [path.name for path in entries(folder)]
    left = [n for n in names if n.startswith(".") and n.endswith(TEMPORARY_SUFFIX)]  # by a writer that was killed
    if not set(names) - {LOCK_FILE, WRITER_FILE, *left}:
        check_writable(folder)
        return
    manifest = read_manifest(folder)
    if manifest.hash != problem.digest:
        raise StorageError(
            f"{folder} holds another problem ({manifest.problem}, hash {manifest.hash[:8]}, not {problem.name}, "
            f"hash {problem.digest[:8]}); it was left alone: delete it, or name another folder"
        ).about("output")


def check_writable(path: Path) -> None:
    """Refuse a file or folder that cannot be made, before anything is computed for it.

    Raises
    ------
    StorageError
        If the nearest folder above it that exists is none, or may not be written.
    """
    try:
        place = next(place for place in (path.absolute(), *path.absolute().parents) if place.exists())
    except OSError as error:
        raise StorageError(f"cannot write {path}: {reason(error)}; name another place").about("output") from error
    folder = place.parent if place == path.absolute() and place.is_file() else place
    if not folder.is_dir() or not os.access(folder, os.W_OK | os.X_OK):
        raise StorageError(f"cannot write {path}: {folder} is no folder that you may write; name another").about(
            "output"
        )


@contextmanager
def writing(folder: Path, problem: Problem) -> Iterator[None]:
    """Hold the run folder of a problem for writing, made if it is not there; may be nested."""
    check_folder(folder, problem)
    make_folder(folder)
    with only_writer(folder):
        check_folder(folder, problem)  # another process may have been first
        yield


@contextmanager
def growing(folder: Path, name: str) -> Iterator[LineWriter]:
    """Append to a file of records of a run folder; how far it got is entered into the manifest at the end."""
    for _ in stored_lines(folder, name):
        pass  # checks what is there against the manifest
    complete = False
    try:
        with LineWriter(folder / name) as lines:
            yield lines
        complete = True
    except (KeyboardInterrupt, GeneratorExit):
        complete = True
        raise
    finally:
        if complete:
            seal(folder, name)


@contextmanager
def adding(folder: Path, place: Path) -> Iterator[list[Path]]:
    """Add figures or pages to a folder; those in a run folder that are collected in the list have checksums afterwards.

    Parameters
    ----------
    folder : the run folder that they are about.
    place : where they go, made if it is not there: in the run folder, or elsewhere.
    """
    added: list[Path] = []
    if not place.resolve().is_relative_to(folder.resolve()):
        make_folder(place)
        clear_leftovers(place)
        yield added
        return
    with only_writer(folder):
        make_folder(place)
        yield added
        seal(folder, *(path.resolve().relative_to(folder.resolve()).as_posix() for path in added))


def stored_lines(folder: Path, name: str) -> Iterator[dict[str, Any]]:
    """The records of a file of a run folder in order; none if it is not there."""
    known = read_manifest(folder).files.get(name)
    if known is not None or (folder / name).exists():
        yield from read_lines(folder / name, known)
