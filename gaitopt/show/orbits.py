"""A gait as a reference orbit: one JSON object that states its equations, so that no other program is needed.

    M ddq + h = E u + (0, f_t, f_n)'        M (dq_plus - dq_minus) = S' F        of one foot on the ground
    M ddq + h = E u + sum J_i' f_i          M (dq_plus - dq_minus) = sum J_i' F_i    of several contacts

Expressions are texts of ordinary arithmetic in named states and parameters. The equations have the form above; they are
also solved for the rates of the state in each mode. Parameters are exact decimals. A proof adds an enclosure to each
number of the orbit, as decimals rounded outward.
"""

from collections import Counter
from collections.abc import Mapping
from importlib.metadata import version
from typing import Any

import casadi as ca
import numpy as np
from casadi import SX, Function, cse, jacobian, vec, vertcat

from gaitopt.arrays import Array
from gaitopt.building import building
from gaitopt.errors import ProblemError
from gaitopt.gait.gait import Gait, trajectory_header, trajectory_rows
from gaitopt.gait.impacts import IMPULSES, impact_records
from gaitopt.gait.trajectory import Trajectory
from gaitopt.model.modes import Mode
from gaitopt.model.section import CLOCK, TOUCHDOWN
from gaitopt.model.system import HybridSystem
from gaitopt.model.transitions import Ending
from gaitopt.problem.scalars import state_unit, unit_of

