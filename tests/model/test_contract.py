"""The contract between control laws and walkers: a fault of a law is one sentence that names the place."""

from typing import Annotated, Any, ClassVar

import numpy as np
import pytest
from casadi import SX, floor, fmax, if_else, sign, sin, sqrt, vertcat
from named import named
from oracles import CASES, numbers
from pydantic import Field
from refusals import refusal

import gaitopt as go
from gaitopt import Control, Fixed, Instant, Mode
from gaitopt.errors import ProblemError
from gaitopt.model.clocked import Alternating
from gaitopt.model.contract import check_clock
from gaitopt.model.system import HybridSystem
from gaitopt.model.units import Angle, NonNegative, Within
from gaitopt.model.walkers.compass_biped import CompassBiped

STATE = np.array([0.1, -0.2, 0.0, 0.7, -0.4, 0.3])


def stated(law: type[Control], control: str | None = None) -> go.Problem:
    source = go.load_problem("compass-passive-a")
    lines = source.text.splitlines()
    kept = [line for line in lines if not line.startswith("control")]
    return go.parse_problem("\n".join([*kept, f"control: {control or f'{{type: {law.type}}}'}"]), controls=[law])


class Regulator(Control):
    """A law that uses everything an instant offers."""

    type = "regulator"
    kp: NonNegative = 2.0
    angle: Angle = 0.1
    gains: dict[str, NonNegative] = {"slow": 1.0, "fast": 3.0}  # noqa: RUF012 - pydantic copies defaults
    sign: int = -1

    def torques(self, now: Instant) -> dict[str, SX]:
        slow = now.p.gains.slow * now.dq.theta1 + now.p.gains.fast * now.ds.theta2
        return {"hip": self.sign * now.p.kp * (now.s.theta1 - now.p.angle) - slow + now.t * now.dq.x}


def test_every_number_is_a_parameter_and_the_rest_is_structure() -> None:
    law = Regulator(angle="10 deg")
    assert law.parameters == {"kp": 2.0, "angle": np.radians(10), "gains.slow": 1.0, "gains.fast": 3.0}
    assert law.structure == Regulator(kp=7.0).structure
    assert law.structure != Regulator(sign=1).structure
    system = HybridSystem(CompassBiped, law)
    p = [*CASES["compass_biped"].p, *law.parameters.values()]
    (u,) = numbers(system.torques(Mode.SLIP_FORWARD)(0.5, STATE, p, []))
    expected = -2 * (0.1 - np.radians(10)) - 0.7 + 3 * 0.4 + 0.5 * 0.3
    np.testing.assert_allclose(u, [0, expected], rtol=1e-14)


def test_own_fields_are_the_symbols_of_the_parameters() -> None:
    class Own(Regulator):
        type = "own"

        def torques(self, now: Instant) -> dict[str, SX]:
            return {"ankle": self.kp * self.gains["fast"]}

    system = HybridSystem(CompassBiped, Own())
    (u,) = numbers(system.torques(Mode.STICK)(0, STATE, [*CASES["compass_biped"].p, 5.0, 0, 0, 7.0], []))
    assert list(u) == [35.0, 0.0]


@pytest.mark.parametrize("size", [1e-4, 1.0, 50.0])
def test_limits_saturate_smoothly(size: float) -> None:
    law = Regulator(limits={"hip": 1.5}, kp=size, gains={"slow": 0.0, "fast": 0.0}, angle=0.0)
    system = HybridSystem(CompassBiped, law)
    assert list(law.parameters)[-1] == "limits.hip"
    (u,) = numbers(system.torques(Mode.STICK)(0, STATE, [*CASES["compass_biped"].p, *law.parameters.values()], []))
    assert u[1] == pytest.approx(1.5 * np.tanh(-size * 0.1 / 1.5), rel=1e-13)
    assert abs(u[1]) < 1.5


def test_fixed_numbers_and_other_structure_are_values_among_the_parameters() -> None:
    class Timed(Regulator):
        type = "timed"
        delay: Annotated[float, go.Fixed] = 0.25
        order: tuple[float, ...] = (1.0, 2.0)
        weights: Annotated[dict[str, float], go.Fixed] = {"a": 3.0}  # noqa: RUF012

        def torques(self, now: Instant) -> dict[str, SX]:
            assert (now.p.delay, now.p.order, now.p.weights) == (0.25, (1.0, 2.0), {"a": 3.0})
            return {"hip": now.p.delay * now.p.kp}

    law = Timed()
    assert "delay" not in law.parameters
    assert law.structure != Timed(delay=0.5).structure
    system = HybridSystem(CompassBiped, law)
    (u,) = numbers(system.torques(Mode.STICK)(0, STATE, [*CASES["compass_biped"].p, *law.parameters.values()], []))
    assert list(u) == [0.0, 0.5]


