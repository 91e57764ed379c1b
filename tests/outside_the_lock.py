"""Names every expression or function that CasADi builds or frees in a thread that does not hold the lock for it.

A program of its own, because what is built once is kept: it does some of ``TASKS`` and prints what it has seen.
"""

import sys
import traceback
from collections import Counter

import casadi
import numpy as np
from casadi import MX, SX, Callback, Function

import gaitopt as go
from gaitopt.building import BUILDING
from gaitopt.simulation import heyoka_code

FOUND: Counter[str] = Counter()
READING = ("GenMX_numel", "GenSX_numel", "GenMX_size", "GenSX_size", "GenericMatrixCommon")
COMPILED = casadi.casadi._casadi


def note(what):
    if BUILDING._is_owned():
        return
    stack = [frame for frame in traceback.extract_stack() if "/gaitopt/" in frame.filename]
    if stack:
        FOUND[f"{what} in {stack[-1].filename}:{stack[-1].lineno}"] += 1


def symbolic(value):
    if isinstance(value, dict):
        return symbolic([*value.values()])
    return any(map(symbolic, value)) if isinstance(value, list | tuple) else isinstance(value, SX | MX)


class Watched:
    """CasADi's compiled module, with a look at what its functions take and return."""

    def __getattr__(self, name):
        value = getattr(COMPILED, name)
        if not callable(value) or isinstance(value, type) or name.startswith(READING):
            return value
        makes = name in ("new_SX", "new_MX", "new_Function")

        def call(*arguments):
            result = value(*arguments)
            if makes or symbolic(arguments) or symbolic(result) or isinstance(result, Function):
                note(name)
            return result

        self.__dict__[name] = call
        return call


def freed(proxy):
    if proxy.thisown and not isinstance(proxy, Callback):  # others are freed by ``building.Freed``, or hold nothing
        note(f"free {type(proxy).__name__}")


def solved(name):
    gait = go.solve(go.load_problem(name), progress=False)
    assert gait.converged
    return gait


def verified(name):
    gait = solved(name)
    states = gait.state[gait.system.section(go.Mode.SLIP_FORWARD).indices] * np.linspace(1, 1.001, 20)[:, None]
    assert go.verify(gait).passed
    for engine in ("scipy", "heyoka"):
        go.simulate(gait, steps=3, engine=engine)
        go.return_map(gait, states, engine=engine)


TASKS = {
    "verify": lambda: verified("compass-passive-a"),
    "run": lambda: verified("slip-run"),
    "kneed": lambda: verified("kneed-passive"),
    "pd": lambda: verified("compass-pd-impact-slip"),
    "continue": lambda: list(
        go.continuation(solved("compass-passive-a"), "friction", to=0.1, max_points=3, progress=False)
    ),
    "prove": lambda: go.prove(solved("rimless-wheel-stick"), progress=False),
    "design": lambda: solved("compass-torque-stable-slip"),
    "design-friction": lambda: solved("compass-minimum-friction"),
    "design-pd": lambda: solved("compass-pd-designed"),
    "picture": lambda: (gait := solved("hopper"), go.plot(gait), go.report(gait)),
    "search": lambda: go.find(go.load_problem("compass-passive-a"), starts=2, progress=False),
    "explain": lambda: go.explain(go.load_problem("compass-passive-a").replace({"friction": 0.05})),
}


if __name__ == "__main__":
    casadi.casadi._casadi = Watched()
    for kind in (SX, MX, Function):
        kind.__del__ = freed
    heyoka_code.OPTIMISATION = 0  # compiles in a sixth of the time
    for task in sys.argv[1:]:
        TASKS[task]()
    sys.stdout.writelines(f"{count} times {what}\n" for what, count in FOUND.items())