FORMAT = "gaitopt-orbit-3"
POINT = ("position", "velocity")
"""Quantities of a contact in the orbit of a walker with several contacts."""
MATRICES = ("M", "E", "swing_jacobian", "relabel_jacobian")
VECTORS = ("equations.h", "equations.swing_foot", "equations.relabel")
LONGEST_INLINE = 60
"""Longest subexpression that is written inline if it occurs once [characters]; longer ones are defined by name."""
ENCLOSED = ("step_length", "speed", "work", "cost_of_transport", "required_friction")
"""Scalars that a proof encloses besides the period."""
OPERATIONS: Mapping[int, str] = {
    ca.OP_ADD: "{} + {}",
    ca.OP_SUB: "{} - {}",
    ca.OP_MUL: "{}*{}",
    ca.OP_DIV: "{}/{}",
    ca.OP_POW: "{}**{}",
    ca.OP_CONSTPOW: "{}**{}",
    ca.OP_ATAN2: "atan2({}, {})",
    ca.OP_NEG: "-{}",
    ca.OP_SQ: "{}**2",
    ca.OP_TWICE: "2*{}",
    ca.OP_INV: "1/{}",
    ca.OP_SQRT: "sqrt({})",
    ca.OP_EXP: "exp({})",
    ca.OP_LOG: "log({})",
    ca.OP_SIN: "sin({})",
    ca.OP_COS: "cos({})",
    ca.OP_TAN: "tan({})",
    ca.OP_ASIN: "asin({})",
    ca.OP_ACOS: "acos({})",
    ca.OP_ATAN: "atan({})",
    ca.OP_SINH: "sinh({})",
    ca.OP_COSH: "cosh({})",
    ca.OP_TANH: "tanh({})",
    ca.OP_ASINH: "asinh({})",
    ca.OP_ACOSH: "acosh({})",
    ca.OP_ATANH: "atanh({})",
    ca.OP_EXPM1: "expm1({})",
    ca.OP_LOG1P: "log1p({})",
    ca.OP_HYPOT: "hypot({}, {})",
    ca.OP_ERF: "erf({})",
    ca.OP_FABS: "abs({})",
    ca.OP_FMAX: "max({}, {})",
    ca.OP_FMIN: "min({}, {})",
    ca.OP_SIGN: "sign({})",
    ca.OP_FLOOR: "floor({})",
    ca.OP_CEIL: "ceil({})",
    ca.OP_FMOD: "fmod({}, {})",
    ca.OP_COPYSIGN: "copysign({}, {})",
    ca.OP_LT: "less({}, {})",
    ca.OP_LE: "1 - less({1}, {0})",
    ca.OP_EQ: "equal({}, {})",
    ca.OP_NE: "1 - equal({}, {})",
    ca.OP_NOT: "equal({}, 0)",
    ca.OP_AND: "1 - equal({}*{}, 0)",
    ca.OP_OR: "1 - equal({}, 0)*equal({}, 0)",
    ca.OP_IF_ELSE_ZERO: "where({}, {})",
}
"""Operations as text. Operands are names, numbers, calls, or expressions in parentheses. ``less`` and ``equal`` are one
or zero; ``where`` is its second argument if the first one is not zero, and zero otherwise."""
CONVENTIONS = (
    "All numbers are in SI units, angles in radians. x is along the slope, downhill; y along its normal. Absolute "
    "angles count from the normal, positive towards downhill.",
    "q = (shape, x, y), where (x, y) is the stance foot; on the ground y = 0. The state is (q, dq) without y and dy.",
    "Motion: M ddq + h = E u + (0, f_t, f_n) with ddy = 0, where the force (f_t, f_n) of the ground acts on the rows "
    "of x and y. stick: dx = 0 and |f_t| <= static*f_n. slip_forward: dx > 0, s = 1; slip_backward: dx < 0, s = -1; "
    "f_t = -s*kinetic*f_n - viscous*dx. Always f_n > 0.",
    "Touchdown is where the expression `touchdown` rises to zero after negative values. Impact of the swing foot, "
    "while the stance foot is free: M (dq_plus - dq_minus) = S' (F_t, F_n), where S is `swing_jacobian`, and "
    "(S dq_plus)_n = 0. stick: (S dq_plus)_t = 0. slip: F_t = -s*kinetic*F_n, s the sign of (S dq_plus)_t; by the "
    "frictionless impact law F_t = 0.",
    "Then the feet swap roles: the new shape is `relabel`, its rates are `relabel_jacobian` times those of the old "
    "shape, dx is (S dq_plus)_t, and x is the new stance foot, `swing_foot`.",
)
CONVENTIONS_OF_CONTACTS = (
    CONVENTIONS[0],
    "q = (shape, x, y); the state is (q, dq). Of every contact, `contacts` gives the position and "
    "the velocity v = J dq, along the ground and normal to it. A mode states what each of them does.",
    "Motion: M ddq + h = E u + sum J' (f_t, f_n) over the contacts on the ground, which have the height zero and the "
    "normal acceleration zero. stick: v_t = 0 and |f_t| <= static*f_n. slip_forward: v_t > 0, s = 1; slip_backward: "
    "v_t < 0, s = -1; f_t = -s*kinetic*f_n - viscous*v_t. off: no force. Always f_n > 0 on the ground.",
    "Where a contact lands, M (dq_plus - dq_minus) = sum J' (F_t, F_n) over the contacts that touch after it, with the "
    "normal velocity zero; the laws of stick and slip hold for the impulses.",
    "After a landing that is marked with `swaps`, the feet swap roles: every contact takes the name of its `partner`, "
    "the new shape is `relabel`, its rates are `relabel_jacobian` times those of the old shape, and (x, y) is "
    "`swing_foot`. A contact with `places` has no mass: it lands without an impulse where its `gap` falls to zero, and "
    "its coordinates take the values of `places`, which they keep while it is off.",
)
CYCLE_ENDS = {
    TOUCHDOWN: "Every step ends with such a landing: x and the time t start again from zero.",
    CLOCK: "A step ends after `cycle_end.period`, that of the control law. The state goes on, but x and the time t "
    "start again from zero.",
}
"""What ends a step, for the events that are not margins."""
AT_A_MARGIN = (
    "A step ends where `cycle_end.margin` falls to zero. The state goes on, but x and the time t start again from zero."
)
CORRECTED = (
    "`control.feedback` has parameters that are corrected where a cycle begins: each is the expression of the state "
    "there, in which the parameters have their values from `parameters`."
)
UNEQUAL = (
    "The legs differ: in every second step the parameters listed in `exchanged` take each other's values. The orbit "
    "returns after an even number of steps."
)
FURTHER = (
    "This walker has further parts, all of them expressions here. `stops` are gaps of joint stops, positive while "
    "free; a stop locks where its gap reaches zero, by a plastic impact, and stays locked until the foot's next "
    "impact. `switches` trigger where their margins fall to zero. `springs` are forces on the left of the equation of "
    "motion in the states that name them. `push` is an impulse of the ground on the stance foot just before the impact."
)