class Stairs(Control):
    """Torques that change at a breakpoint."""

    type = "stairs"
    time: Annotated[float, Fixed] = 0.3
    step: float = 0.1

    @property
    def breakpoints(self) -> tuple[float, ...]:
        return (self.time,)

    def data(self, segment: int) -> Any:
        return np.array([float(segment)])

    def torques(self, now: Instant) -> dict[str, SX]:
        return {"hip": now.r[0] * now.p.step}


def test_a_jump_at_a_breakpoint_must_be_declared() -> None:
    with pytest.raises(ProblemError, match=r"torque of hip jumps from 0 to 0.1 N m at its breakpoint 0.3 s: make it"):
        stated(Stairs)

    class Declared(Stairs):
        type = "declared"
        jumps: ClassVar[bool] = True

    assert stated(Declared).control.parameters == {"step": 0.1}

    class Ramp(Stairs):
        type = "ramp"

        def torques(self, now: Instant) -> dict[str, SX]:
            return {"hip": now.r[0] * now.p.step * (now.t - 0.3)}

    assert stated(Ramp).control.breakpoints == (0.3,)


def raising(*_: Any) -> Any:
    raise ArithmeticError("of the law")


TORQUES = [
    (lambda now: None, "torques returns None, but must return a mapping from actuators to torques"),
    (lambda now: {"knee": 1.0}, "torques names 'knee', but compass_biped has the actuators ankle, hip"),
    (lambda now: {"hip": SX.sym("foreign")}, "torques['hip'] contains foreign, which is not a symbol"),
    (lambda now: {"hip": vertcat(now.t, now.t)}, "torques['hip'] has shape (2, 1), but must be one number"),
    (lambda now: {"hip": "much"}, "torques['hip'] is 'much', but must be one number"),
    (lambda now: {"hip": now.q.knee}, "torques raises AttributeError"),
    (lambda now: {"hip": sqrt(now.q.theta1 - 3)}, "the torque of hip is nan at the guess, but must be a number"),
    (lambda now: {"hip": 1.0 if now.t > 0 else 0.0}, "torques raises"),
]
CLOCKS = [
    ({"breakpoints": property(lambda self: (self.step,))}, "breakpoints depends on a parameter, which may vary"),
    ({"breakpoints": property(lambda self: (0.3, 0.2))}, "but must be increasing times above 0 [s]"),
    ({"breakpoints": property(lambda self: (0.0,))}, "but must be increasing times above 0 [s]"),
    ({"horizon": property(lambda self: 0.1)}, "horizon is 0.1, but must be a time after the breakpoints [s]"),
    ({"period": property(lambda self: -1.0)}, "period is -1.0, but must be a time above 0 [s], or None"),
    ({"data": lambda self, segment: np.zeros(segment)}, "0 or 1 numbers, but must have the same length in every"),
    ({"data": lambda self, segment: np.array([np.nan])}, "but must be a row of finite numbers"),
    ({"data": lambda self, segment: np.array([self.step])}, "data depends on a parameter"),
    ({"breakpoints": property(lambda self: tuple(np.linspace(0.1, 1, 10_000)))}, "Faulty: 10,000 breakpoints"),
]
METHODS = [
    ({"phase_variable": property(lambda self: "knee")}, "phase_variable is 'knee', but must be a phase variable"),
    ({"phase_variable": property(raising)}, "phase_variable raises ArithmeticError: of the law"),
    ({"unknowns": raising}, "unknowns must not be overridden: it follows from the fields of the class"),
    ({"targets": property(raising)}, "targets must not be overridden"),
    ({"record": property(raising)}, "record must not be overridden"),
    ({"unit": lambda self, key: 3}, "unit('step') is 3, but must be a text such as 'N m/rad'"),
    ({"unit": raising}, "unit raises ArithmeticError"),
    ({"faults": lambda self, walker: ["no"]}, "faults yields 'no', but must yield a path and a message, such as"),
    ({"faults": raising}, "faults raises ArithmeticError"),
    ({"section": classmethod(lambda cls, walker: 3)}, "section returns 3, but must return a pydantic class with"),
    ({"section": classmethod(raising)}, "section raises ArithmeticError"),
    ({"quantities": raising}, "quantities raises ArithmeticError"),
    ({"quantities": lambda self, now: [now.t]}, "but must return a mapping from names to expressions"),
    ({"quantities": lambda self, now: {"a": "b"}}, "quantities['a'] is 'b', but must be an expression of CasADi's"),
    ({"quantities": lambda self, now: {"a": SX.sym("s")}}, "quantities['a'] contains s, which is not a symbol"),
    ({"period": property(raising)}, "period raises ArithmeticError"),
    ({"horizon": property(lambda self: "late")}, "horizon is 'late', but must be a time after the breakpoints"),
    ({"__annotations__": {"more": Any}, "more": 1}, "the key more is of type Any, which does not say what problem"),
    ({"__annotations__": {"more": list[Any]}, "more": []}, "the key more is of type list[typing.Any], which does"),
    ({"__annotations__": {"more": bytes}, "more": b"\xff"}, "writing its keys as JSON raises Pydantic"),
    ({"__annotations__": {"limits": float}, "limits": 1.0}, "the key limits is that of every law"),
    ({"type": "pd"}, "controls: Faulty: type is 'pd', the name of a control law of gaitopt: choose another one"),
]  # fmt: skip
CLASSES = [
    ({"type": 3}, "type is 3, but must be a word"),
    ({"type": "x", "version": 2}, "version is 2, but must be a word, such as '1'"),
    ({"type": "x", "jumps": "no"}, "jumps is 'no', but must be True or False"),
    ({"type": "x", "restarts": 0}, "restarts is 0, but must be True or False"),
    ({"type": "x", "__annotations__": {"a__b": float}, "a__b": 1.0}, "the key a__b must have a name of ASCII"),
    ({"type": "x", "__annotations__": {"k": Annotated[float, Field(alias="kk")]}, "k": 1.0}, "the key k has an alias"),
    (
        {"type": "x", "__annotations__": {"k": Annotated[float, Within(unit="furlong")]}, "k": 1.0},
        "the key k has a range in 'furlong', which is not a natural unit",
    ),
]
FAULTS = [
    *((Stairs, {"torques": lambda self, now, result=result: result(now)}, words) for result, words in TORQUES),
    *((Stairs, attributes, words) for attributes, words in (*CLOCKS, *METHODS)),
    *((Regulator, attributes, words) for attributes, words in CLASSES),
]


