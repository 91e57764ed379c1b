"""Caches with separate values for every thread, cached properties without a lock, and arguments that no cache compares.

All threads share problems, systems, compiled functions and gaits, because nothing writes to them. Every use writes to
buffers and integrators, so that every thread has its own.
"""

import functools
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Concatenate, Generic, ParamSpec, Self, TypeVar, cast, overload

Arguments = ParamSpec("Arguments")
Value = TypeVar("Value")
Property = TypeVar("Property", covariant=True)
Owner = TypeVar("Owner")


class cached_property(functools.cached_property[Property]):  # noqa: TID251
    """A cached property that holds no lock while it computes, like that of Python 3.12.

    The one of Python 3.11 holds a lock for all instances of the class, which can lead to a deadlock: one thread
    computes the property and waits for another lock, whose holder waits for the property. Here two threads may compute
    the value at the same time; the first value is kept.
    """

    @overload
    def __get__(self, instance: None, owner: type[Any] | None = None) -> Self: ...
    @overload
    def __get__(self, instance: object, owner: type[Any] | None = None) -> Property: ...
    def __get__(self, instance: object | None, owner: type[Any] | None = None) -> Self | Property:
        """The value, computed on first use; later uses find it in the instance."""
        if instance is None:
            return self
        return cast(Property, vars(instance).setdefault(str(self.attrname), self.func(instance)))


def cached_method(
    method: Callable[Concatenate[Owner, Arguments], Value],
) -> Callable[Concatenate[Owner, Arguments], Value]:
    """Decorator of a method whose results stay in its object by the arguments; no lock, as in ``cached_property``."""
    key = f"_results_of_{method.__name__}"

    @functools.wraps(method)
    def cached(owner: Owner, /, *args: Arguments.args, **kwargs: Arguments.kwargs) -> Value:
        results: dict[Any, Value] = vars(owner).setdefault(key, {})
        given = (*args, *sorted(kwargs.items())) if kwargs else args
        if given not in results:
            results.setdefault(given, method(owner, *args, **kwargs))
        return results[given]

    return cached


@dataclass(frozen=True, slots=True)
class Uncompared(Generic[Value]):
    """A value that does not count in comparisons of the objects that contain it.

    As an argument of a cached function it does not select the cached result: the first one that is given computes it.
    """

    value: Value = field(compare=False)


def per_thread(maxsize: int) -> Callable[[Callable[Arguments, Value]], Callable[Arguments, Value]]:
    """Decorator like ``lru_cache``, with one cache per thread, which is dropped when the thread ends.

    Parameters
    ----------
    maxsize : number of values that each thread keeps.
    """

    def decorated(build: Callable[Arguments, Value]) -> Callable[Arguments, Value]:
        class Cache(threading.local):
            def __init__(self) -> None:
                self.get = cast(Callable[Arguments, Value], functools.lru_cache(maxsize=maxsize)(build))

        cache = Cache()

        @functools.wraps(build)
        def of_this_thread(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Value:
            return cache.get(*args, **kwargs)

        return of_this_thread

    return decorated