@building
def formulas(
    symbols: Mapping[str, SX], expressions: Mapping[str, Any]
) -> tuple[list[tuple[str, str]], dict[str, list[list[str]]]]:
    """Expressions as texts; a subexpression that is long or occurs several times is defined once under a name.

    Parameters
    ----------
    symbols : symbols by their name in the texts; other symbols keep their own names.
    expressions : matrices by name.

    Returns
    -------
    definitions : (name, text) in an order in which each one uses earlier ones only.
    texts : the rows of every matrix by its name.

    Raises
    ------
    ProblemError
        If an expression has an operation without a formula.
    """
    matrices = {name: ca.densify(SX(value)) for name, value in expressions.items()}
    outputs = cse([vertcat(*(vec(value.T) for value in matrices.values()))])
    names = {symbol.name(): symbol.name() for symbol in ca.symvar(outputs[0])}
    names |= {symbol.name(): name for name, symbol in symbols.items()}
    inputs = ca.symvar(outputs[0])
    function = Function("f", [vertcat(*inputs)], outputs)
    steps = range(function.n_instructions())
    operations = [function.instruction_id(k) for k in steps]
    uses, current, operands = Counter[int](), dict[int, int](), list[list[int]]()
    for k in steps:  # operands are the numbers of the instructions that computed them
        plain = operations[k] in (ca.OP_CONST, ca.OP_INPUT)
        operands.append([] if plain else [current[slot] for slot in function.instruction_input(k)[:2]])
        uses.update(operands[k])
        if operations[k] != ca.OP_OUTPUT:
            current[function.instruction_output(k)[0]] = k
    texts: dict[int, str] = {}
    definitions: list[tuple[str, str]] = []
    flat, rows = ["0"] * function.numel_out(0), function.sparsity_out(0).row()
    for k in steps:
        values = [texts[operand] for operand in operands[k]]
        if operations[k] == ca.OP_OUTPUT:
            flat[rows[function.instruction_output(k)[1]]] = _bare(values[0])
        elif operations[k] == ca.OP_CONST:
            texts[k] = _number(function.instruction_constant(k))
        elif operations[k] == ca.OP_INPUT:
            texts[k] = names[inputs[function.instruction_input(k)[1]].name()]
        elif operations[k] == ca.OP_ASSIGN:
            texts[k] = values[0]
        elif operations[k] in OPERATIONS:
            form = OPERATIONS[operations[k]]
            texts[k] = form.format(*values) if form[0].isalpha() else f"({form.format(*values)})"
            if (uses[k] > 1 or len(texts[k]) > LONGEST_INLINE) and operations[k] != ca.OP_NEG:
                definitions.append((f"a{len(definitions) + 1}", _bare(texts[k])))
                texts[k] = definitions[-1][0]
        else:
            raise ProblemError(f"CasADi's operation {operations[k]} cannot be written as a formula")
    entries = iter(flat)
    return definitions, {
        name: [[next(entries) for _ in range(value.shape[1])] for _ in range(value.shape[0])]
        for name, value in matrices.items()
    }


def _bare(text: str) -> str:
    """A text without parentheses that enclose all of it."""
    if not text.startswith("("):
        return text
    depth = 0
    for k, letter in enumerate(text):
        depth += (letter == "(") - (letter == ")")
        if depth == 0:
            return text[1:-1] if k == len(text) - 1 else text
    return text


def _number(value: float) -> str:
    text = repr(int(value)) if value == int(value) and abs(value) < 2**53 else repr(value)
    return text if value >= 0 else f"({text})"


def parameter_names(system: HybridSystem) -> dict[str, str]:
    """The name in expressions of every parameter by its dotted key: ``leg_length``, ``friction_static``."""
    return {key: key.removeprefix("walker.").replace(".", "_") for key in system.parameters}


