"""Virtual constraints: outputs that follow curves over a phase variable of the walker, instead of over time.

    y = h(q) - h_d(s),    s = (phi(q) - s0) / (s1 - s0)

h are the angles of some joints or motors, and phi is a phase variable that is monotone along a step. h_d are Bezier
curves, constants, or polynomials that fit a table or a gait. Outside of the span from s0 to s1 the curves continue as
polynomials. With a width w of ``clamp`` they are constant there, because h_d then has the argument

    c(s) = (1 + sqrt(s^2 + w^2) - sqrt((s - 1)^2 + w^2)) / 2,

which is smooth. It differs by at most about w / 2 from s inside of the span, and from 0 or 1 outside. If a clamp had
kinks, the torques would jump when the phase passes an end, which is not an event of any mode sequence. With the shape
accelerations ddq = drift + response u, for a foot that sticks or in the actual mode, and J = dy/dq, the law is

    linearising    u = (J response)^-1 (-J drift - dJ/dt dq - kp y - kd dy),    so that ddy + kd dy + kp y = 0
    pd             u = -kp y - kd dy

J response = Lg Lf y is the decoupling matrix. ddy + kd dy + kp y = 0 holds in the mode whose accelerations the law
uses.

References
----------
Westervelt, Grizzle & Koditschek (2003), Hybrid zero dynamics of planar biped walkers, IEEE TAC 48(1), section III.
"""

from collections.abc import Iterator, Mapping
from enum import StrEnum
from typing import Annotated

import numpy as np
from casadi import SX, jacobian, jtimes, solve, sqrt, vertcat, vertsplit
from pydantic import Field

from gaitopt.arrays import Array
from gaitopt.model.control import Control
from gaitopt.model.curve import Curve
from gaitopt.model.instant import Instant
from gaitopt.model.reference import (
    CurveReference,
    GaitReference,
    OtherOverPhase,
    OverPhase,
    Path,
    Reference,
    TableReference,
    exchanged_points,
    faults_of_other,
)
from gaitopt.model.units import Angle, NonNegative
from gaitopt.model.walker import WalkerType

GAINS = {
    "kp": "gain on the outputs, in 1/s^2 of a linearising law and in N m/rad, or N/m, of a pd law",
    "kd": "gain on their rates, in 1/s of a linearising law and in N m s/rad, or N s/m, of a pd law",
}
LARGEST_GAIN = 1e9
SMALLEST_CLAMP = 1e-3
"""Smallest width of a clamp. A narrower one would be so stiff that the integration needs tiny steps."""
Gain = Annotated[NonNegative, Field(le=LARGEST_GAIN)]
Name = Annotated[str, Field(min_length=1, max_length=100)]


class Law(StrEnum):
    """Feedback that drives the outputs to zero."""

    LINEARISING = "linearising"
    PD = "pd"


class FootModel(StrEnum):
    """The contact mode whose accelerations a linearising law uses: that of a sticking foot, or of the phase."""

    STICK = "stick"
    ACTUAL = "actual"


