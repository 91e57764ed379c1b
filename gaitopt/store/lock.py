"""One writer at a time: a lock that the system itself lets go of when its holder dies."""

import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from gaitopt.errors import StorageError
from gaitopt.store.files import reason


@contextmanager
def only_writer(path: Path) -> Iterator[None]:
    """Hold a file for writing; where the system knows no such locks (Windows), this does nothing.

    Raises
    ------
    StorageError
        If another process holds it.
    """
    if os.name != "posix":
        yield
        return
    import fcntl

    with ExitStack() as held:
        try:
            file = held.enter_context(path.with_name(f".{path.name}.lock").open("w"))
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            remedy = "wait for it, or name another folder with -o"
            raise StorageError(f"another process is writing {path}; {remedy}") from error
        except OSError as error:
            raise StorageError(f"cannot lock {path}: {reason(error)}") from error
        yield