@building
def statement_record(gait: Gait, exact: Mapping[str, str]) -> dict[str, Any]:
    """The equations of a gait, with all parameters; for arguments and errors see ``orbit_record``."""
    system, walker, expressions = gait.system, gait.system.walker, gait.system.expressions
    eom, mechanism, n = expressions.eom, expressions.eom.mechanism, len(walker.shape)
    names = parameter_names(system)
    symbols = dict(zip((*names.values(), "t"), ca.vertsplit(vertcat(expressions.p, expressions.t)), strict=True))
    symbols |= {f"r{k}": expressions.r[k] for k in range(system.n_r)}
    modes = list(dict.fromkeys(mode for mode, _ in gait.phases))
    coefficients = system.contact_coefficients(expressions.p)
    equations = {
        "M": eom.M,
        "h": eom.B + eom.G,
        "E": eom.E,
        "swing_foot": mechanism.swing_foot,
        "swing_jacobian": eom.W_swing,
        "touchdown": mechanism.touchdown,
        "relabel": mechanism.relabel,
        "relabel_jacobian": jacobian(SX(mechanism.relabel), eom.q[:n]),
        "energy": eom.energy,
    }
    kinds = ("static", "kinetic", "viscous")
    friction = {
        walker.quantity(kind, name).replace(".", " "): value
        for name in walker.contact_names()
        for kind, value in zip(kinds, coefficients[name], strict=True)
    }
    points = {f"{name} {what}": getattr(eom.contacts[name], what) for name in walker.contacts for what in POINT}
    gaps = {f"{name} gap": eom.contacts[name].gap for name in walker.contacts}
    landings = {
        f"{name} {coordinate}": value
        for name, contact in mechanism.contacts.items()
        for coordinate, value in contact.places.items()
    }
    torques = {str(mode): expressions.torque(mode) for mode in modes}
    bodies = [(body.mass, body.inertia, body.angle, body.position) for body in mechanism.bodies]
    further: dict[str, Mapping[str, Any]] = {
        "stops": mechanism.stops,
        "switches": eom.switches,
        "springs": {state: eom.force_of(energy) for state, energy in mechanism.potential_while.items()},
        "push": mechanism.pushes,
    }
    definitions, texts = formulas(
        symbols,
        {
            **{f"equations.{name}": value for name, value in equations.items()},
            **{f"friction.{name}": value for name, value in friction.items()},
            **{f"torques.{mode}": value for mode, value in torques.items()},
            **{f"contacts.{name}": value for name, value in points.items()},
            **{f"landings.{name}": value for name, value in (gaps | landings).items()},
            **({"section": eom.sections[system.cycle_end]} if system.cycle_end in eom.sections else {}),
            **{f"feedback.{names[key]}": value for key, value in _corrected(system).items()},
            **{f"further.{kind}.{name}": v for kind, values in further.items() for name, v in values.items()},
            **{f"bodies.{k}": vertcat(*map(SX, body)) for k, body in enumerate(bodies)},
            "gravity": mechanism.gravity,
        },
    )

    def column(name: str) -> Any:
        """A vector as a list, a scalar as its text."""
        values = [row[0] for row in texts[name]]
        kind = name.partition(".")[0]
        is_vector = kind in ("torques", "gravity", "bodies", "contacts") or name in VECTORS or len(values) > 1
        return values if is_vector else values[0]

    partners = walker.partners()
    of_contacts = {
        name: {
            **{what: column(f"contacts.{name} {what}") for what in POINT},
            "gap": column(f"landings.{name} gap"),
            "places": {key: column(f"landings.{name} {key}") for key in mechanism.contacts[name].places},
            "partner": partners.get(name),
        }
        for name in walker.contacts
    }
    ends_at_margin = system.cycle_end in eom.sections
    breaks, last = [0.0, *map(float, system.control.breakpoints), None], max(int(arc.segment) for arc in gait.arcs)
    values, exchanged = gait.dynamics.parameters, _exchanged(system, names)
    return {
        "words": [
            *(CONVENTIONS_OF_CONTACTS if walker.contacts else CONVENTIONS),
            AT_A_MARGIN if ends_at_margin else CYCLE_ENDS[system.cycle_end],
            *([UNEQUAL] if exchanged else []),
            *([FURTHER] if any(further.values()) else []),
            *([CORRECTED] if system.correction else []),
        ],
        "coordinates": {name: state_unit(name) for name in (*walker.shape, "x", "y")},
        "states": {name: state_unit(name, system) for name in system.state_names},
        "parameters": {
            name: {"key": key, "exact": exact[key], "value": values[key], "unit": unit_of(key, system)}
            for key, name in names.items()
        },
        "exchanged": exchanged,
        "cycle_end": {
            "event": system.cycle_end,
            "margin": column("section") if ends_at_margin else None,
            "period": system.control.period if system.cycle_end == CLOCK else None,
        },
        "gravity": column("gravity"),
        "bodies": [
            dict(zip(("mass", "inertia", "angle", "position"), (*text[:3], text[3:]), strict=True))
            for text in (column(f"bodies.{k}") for k in range(len(bodies)))
        ],
        "friction": {name: {kind: column(f"friction.{kind} {name}") for kind in kinds} for name in walker.contacts}
        or {kind: column(f"friction.{kind}") for kind in kinds},
        **({"contacts": of_contacts} if walker.contacts else {}),
        "impact_law": str(system.law),
        "control": {
            "type": system.control.type,
            "actuators": list(walker.actuators),
            "torques": {mode: column(f"torques.{mode}") for mode in torques},
            "segments": [
                {"start": breaks[k], "end": breaks[k + 1], "r": system.data(k).tolist()} for k in range(last + 1)
            ],
            "feedback": {names[key]: column(f"feedback.{names[key]}") for key in _corrected(system)},
        },
        "definitions": [list(definition) for definition in definitions],
        "equations": {
            name: texts[f"equations.{name}"] if name in MATRICES else column(f"equations.{name}") for name in equations
        },
        "further_parts": {
            kind: {name: column(f"further.{kind}.{name}") for name in values} for kind, values in further.items()
        },
    }


