"""Which integrator a simulation runs on: scipy, which is always there, or heyoka, which is optional and compiled."""

from enum import StrEnum
from importlib.util import find_spec

from gaitopt.errors import UnknownNameError
from gaitopt.model.dynamics import Dynamics
from gaitopt.simulation.scipy_stepper import ScipyStepper
from gaitopt.simulation.stepper import Stepper

MANY_STEPS = 1000
"""Steps from which ``auto`` compiles: on scipy they take as long as the compiler does the first time."""

INSTALL = "pip install 'gaitopt[fast]' on Linux, conda install heyoka.py elsewhere"


class Engine(StrEnum):
    """An integrator of arcs; ``auto`` is heyoka where it is installed and worth its compilation, else scipy."""

    AUTO = "auto"
    SCIPY = "scipy"
    HEYOKA = "heyoka"


def is_installed() -> bool:
    """Whether heyoka is there."""
    return find_spec("heyoka") is not None


def choose_engine(engine: str, *, steps: int = 1) -> Engine:
    """The engine that ``engine`` means for so many walking steps.

    Raises
    ------
    UnknownNameError
        If there is no such engine, or it is not installed.
    """
    if engine not in tuple(Engine):
        raise UnknownNameError(f"no engine is called {engine!r}; use {', '.join(Engine)}")
    installed = is_installed()
    if engine == Engine.HEYOKA and not installed:
        raise UnknownNameError(f"the engine heyoka is not installed: {INSTALL}; or use the engine scipy")
    if engine == Engine.AUTO:
        return Engine.HEYOKA if installed and steps >= MANY_STEPS else Engine.SCIPY
    return Engine(engine)


def make_stepper(dynamics: Dynamics, engine: str = Engine.AUTO, *, steps: int = 1) -> Stepper:
    """The stepper of an engine for a walker under its control law.

    Raises
    ------
    UnknownNameError
        As ``choose_engine``.
    """
    if choose_engine(engine, steps=steps) is Engine.SCIPY:
        return ScipyStepper(dynamics)
    from gaitopt.simulation.heyoka_stepper import HeyokaStepper  # optional, and 0.2 s to import

    return HeyokaStepper(dynamics)