@pytest.mark.parametrize(("base", "attributes", "words"), FAULTS)
def test_a_fault_of_a_law_is_one_sentence_that_names_law_and_place(base, attributes, words):
    law = type("Faulty", (base,), {"type": "faulty", "jumps": True, "__module__": __name__, **attributes})
    told = refusal(stated, law, "{type: none}" if base is Regulator else None)
    assert words in told
    assert "Faulty" in told


def test_a_kink_in_the_torques_is_a_remark_that_names_it() -> None:
    class Kinked(Regulator):
        type = "kinked"

        def torques(self, now: Instant) -> dict[str, SX]:
            return {"hip": now.p.kp * fmax(now.q.theta1, 0) + fmax(now.p.kp, 1)}

    (remark,) = [remark for remark in stated(Kinked).remarks if "kink" in remark]
    assert "control: Kinked: torques uses fmax of time or state, whose kink gaitopt does not locate" in remark
    assert "sqrt(x**2 + width**2)" in remark
    assert not [remark for remark in stated(Regulator).remarks if "kink" in remark]


@pytest.mark.parametrize(
    ("torque", "words"),
    [
        (lambda now, omega: sin(omega * now.t), None),
        (lambda now, omega: sin(omega * now.t) + 0.1 * now.t, "applies 0 at its start and 0.12 at its end"),
        (lambda now, omega: now.q.gap * (1 + now.t), "at its start"),
    ],
)
@pytest.mark.parametrize("restarts", [True, False])
def test_torques_of_a_clock_that_ends_the_cycle_are_periodic(torque: Any, words: str | None, restarts: bool) -> None:
    class Wave(Control):
        type = "wave"
        restarts: ClassVar[bool] = True
        cycle: Annotated[float, Fixed] = 1.2

        @property
        def period(self) -> float:
            return self.cycle

        def torques(self, now: Instant) -> dict[str, SX]:
            return {now.robot.walker.actuators[0]: torque(now, 2 * np.pi / self.cycle)}

    Wave.restarts = restarts
    text = go.load_problem("crawler").text
    lines = text.splitlines()
    start = next(k for k, line in enumerate(lines) if line.startswith("control:"))
    end = next(k for k in range(start + 1, len(lines)) if not lines[k].startswith(" "))
    text = "\n".join([*lines[:start], "control: {type: wave}", *lines[end:]])
    if words is None:
        assert go.parse_problem(text, controls=[Wave]).control.period == 1.2
        return
    told = refusal(go.parse_problem, text, controls=[Wave])
    assert "control: Wave: period is 1.2 s, but the motor" in told
    assert words in told