def _exchanged(system: HybridSystem, names: Mapping[str, str]) -> dict[str, str]:
    """Pairs of parameters that take each other's values in every second step."""
    order = system.step_parameters(np.arange(len(system.parameters)))[-1].tolist()
    pairs = ((system.parameters[k], system.parameters[other]) for k, other in enumerate(order) if k < other)
    return {names[key]: names[other] for key, other in pairs}


def _corrected(system: HybridSystem) -> dict[str, SX]:
    """The parameters that feedback from step to step corrects, as functions of the state where a cycle begins."""
    if system.correction is None:
        return {}
    p = system.correction.symbolic(system.expressions.p, system.expressions.eom.z)
    return {key: p[system.parameters.index(key)] for key in system.correction.keys}


@building
def evaluation_record(gait: Gait) -> dict[str, Any]:
    """The equations of a gait solved for the rates of the state, and the arcs in which they hold.

    Each of ``modes`` has the rates of the state, and the margins that end an arc. Each of ``resets`` has the state
    after an impact, after slips that end together, or at the start of the next step. ``arcs`` are in the order of time;
    a phase has several of them if the law has breakpoints.
    """
    system, cycle = gait.system, gait.cycle
    expressions, table, names = system.expressions, system.transitions, parameter_names(system)
    symbols = dict(zip((*names.values(), "t"), ca.vertsplit(vertcat(expressions.p, expressions.t)), strict=True))
    symbols |= {f"r{k}": expressions.r[k] for k in range(system.n_r)}

    def block(values: Mapping[str, SX]) -> dict[str, Any]:
        definitions, texts = formulas(symbols, values)
        columns = {name: [row[0] for row in rows] for name, rows in texts.items()}
        return {"definitions": [list(each) for each in definitions], **columns}

    ends: dict[Mode, list[str]] = {}
    resets = dict[str, dict[str, Any]]()

    def reset_name(name: str, state: SX) -> str:
        """The name of a reset; the same impact of another mode may be another function."""
        reset, number = block({"state": state}), 1
        while resets.setdefault(name if number == 1 else f"{name} ({number})", reset) != reset:
            number += 1
        return name if number == 1 else f"{name} ({number})"

    arcs, number = list[dict[str, Any]](), 0
    for step in gait.steps:
        for k, arc in enumerate(step.arcs):
            ends_step = k == len(step.arcs) - 1
            is_last = ends_step or step.arc_phases[k + 1] != step.arc_phases[k]
            guard = table.ending(cycle, number).guard if is_last else None
            guards = ends.setdefault(arc.mode, [])
            if guard in table.margin_names(arc.mode) and guard not in guards:
                guards.append(guard)
            struck, reset = (table.struck(cycle, number) if is_last else None), None
            lands = not ends_step or system.cycle_end == TOUCHDOWN
            if struck is not None:
                name = str(cycle.reset_after(number)) if lands else _step_end(step is gait.steps[-1])
                reset = reset_name(name, expressions.reset(struck, arc.mode, ends_step=ends_step))
            elif is_last and cycle.stop_together(number):
                reset = reset_name(
                    "slips end together", expressions.stopped_together(arc.mode, cycle.phases[number + 1])
                )
            landed = cycle.reset_after(number) if is_last and lands else None
            arcs.append(
                {
                    "mode": str(arc.mode), "start": arc.start, "end": arc.end, "r": system.data(arc.segment).tolist(),
                    "ends_with": guard, "reset": reset, "ends_step": ends_step,
                    "swaps": landed is not None and (ends_step or landed.swaps),
                }
            )  # fmt: skip
            number += is_last
    modes = dict[str, Any]()
    for mode, guards in ends.items():
        values, order = expressions.margins(mode), table.margin_names(mode)
        margins = vertcat(SX(0, 1), *(values[order.index(guard)] for guard in guards))
        solved = block({"rates": expressions.rate(mode), "margins": margins})
        modes[str(mode)] = {**solved, "margins": dict(zip(guards, solved["margins"], strict=True))}
    return {
        "modes": modes,
        "resets": resets,
        "arcs": arcs,
    }


