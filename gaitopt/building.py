"""The lock under which CasADi builds expressions and functions, and frees them.

CasADi releases Python's lock in every call, counts references atomically, and evaluates functions in several threads.
Building is not safe in two places of CasADi 3.8. A constant lives in a table as long as an expression uses it: one
thread may free it in the moment in which another takes it from the table (0.3, say, of expressions that share nothing
else). And the construction of a function marks its arguments, which other functions of the same symbols share. So one
thread at a time builds, and what is built is freed under the same lock, whichever thread drops it. Evaluating a
function needs no lock.
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
"""Held while CasADi builds or frees expressions and functions. Whoever holds it waits for no other lock of the package:
locks that are needed as well are taken first."""

LATEST = 4
"""Values of ``built_once`` that are kept for threads that have waited for the one that built them."""


class Freed:
    """CasADi objects that are freed under locks, whichever thread drops them last.

    Parameters
    ----------
    locks : to be held meanwhile, in this order.
    """

    def __init__(self, *locks: Any) -> None:
        self._locks = locks
        self._dropped: deque[tuple[Callable[[Any], None], Any]] = deque()

    def watch(self, value: Value) -> Value:
        """Free an object so, or all in a tuple, list, mapping or dataclass, and return it."""
        if isinstance(value, SX | MX | Function | FunctionBuffer) and not isinstance(value, Callback):
            proxy = cast(Any, value)
            if proxy.thisown:  # else it is watched already
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
        """Free what was dropped, unless another thread holds a lock: a finalizer runs anywhere, and must not wait."""
        if not self._dropped:
            return
        held = [lock for lock in self._locks if lock.acquire(blocking=False)]
        try:
            while len(held) == len(self._locks) and self._dropped:
                destroy, this = self._dropped.popleft()
                destroy(this)
        finally:
            for lock in held:
                lock.release()


BUILT = Freed(BUILDING)
"""What is freed under ``BUILDING``."""


def building(build: Callable[Arguments, Value]) -> Callable[Arguments, Value]:
    """Decorator of what builds expressions or functions of CasADi: one thread at a time."""

    @functools.wraps(build)
    def locked(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Value:
        with BUILDING:
            BUILT.free()
            try:
                return BUILT.watch(build(*args, **kwargs))
            except BaseException as error:
                if threading.active_count() > 1:  # a debugger of one thread may see the variables
                    _clear_frames(error)
                raise

    return locked


def _clear_frames(error: BaseException | None) -> None:
    """Free the expressions in the frames of an error, which another thread may drop later."""
    while error is not None:
        traceback.clear_frames(error.__traceback__)
        error = error.__cause__ or error.__context__


def built_once(maxsize: int) -> Callable[[Callable[Arguments, Value]], Callable[Arguments, Value]]:
    """Decorator like ``lru_cache`` of what builds with CasADi: one thread at a time, and once for all threads.

    What is built can be had without the lock, while another thread builds.

    Parameters
    ----------
    maxsize : number of values that are kept.
    """

    def decorated(build: Callable[Arguments, Value]) -> Callable[Arguments, Value]:
        latest = functools.lru_cache(maxsize=LATEST)(build)  # for threads that have waited for the same value
        kept = functools.lru_cache(maxsize=maxsize)(functools.wraps(build)(building(latest)))
        forget = kept.cache_clear

        def cache_clear() -> None:
            latest.cache_clear()
            forget()

        kept.cache_clear = cache_clear  # type: ignore[method-assign]
        return cast(Callable[Arguments, Value], kept)

    return decorated
