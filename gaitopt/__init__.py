"""gaitopt: periodic gaits of legged walkers that slip, after Gamus & Or (2013).

The public names are imported on first use, so that ``import gaitopt`` costs next to nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gaitopt.errors import GaitoptError
    from gaitopt.families import continuation
    from gaitopt.gait import Branch, Gait, Status, Trajectory
    from gaitopt.mechanics.consistency import check_walker
    from gaitopt.mechanics.modes import Cycle, ImpactLaw, Mode, ModeSequence
    from gaitopt.mechanics.walker import Body, Mechanism, Walker
    from gaitopt.problem import Problem, load_problem
    from gaitopt.proof import prove
    from gaitopt.search.explain import explain
    from gaitopt.search.find import find
    from gaitopt.search.solve import solve
    from gaitopt.study import return_map, simulate, verify

__version__ = "0.1.0"

__all__ = [
    "Body",
    "Branch",
    "Cycle",
    "Gait",
    "GaitoptError",
    "ImpactLaw",
    "Mechanism",
    "Mode",
    "ModeSequence",
    "Problem",
    "Status",
    "Trajectory",
    "Walker",
    "check_walker",
    "continuation",
    "explain",
    "find",
    "load_problem",
    "prove",
    "return_map",
    "simulate",
    "solve",
    "verify",
]

_HOME = {
    "Body": "gaitopt.mechanics.walker",
    "Branch": "gaitopt.gait",
    "Cycle": "gaitopt.mechanics.modes",
    "Gait": "gaitopt.gait",
    "GaitoptError": "gaitopt.errors",
    "ImpactLaw": "gaitopt.mechanics.modes",
    "Mechanism": "gaitopt.mechanics.walker",
    "Mode": "gaitopt.mechanics.modes",
    "ModeSequence": "gaitopt.mechanics.modes",
    "Problem": "gaitopt.problem",
    "Status": "gaitopt.gait",
    "Trajectory": "gaitopt.gait",
    "Walker": "gaitopt.mechanics.walker",
    "check_walker": "gaitopt.mechanics.consistency",
    "continuation": "gaitopt.families",
    "explain": "gaitopt.search.explain",
    "find": "gaitopt.search.find",
    "load_problem": "gaitopt.problem",
    "prove": "gaitopt.proof",
    "return_map": "gaitopt.study",
    "simulate": "gaitopt.study",
    "solve": "gaitopt.search.solve",
    "verify": "gaitopt.study",
}


def __getattr__(name: str) -> Any:
    """Import a public name from the layer that it lives in (PEP 562)."""
    if name not in _HOME:
        raise AttributeError(f"module 'gaitopt' has no attribute {name!r}; public names: {', '.join(__all__)}")
    value = getattr(import_module(_HOME[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