def motion_record(gait: Gait, theorem: Mapping[str, Any] | None) -> dict[str, Any]:
    """The motion of a gait with the enclosures of a theorem: events, samples, period and multipliers."""
    system, cycle, proved = gait.system, gait.cycle, theorem or {}

    def enclosed(name: str, value: float | None) -> dict[str, Any]:
        return {"value": value, "unit": unit_of(name, system), "enclosure": proved.get(name)}

    whole = Trajectory(
        names=system.state_names, start=gait.state, steps=gait.steps, ending=Ending.COMPLETED, message=""
    )
    impacts = iter(impact_records(whole))
    phases, events, began, number = list[dict[str, Any]](), list[dict[str, Any]](), 0.0, 0
    durations = proved.get("durations") or [None] * len(gait.phases)
    for k, step in enumerate(gait.steps):
        for index in range(len(step.phases)):
            arcs = [arc for arc, phase in zip(step.arcs, step.arc_phases, strict=True) if phase == index]
            end, mode, ending = began + arcs[-1].end, str(arcs[-1].mode), system.transitions.ending(cycle, number)
            duration = {"value": arcs[-1].end - arcs[0].start, "enclosure": durations[number]}
            phases.append({"step": k + 1, "mode": mode, "duration": duration, "ends_with": ending.guard})
            after, reset = cycle.after(number), cycle.reset_after(number)
            lands = reset is not None and (after is not None or system.cycle_end == TOUCHDOWN)
            to = str(after) if after is not None else "impact" if lands else _step_end(step is gait.steps[-1])
            event: dict[str, Any] = {"time": end, "step": k + 1, "what": ending.guard, "from": mode, "to": to}
            event["state_before"] = _named(system, arcs[-1].states[-1])
            if after is None:
                event["state_after"] = _named(system, step.final_impact.state)
                event["step_length"] = step.final_impact.step_length
            elif lands:
                (start, *_) = (arc for arc, phase in zip(step.arcs, step.arc_phases, strict=True) if phase == index + 1)
                event["state_after"] = _named(system, start.states[0])
            if lands:
                event |= {"impact": str(reset), "impulse": _impulse(system, next(impacts)["impulse"])}
            events.append(event)
            number += 1
        began += step.period
    header = trajectory_header(system)
    units = {name: state_unit(name, system) for name in system.state_names} | {"mode": ""}
    return {
        "n_steps": len(gait.steps),
        "period": enclosed("period", gait.period),
        "initial_state": {
            name: {"value": value, "unit": state_unit(name), "enclosure": proved.get("state", {}).get(name)}
            for name, value in _named(system, gait.state).items()
        },
        "phases": phases,
        "events": events,
        "multipliers": _multipliers(gait, proved),
        "spectral_radius": enclosed("spectral_radius", gait.spectral_radius),
        "stable": gait.spectral_radius is not None and gait.spectral_radius < 1,
        "scalars": {name: enclosed(name, gait.measures.get(name)) for name in ENCLOSED},
        "samples": {
            "columns": list(header),
            "units": [units[name] if name in units else unit_of(name, system) for name in header],
            "rows": [[None if value != value else value for value in row] for row in trajectory_rows(gait.steps)],
        },
    }


