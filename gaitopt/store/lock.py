"""One writer at a time: a lock that the system itself lets go of when its holder dies."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
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

    lock = path.with_name(f".{path.name}.lock")
    try:
        with lock.open("w") as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            yield
    except BlockingIOError as error:
        raise StorageError(f"another process is writing {path}; wait for it, or name another folder with -o") from error
    except OSError as error:
        raise StorageError(f"cannot lock {path}: {reason(error)}") from error
