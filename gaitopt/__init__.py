"""gaitopt: periodic gaits of legged walkers that slip, after Gamus & Or (2013).

The public names are those of ``__init__.pyi``. They are imported on first use, so that ``import gaitopt`` is quick. The
packages are listed in ``CONTRIBUTING.md``. Besides them there are the modules

- ``systems``: from a problem to its hybrid system and its gait
- ``requests``: the arguments of every verb, as one frozen request per verb
- ``integration``: the Runge-Kutta method of order 8
- ``display``: the methods ``plot``, ``animate``, ``report`` and ``save`` of results
- ``errors``: the errors that gaitopt raises on purpose, with exit codes
- ``callbacks``: the types of functions that long computations call
- ``arrays``: types of arrays, and results with read-only arrays
- ``building``: the lock under which CasADi builds and frees
- ``threads``: caches and properties for several threads
"""

import ast
from importlib import import_module
from pathlib import Path

__version__ = "0.2.0"

_MODULES = {
    alias.name: statement.module
    for statement in ast.parse(Path(__file__).with_name("__init__.pyi").read_text(encoding="utf-8")).body
    if isinstance(statement, ast.ImportFrom)
    for alias in statement.names
}

__all__ = sorted(_MODULES)


def __getattr__(name):
    """Import a public name from the layer that it lives in (PEP 562)."""
    if name not in _MODULES:
        raise AttributeError(f"module 'gaitopt' has no attribute {name!r}; public names: {', '.join(__all__)}")
    globals()[name] = value = getattr(import_module(_MODULES[name]), name)
    return value


def __dir__():
    return [*__all__, "__version__"]