def _step_end(is_last: bool) -> str:
    """What follows a step that ends without a landing."""
    return "end of cycle" if is_last else "end of step"


def _impulse(system: HybridSystem, impulses: Any) -> dict[str, float | None]:
    """The impulses of all contacts, with their names before the impact; None where they are undetermined."""
    if impulses is None or not system.walker.contacts:
        names = (system.walker.quantity(F, name) for name in system.walker.contact_names() for F in IMPULSES)
        return dict.fromkeys(names, None) if impulses is None else dict(impulses)
    none = dict.fromkeys(IMPULSES, 0.0)
    return {f"{F}.{name}": impulses.get(name, none)[F] for name in system.walker.contacts for F in IMPULSES}


def _named(system: HybridSystem, state: Array) -> dict[str, float]:
    return dict(zip(system.state_names, map(float, state), strict=True))


def _multipliers(gait: Gait, proved: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The multipliers, each with the enclosure that contains it."""
    numbers = [{"re": float(m.real), "im": float(m.imag)} for m in gait.multipliers]
    boxes = list(proved.get("multipliers", []))
    records = []
    for number in numbers:
        distances = [sum(abs(float(box[axis][0]) - value) for axis, value in number.items()) for box in boxes]
        box = boxes[distances.index(min(distances))] if boxes else None
        boxes = [other for other in boxes if other is not box]
        records.append(number | {"enclosure": box})
    return records


def orbit_record(
    gait: Gait,
    exact: Mapping[str, str],
    *,
    theorem: Mapping[str, Any] | None = None,
    certificate: Mapping[str, str] | None = None,
    unproved: str | None = None,
) -> dict[str, Any]:
    """A gait as a reference orbit.

    Parameters
    ----------
    exact : text of the exact value of every parameter by dotted key.
    theorem : ``Proof.to_record`` of its proof; None if it has none.
    certificate : ``file`` and ``sha256`` of the certificate.
    unproved : why it has no proof.

    Raises
    ------
    ProblemError
        If an expression has an operation without a formula.
    """
    return {
        "format": FORMAT,
        "name": gait.problem.name,
        "about": gait.problem.about,
        "license": "CC-BY-4.0",
        "mechanism": gait.system.walker.model,
        "proved": theorem is not None,
        "unproved": unproved,
        "certificate": None
        if theorem is None
        else {**(certificate or {}), "not_proved": theorem["statement"]["not_proved"]},
        "statement": statement_record(gait, exact),
        "evaluation": evaluation_record(gait),
        "orbit": motion_record(gait, theorem),
        "made_by": {name: version(name) for name in ("gaitopt", "casadi", "numpy")},
    }