@pytest.mark.parametrize(
    ("torque", "name"),
    [
        (lambda now: if_else(now.q.theta1 > 0, 1, -1), "a comparison"),
        (lambda now: -now.p.kp * sign(now.dq.theta1), "sign"),
        (lambda now: now.q.theta1 * floor(now.t), "floor"),
        (lambda now: fmax(now.q.theta1, 0) + if_else(now.p.kp > 1, 1, 2) * now.q.theta2, None),
    ],
)
def test_torques_that_jump_at_a_state_are_named(torque: Any, name: str | None) -> None:
    """A kink, and a choice by a parameter, are allowed."""

    class Bang(Regulator):
        type = "bang"

        def torques(self, now: Instant) -> dict[str, SX]:
            return {"hip": torque(now)}

    if name is None:
        assert stated(Bang).control.type == "bang"
        return
    words = f"control: Bang: torques uses {name} of time or state, which may jump where no mode ends: "
    assert words in refusal(stated, Bang)


class Running(Alternating):
    """Alternates with a clock that the impacts do not restart."""

    type = "running"
    restarts = False


def test_a_clock_that_does_not_restart_ends_the_cycle_of_a_walker_with_several_contacts() -> None:
    text = go.load_problem("crawler").text.replace("type: alternating", "type: running")
    gait, source = go.solve(go.parse_problem(text, controls=[Running])), named("crawler")
    assert gait.converged
    assert gait.multipliers == pytest.approx(source.multipliers, abs=1e-9)
    with pytest.raises(ProblemError, match="does not restart at impacts: end the cycle with its period"):
        go.parse_problem(text.replace("section: clock", "section: touchdown"), controls=[Running])
    with pytest.raises(ProblemError, match=r"control.type: the clock of running does not restart at impacts"):
        stated(Running, "{type: running, cycle: 1, first: {hip: 1}, second: {hip: -1}}")


def test_a_clock_that_does_not_restart_has_a_period() -> None:
    class Timeless(Running):
        type = "timeless"

        @property
        def period(self) -> float | None:
            return None

    text = go.load_problem("crawler").text.replace("type: alternating", "type: timeless")
    with pytest.raises(ProblemError, match="clock needs a control law with a period of its own"):
        go.parse_problem(text, controls=[Timeless])
    with pytest.raises(ProblemError, match=r"period is None, but must be a time above 0 \[s\], because restarts is Fa"):
        check_clock(Timeless(cycle=1, first={}, second={}))


def test_a_class_without_torques_is_refused() -> None:
    class Idle(Control):
        type = "idle"

    with pytest.raises(ProblemError, match="controls: Idle: lacks torques"):
        stated(Idle)
    with pytest.raises(ProblemError, match=r"controls is .*, but must be a list of classes: controls=\[MyControl\]"):
        go.load_problem("compass-passive-a", controls=Regulator)  # type: ignore[arg-type]
    with pytest.raises(ProblemError, match=r"is not a subclass of gaitopt\.Control"):
        go.load_problem("compass-passive-a", controls=[int])  # type: ignore[list-item]


@pytest.mark.parametrize(
    ("law", "control", "words"),
    [
        (Regulator, "limits: {knee: 1}", "control.limits.knee: no actuator is called knee; there are ankle, hip"),
        (Stairs, "time: {free: [0.1, 0.4], guess: 0.3}", "control.time: cannot be free"),
    ],
)
def test_a_key_that_a_law_cannot_take_is_named(law: type[Control], control: str, words: str) -> None:
    assert words in refusal(stated, law, f"{{type: {law.type}, {control}}}")


def test_the_version_of_a_law_enters_the_digest_and_must_be_the_installed_one() -> None:
    problem = stated(Regulator)
    assert problem.resolved()["control"]["version"] == "1"

    class Later(Regulator):
        version = "2"

    assert stated(Later).digest != problem.digest
    from gaitopt.problem.problem import restore_problem

    with pytest.raises(ProblemError, match=r"control.version.*'1' is not the version of regulator here, '2'"):
        restore_problem(problem.resolved(), controls=[Later])
    with pytest.raises(ProblemError, match="no control law is called 'regulator'"):
        restore_problem(problem.resolved())
    assert restore_problem(problem.resolved(), controls=[Regulator]).digest == problem.digest
