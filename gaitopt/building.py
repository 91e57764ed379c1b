"""The lock under which CasADi builds expressions and functions, and frees them.

CasADi releases Python's lock in every call, counts references atomically, and evaluates functions in several threads.
Building is not thread-safe in two places of CasADi 3.8. First, constants such as 0.3 live in a table shared by all
expressions: one thread may free a constant while another takes it from the table. Second, the construction of a
function marks its arguments, which may be symbols that other functions share. Therefore only one thread at a time
builds, and CasADi objects are freed under the same lock, whichever thread drops them. Evaluating a function needs no
lock.
"""

import functools
import threading
import traceback
import weakref
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from typing import Any, ParamSpec, TypeVar, cast

from casadi import MX, SX, Callback, Function, FunctionBuffer

Arguments = ParamSpec("Arguments")
Value = TypeVar("Value")

BUILDING = threading.RLock()
"""The lock that a thread holds while CasADi builds or frees expressions and functions. A thread that holds it must not
wait for another lock of the package: other locks are taken first."""

LATEST = 4
"""Number of values of ``built_once`` that are kept for threads that waited while another thread built them."""


class Freed:
    """CasADi objects that are freed under locks, whichever thread drops them last.

    Parameters
    ----------
    locks : the locks that are held while objects are freed, in the order in which they are taken.
    """

    def __init__(self, *locks: Any) -> None:
        self._locks = locks
        self._dropped: deque[tuple[Callable[[Any], None], Any]] = deque()

    def watch(self, value: Value) -> Value:
        """Return an object after arranging that it, or every object in a container or dataclass, is freed like this."""
        if isinstance(value, SX | MX | Function | FunctionBuffer) and not isinstance(value, Callback):
            proxy = cast(Any, value)
            if proxy.thisown:  # otherwise it is watched already
                proxy.thisown = False
                weakref.finalize(value, self._drop, type(proxy).__swig_destroy__, proxy.this).atexit = False
        elif isinstance(value, Mapping):
            self.watch(tuple(value.values()))
        elif isinstance(value, tuple | list):
            for entry in value:
                self.watch(entry)
        elif is_dataclass(value) and not isinstance(value, type):
            for field in fields(value):
                self.watch(getattr(value, field.name))
        return value

    def _drop(self, destroy: Callable[[Any], None], this: Any) -> None:
        self._dropped.append((destroy, this))
        self.free()

    def free(self) -> None:
        """Free dropped objects, unless another thread holds a lock: finalizers run at any time and must not wait."""
        if not self._dropped:
            return
        acquired = [lock for lock in self._locks if lock.acquire(blocking=False)]
        try:
            while len(acquired) == len(self._locks) and self._dropped:
                destroy, this = self._dropped.popleft()
                destroy(this)
        finally:
            for lock in acquired:
                lock.release()


BUILT = Freed(BUILDING)
"""The CasADi objects that are freed under ``BUILDING``."""


def building(build: Callable[Arguments, Value]) -> Callable[Arguments, Value]:
    """Decorator of functions that build expressions or functions of CasADi: only one thread at a time runs them."""

    @functools.wraps(build)
    def locked(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Value:
        with BUILDING:
            BUILT.free()
            try:
                return BUILT.watch(build(*args, **kwargs))
            except BaseException as error:
                if threading.active_count() > 1:  # with a single thread, a debugger may still see the variables
                    _clear_frames(error)
                raise

    return locked


def _clear_frames(error: BaseException | None) -> None:
    """Free the expressions in the frames of an error, which another thread may drop later."""
    while error is not None:
        traceback.clear_frames(error.__traceback__)
        error = error.__cause__ or error.__context__


def built_once(maxsize: int) -> Callable[[Callable[Arguments, Value]], Callable[Arguments, Value]]:
    """Decorator like ``lru_cache`` for functions that build with CasADi: one thread builds a value for all threads.

    A value that is in the cache is returned without the lock, even while another thread builds.

    Parameters
    ----------
    maxsize : number of values in the cache.
    """

    def decorated(build: Callable[Arguments, Value]) -> Callable[Arguments, Value]:
        latest = functools.lru_cache(maxsize=LATEST)(build)  # for threads that waited for the same value
        cached = functools.lru_cache(maxsize=maxsize)(functools.wraps(build)(building(latest)))
        forget = cached.cache_clear

        def cache_clear() -> None:
            latest.cache_clear()
            forget()

        cached.cache_clear = cache_clear  # type: ignore[method-assign]
        return cast(Callable[Arguments, Value], cached)

    return decorated
