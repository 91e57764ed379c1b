"""State of one thread: caches whose values are written to while they work.

Problems, systems, compiled functions and gaits are shared by all threads, because nothing writes to them. Buffers and
integrators are written to by every use, so that every thread has its own.
"""

import threading
from collections.abc import Callable
from functools import lru_cache, wraps
from typing import ParamSpec, TypeVar

Arguments = ParamSpec("Arguments")
Value = TypeVar("Value")


def per_thread(maxsize: int) -> Callable[[Callable[Arguments, Value]], Callable[Arguments, Value]]:
    """Decorator like ``lru_cache``, with one cache per thread, which is dropped when the thread ends.

    Parameters
    ----------
    maxsize : number of values that each thread keeps.
    """

    def decorated(build: Callable[Arguments, Value]) -> Callable[Arguments, Value]:
        class Cache(threading.local):
            def __init__(self) -> None:
                self.get: Callable[Arguments, Value] = lru_cache(maxsize=maxsize)(build)  # type: ignore[assignment]

        cache = Cache()

        @wraps(build)
        def of_this_thread(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Value:
            return cache.get(*args, **kwargs)

        return of_this_thread

    return decorated