class VirtualConstraints(Control):
    """Virtual constraints: joint angles as functions of a phase variable."""

    type = "virtual_constraints"

    outputs: Annotated[
        tuple[Name, ...],
        Field(min_length=1, description="constrained angles: shape coordinates, phase variables, or motors' angles"),
    ]
    phase: Annotated[Name, Field(description="phase variable: a shape coordinate, or one that the walker names")]
    span: Annotated[
        tuple[Angle, ...] | None,
        Field(
            min_length=2,
            max_length=2,
            description="values of the phase variable at the start and the end of the curves [rad, or m]; by default "
            "those of the gait that the reference names",
        ),
    ] = None
    reference: Annotated[OverPhase, Field(description="curves of the outputs as functions of the phase variable")]
    other_reference: Annotated[
        OtherOverPhase,
        Field(
            description="curves in the second, fourth, ... step of a cycle; Bezier curves with the outputs and the "
            "degree of those of the reference"
        ),
    ] = None
    clamp: Annotated[
        float | None,
        Field(
            ge=SMALLEST_CLAMP,
            le=0.5,
            allow_inf_nan=False,
            strict=True,
            description="width, as a fraction of the span, over which the phase variable saturates smoothly at both "
            "ends of the span, so that the curves are constant outside; by default they continue as polynomials",
        ),
    ] = None
    law: Annotated[
        Law,
        Field(
            description="linearising: input-output linearisation, with which the outputs obey y'' + kd y' + kp y = 0 "
            "in the contact mode of `model`; pd: the motors apply -kp y - kd y'"
        ),
    ] = Law.LINEARISING
    gains: Annotated[
        dict[str, Gain],
        Field(
            description="gains on the outputs and on their rates",
            json_schema_extra={
                "properties": {
                    name: {"type": "number", "minimum": 0, "maximum": LARGEST_GAIN, "description": meaning}
                    for name, meaning in GAINS.items()
                },
                "required": [*GAINS],
                "additionalProperties": False,
            },
        ),
    ]
    model: Annotated[
        FootModel,
        Field(
            description="contact mode for which the law linearises: stick, as if the foot always stuck, or actual, "
            "the mode of the phase"
        ),
    ] = FootModel.STICK
    motors: Annotated[
        tuple[Name, ...] | None,
        Field(
            description="motor of each output; by default the motor whose angle or tracked joint the output is, or "
            "all motors if there are as many as outputs"
        ),
    ] = None

    @property
    def is_invariant(self) -> bool:
        """Whether a design keeps the curves invariant under the impact."""
        return self.reference.is_invariant

    def unit(self, key: str) -> str:
        """Unit of a parameter by its key. The units of the gains depend on ``law``, the others are in descriptions."""
        units = ("1/s^2", "1/s") if self.law is Law.LINEARISING else ("N m/rad", "N m s/rad")
        return dict(zip(("gains.kp", "gains.kd"), units, strict=True)).get(key) or super().unit(key)

    @property
    def phase_variable(self) -> str:
        """The phase of the curves."""
        return self.phase

    @property
    def targets(self) -> dict[str, Reference]:
        """The references; by default each output follows its own angle of a gait."""
        reference: Reference = self.reference
        if isinstance(reference, GaitReference | CurveReference) and reference.joints is None and reference.source[0]:
            reference = reference.model_copy(update={"joints": {name: name for name in self.outputs}})
        return {"reference": reference} | (
            {} if self.other_reference is None else {"other_reference": self.other_reference}
        )

    @property
    def exchanged(self) -> Mapping[str, str]:
        """The control points of both references, if there are two."""
        return exchanged_points(self.reference, self.other_reference)

    @property
    def curve(self) -> Curve:
        """The curves of the outputs over the phase variable."""
        return self.reference.motion(self.phase, (0.0, 1.0) if self.span is None else (self.span[0], self.span[1]))

    def data(self, segment: int) -> Array:
        """The span and the width of the clamp if there is one, and the data of the curves."""
        curve = self.curve
        start, end = self.span or (curve.pieces[0].start, curve.pieces[0].end)
        clamp = () if self.clamp is None else (start, end, self.clamp)
        return np.array([*clamp, *curve.data(segment)])

    def driven_by(self, walker: WalkerType) -> tuple[str, ...]:
        """The motor for each output; empty if ``motors`` must state it."""
        if self.motors is not None:
            return self.motors
        tracked = dict(zip(walker.tracked, walker.actuators, strict=False))
        known = [name if name in walker.actuators else tracked.get(name, "") for name in self.outputs]
        if all(known) and len({*known}) == len(known):
            return tuple(known)
        return walker.actuators if len(walker.actuators) == len(self.outputs) else ()

    def faults(self, walker: WalkerType) -> Iterator[tuple[Path, str]]:
        """Names that the walker does not have, and curves, gains and motors that do not match the outputs."""
        angles, motors = (*walker.shape, *walker.phases), self.driven_by(walker)
        for k, name in enumerate(self.outputs):
            if name not in (*angles, *walker.actuators):
                known = ", ".join(dict.fromkeys((*angles, *walker.actuators)))
                yield ("outputs", k), f"{walker.model} has no angle {name!r}; it has {known}"
            elif name in self.outputs[:k]:
                yield ("outputs", k), f"{name} is listed twice, which makes the decoupling matrix singular"
            elif name == self.phase:
                yield ("outputs", k), f"{name} is the phase variable, of which an output cannot be a function"
        if self.phase not in angles:
            yield ("phase",), f"{walker.model} has no phase variable {self.phase!r}; it has {', '.join(angles)}"
        if self.span is None and not self.reference.source[0]:
            yield ("span",), "is missing: give the phase just after and just before the impact, span: [START, END]"
        elif self.span is not None and self.span[0] == self.span[1]:
            yield ("span",), f"is empty: both ends are {self.span[0]:g}; give the phase after and before the impact"
        yield from faults_of_other(self.reference, self.other_reference)
        names = self.targets["reference"].names
        if {*names} != {*self.outputs} and (
            names or not isinstance(self.reference, CurveReference)
        ):  # or points are missing
            mismatch = f"has curves of {', '.join(names) or 'no output'}; the outputs are {', '.join(self.outputs)}"
            yield ("reference", *self.reference.joints_path), mismatch
        if (
            isinstance(self.reference, TableReference)
            and (first := next(iter(self.reference.table.columns))) != self.phase
        ):
            mismatch = f"its first column is {first}, but must be the phase variable {self.phase}"
            yield ("reference", "table"), f"{self.reference.table.file}: {mismatch}"
        if self.is_invariant and self.law is not Law.LINEARISING:
            yield ("law",), "pd does not keep the outputs at zero, so that no curves are invariant: use linearising"
        for name in sorted({*GAINS} ^ {*self.gains}):
            yield ("gains", name), "is missing" if name in GAINS else f"unknown key; allowed: {', '.join(GAINS)}"
        for k, name in enumerate(self.motors or ()):
            if name not in walker.actuators:
                yield ("motors", k), f"{walker.model} has no motor {name!r}; it has {', '.join(walker.actuators)}"
        if {*self.outputs} <= {*angles, *walker.actuators} and len({*motors}) != len(self.outputs):
            rule = f"one of {', '.join(walker.actuators)} for each of {', '.join(self.outputs)}"
            yield ("motors",), f"must name {rule}: {len({*motors})} given for {len(self.outputs)} outputs"
        yield from super().faults(walker)

    def quantities(self, now: Instant) -> Mapping[str, SX]:
        """Outputs y (m,), their rates, and the decoupling matrix (m, m)."""
        y, J = self._outputs(now)
        return {
            "outputs": y,
            "rates": J @ now.robot.dq[: J.shape[1]],
            "decoupling": self._decoupling(now, J),
        }

    def torques(self, now: Instant) -> Mapping[str, SX]:
        """The feedback on the outputs, by motor."""
        y, J = self._outputs(now)
        q, dq = now.robot.q[: J.shape[1]], now.robot.dq[: J.shape[1]]
        correction = -now.p.gains.kp * y - now.p.gains.kd * (J @ dq)
        if self.law is Law.LINEARISING:
            drift, _ = now.accelerations(actual=self.model is FootModel.ACTUAL)
            correction = solve(self._decoupling(now, J), correction - J @ drift - jtimes(J @ dq, q, dq))
        return dict(zip(self.driven_by(now.robot.walker), vertsplit(correction), strict=True))

    def _outputs(self, now: Instant) -> tuple[SX, SX]:
        """Outputs y and their derivative by the shape."""
        walker, motors = now.robot.walker, now.robot.mechanism.motors
        angles = dict(zip(walker.actuators, motors, strict=True)) | vars(now.s)
        phase, data = angles[self.phase], now.r
        if self.clamp is not None:
            start, end, w, data = data[0], data[1], data[2], data[3:]
            s = (phase - start) / (end - start)
            phase = start + (end - start) * (1 + sqrt(s**2 + w**2) - sqrt((s - 1) ** 2 + w**2)) / 2
        curves, _ = self.curve.at(phase, 0, data, now.p.reference, (1, 0))
        desired = dict(zip(self.curve.names, vertsplit(curves), strict=True))
        y = vertcat(*(angles[name] - desired[name] for name in self.outputs))
        return y, jacobian(y, now.robot.q[: len(walker.shape)])

    def _decoupling(self, now: Instant, J: SX) -> SX:
        walker = now.robot.walker
        _, response = now.accelerations(actual=self.model is FootModel.ACTUAL)
        return J @ response[:, [walker.actuators.index(name) for name in self.driven_by(walker)]]
