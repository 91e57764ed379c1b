"""Named gaits from the middle of a stride to the middle of the next one, or with a clock that no landing resets."""

import json
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from math import pi
from types import SimpleNamespace
from typing import Annotated, Any

from casadi import SX, sin
from named import named, solved
from own_laws import MidCompass
from pydantic import Field

from gaitopt import Control, Gait, Instant, Mechanism, Problem, Walker, parse_problem
from gaitopt.gait import curves
from gaitopt.model.clocked import Period
from gaitopt.model.units import Finite
from gaitopt.model.walkers.heel_toe import HeelToe
from gaitopt.model.walkers.kneed import KneedWalker
from gaitopt.model.walkers.push_off import PushOffCompass
from gaitopt.model.walkers.rimless_wheel import RimlessWheel
from gaitopt.problem.statement import problem_data

SLIP = {"mode": "slip_forward", "impact": "stick"}


def with_section(
    base: type[Walker],
    name: str,
    at: float,
    touchdown: Callable[[SX], SX] | None = None,
    by_x: float = 0.0,
    factor: float = 1.0,
) -> type[Walker]:
    """A walker with a margin that falls to zero where its first coordinate is ``at``, and another touchdown.

    The margin also vanishes where this coordinate is zero or ``factor``, if that is not one. It falls by ``by_x`` per
    metre along the ground.
    """

    class Sectioned(base):
        model = name
        sections = ("middle",)

        @classmethod
        def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
            plain, (first, *_) = super().mechanism(q, p), cls.shape
            guard = plain.touchdown if touchdown is None else plain.touchdown * touchdown(vars(q)[first])
            angle = vars(q)[first]
            factors = 1.0 if factor == 1.0 else angle * (angle - factor)
            margins = {"middle": lambda dq: (at - angle - by_x * q.x) * factors}
            return replace(plain, sections=margins, touchdown=guard)

    return Sectioned


PLACES = {"compass-push-off": 0.05, "kneed-passive": -0.2, "heel-toe": 0.1, "heel-toe-slip": 0.1}
"""First coordinate at which the stride begins, if it is not zero; the walkers on toes roll over them there."""
MID_HEEL_TOE = with_section(HeelToe, "mid_heel_toe", PLACES["heel-toe"])
WALKERS = {
    "rimless-wheel-slip": with_section(RimlessWheel, "mid_wheel", 0.0),
    "compass-passive-a": MidCompass,
    "compass-push-off": with_section(PushOffCompass, "mid_push_off", PLACES["compass-push-off"]),
    "kneed-passive": with_section(KneedWalker, "mid_kneed", PLACES["kneed-passive"]),
    "heel-toe": MID_HEEL_TOE,
    "heel-toe-slip": MID_HEEL_TOE,
}


class HipClock(Control):
    """A spring in the hip whose rest length oscillates, whatever the feet do."""

    type = "hip_clock"
    restarts = False

    cycle: Period
    stiffness: Annotated[Finite, Field(description="torque per angle [N m/rad]")] = 0.3
    size: Annotated[Finite, Field(description="amplitude [rad]")] = 0.3
    shift: Annotated[Finite, Field(description="phase at the start of the cycle [rad]")] = 0.0

    @property
    def period(self) -> float:
        return self.cycle

    def torques(self, now: Instant) -> dict[str, SX]:
        """The torque that pulls the joint towards the sine."""
        angle = now.robot.mechanism.motors[now.robot.walker.actuators.index("hip")]
        return {"hip": now.p.stiffness * (now.p.size * sin(2 * pi * now.t / self.cycle + now.p.shift) - angle)}


def restated(name: str, walker: type[Walker] | None = None, **changes: Any) -> Problem:
    """A named problem with other keys, of another walker."""
    data = problem_data(named(name).problem)
    if walker is not None:
        data["walker"]["model"] = walker.model
    return parse_problem(json.dumps(data | changes), walkers=[] if walker is None else [walker], controls=[HipClock])


def mid_stride(name: str, at: float | None = None, walker: type[Walker] | None = None) -> Problem:
    """A named gait from the middle of a stride, or from ``at``, to the next one."""
    plain, walker, at = named(name), walker or WALKERS[name], PLACES.get(name, 0.0) if at is None else at
    k = next(k for k, arc in enumerate(plain.arcs) if arc.states[0, 0] < at < arc.states[-1, 0])
    states = plain.arcs[k].states
    (here,) = curves.evaluate(curves.coefficients(states), curves.roots(states[:, 0] - at))
    impact = plain.cycle.impact
    phases = [mode.data if isinstance(mode.data, dict) else {"mode": mode.data} for mode in plain.cycle.phases]
    struck = str(impact.contact)
    if impact.is_named:
        struck = {n: "leaves" if word == "off" else word for n, word in impact.contacts.items() if "swing" not in n}
        struck["feet"] = "swapped"
    gait = {
        "section": {"margin": "middle"},
        "phases": [*phases[k:], {**phases[0], "impact": struck}, *phases[1 : k + 1]],
        "guess": {"state": {n: float(v) for n, v in zip(plain.system.state_names, here, strict=True) if n != "x"}},
    }
    return restated(name, walker, gait=gait)


@cache
def mid_stride_gait(name: str, at: float | None = None, walker: type[Walker] | None = None) -> Gait:
    return solved(mid_stride(name, at, walker))


def clocked(**control: float) -> dict[str, Any]:
    """The control of a compass whose hip follows a clock with the period of gait A."""
    return {"type": "hip_clock", "cycle": named("compass-passive-a").scalar("period"), **control}


@cache
def entrained() -> Gait:
    """Gait A with a hip that follows a clock, from the middle of a stride."""
    state = {"theta1": -0.0751, "theta2": -0.1479, "dtheta1": 0.3936, "dtheta2": 0.3549}
    gait = {"section": "clock", "phases": ["stick", "slip_backward", SLIP, "stick"], "guess": {"state": state}}
    return solved(restated("compass-passive-a", control=clocked(), gait=gait))
