"""gaitopt: periodic gaits of legged walkers that slip, after Gamus & Or (2013).

The public names are those of ``__init__.pyi``, imported on first use, so that ``import gaitopt`` costs next to nothing.
Besides its packages, which ``CONTRIBUTING.md`` lists:

systems      from a problem to its hybrid system and its gait
requests     what each verb takes: one frozen request per verb
integration  the Runge-Kutta method of order 8
display      methods by which results show themselves
errors       the errors that gaitopt raises on purpose, with exit codes
callbacks    the types of functions that long computations call
arrays       types of arrays, results that cannot be written to
building     the lock under which CasADi builds and frees
threads      state of one thread
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
