"""Recompute orbits from their JSON files with numpy and scipy alone, and judge them: python recompute.py NAME.json ...

Integrates one cycle with the equations of the file, and prints by how much the numbers that the file states differ. The
exit code is 1 if a difference exceeds its limit.
"""

import json
import re
import sys
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, linear_sum_assignment, linprog
from scipy.special import erf

ARITHMETIC = re.compile(r"([A-Za-z]\w*|\d+\.?\d*(e[+-]?\d+)?|[-+*/(), ])+")
FUNCTIONS = {
    name: getattr(np, name)
    for name in ("sin", "cos", "tan", "sinh", "cosh", "tanh", "sqrt", "exp", "log", "expm1", "log1p")
}
FUNCTIONS |= {f"a{name}": getattr(np, f"arc{name}") for name in ("sin", "cos", "tan", "sinh", "cosh", "tanh")}
FUNCTIONS |= {
    "erf": erf,
    "abs": lambda x: np.where(np.real(x) < 0, -x, x),
    "max": lambda x, y: np.where(np.real(x) > np.real(y), x, y),
    "min": lambda x, y: np.where(np.real(x) < np.real(y), x, y),
    "hypot": lambda x, y: np.sqrt(x**2 + y**2),
    "atan2": lambda y, x: np.arctan2(np.real(y), np.real(x)) + 1j * np.imag(y / x) / (1 + np.real(y / x) ** 2),
    "sign": lambda x: np.sign(np.real(x)),
    "floor": lambda x: np.floor(np.real(x)),
    "ceil": lambda x: np.ceil(np.real(x)),
    "fmod": lambda x, y: x - np.trunc(np.real(x / y)) * y,
    "copysign": lambda x, y: np.where(np.signbit(np.real(x)) == np.signbit(np.real(y)), x, -x),
    "less": lambda x, y: np.where(np.real(x) < np.real(y), 1.0, 0.0),
    "equal": lambda x, y: np.where(np.real(x) == np.real(y), 1.0, 0.0),
    "where": lambda x, y: np.where(np.real(x) != 0, y, 0.0),
}
ACCURACY = {"rtol": 1e-12, "atol": 1e-14}
SLACK = 0.01
"""Part of an arc within which its end is sought."""
POINTS = 200
"""Number of points of an arc at which margins are examined."""
SMALL = 1e-30
"""Imaginary part of a variable; that of a function is then its derivative, without rounding."""
STEP = 1e-6
"""Of differences of derivatives."""
POINT, KINDS = ("position", "velocity"), ("static", "kinetic", "viscous")
LANDS = re.compile(r"touchdown$|gap\.")
"""Names of the events at which a contact lands."""
SPARSE = 5
"""Undetermined forces are sought at every fifth point of an arc."""
FIRST_FORMAT = "gaitopt-orbit-2"
"""Format in which only the landing that ends a step has impulses."""
DIRECTIONS = {"stick": 0, "slip_forward": 1, "slip_backward": -1}
LIMITS = {
    "parameters": 1e-15,
    "ends of phases": 1e-9,
    "period": 1e-9,
    "initial state": 1e-9,
    "events": 1e-8,
    "equations": 1e-9,
    "margins": 1e-8,
    "samples": 1e-8,
    "multipliers": 1e-6,
    "scalars": 1e-8,
    "enclosures": 1e-9,
}
"""Largest differences: times in seconds, states in rad, m and s; forces, samples and scalars relative to their largest
values; multipliers relative to moduli above one."""


def function(data, definitions, texts, parameters, r=(), corrected=()):
    """(t, z) -> values of nested lists of texts; the entries of z may be arrays.

    Parameters that feedback has corrected may follow the states in z.
    """
    variables = [*data["statement"]["states"], *corrected]

    def joined(entry):
        return f"({''.join(f'{joined(each)}, ' for each in entry)})" if isinstance(entry, list) else entry

    lines = [*definitions, ("values", joined(texts))]
    for name, text in lines:
        if not ARITHMETIC.fullmatch(f"{name} {text}"):
            raise ValueError(f"{data['name']}: {text[:40]!r} is not arithmetic")
    code = compile("\n".join(f"{name} = {text}" for name, text in lines), data["name"], "exec")
    constants = FUNCTIONS | parameters | {f"r{k}": value for k, value in enumerate(r)}

    def evaluate(t, z):
        names = constants | {"t": t, "y": 0.0, "dy": 0.0} | dict(zip(variables, z, strict=len(z) == len(variables)))
        exec(code, {"__builtins__": {}}, names)  # noqa: S102 - arithmetic
        return names["values"]

    return evaluate


def stated(data, arc, texts):
    """(t, z) -> values of texts of the statement with the parameters of an arc."""
    return function(data, data["statement"]["definitions"], texts, arc["parameters"], arc["r"])


def filled(entry, t):
    """Nested values as an array whose last axis is the time."""
    return np.array([filled(each, t) if isinstance(each, tuple) else np.broadcast_to(each, t.shape) for each in entry])


def derivative(values, t, z):
    """The vector values(t, z), its derivative by z, and that by t; shapes (m,), (m, n) and (m,)."""
    moved = np.hstack([z[:, None] + SMALL * 1j * np.eye(z.size), z[:, None]])
    times = t + SMALL * 1j * (np.arange(z.size + 1) == z.size)
    found = np.array([np.broadcast_to(row, z.size + 1) for row in values(times, moved)], dtype=complex)
    found = found.reshape(-1, z.size + 1)
    slopes = found.imag / SMALL
    return found.real[:, 0], slopes[:, :-1], slopes[:, -1]


def recompute(data):
    """The arcs of one cycle, the derivative of the return map, and the multipliers.

    Deviations of the state, and of the parameters that feedback corrects where the cycle begins, follow the variational
    equations along an arc. At an event they jump, because its time moves with them.
    """
    statement, evaluation = data["statement"], data["evaluation"]
    z = np.array([entry["value"] for entry in data["orbit"]["initial_state"].values()])
    parameters = {name: entry["value"] for name, entry in statement["parameters"].items()}
    feedback = statement["control"].get("feedback", {})
    n, m, corrected = z.size, len(feedback), list(feedback)
    begun = function(data, statement["definitions"], [*feedback.values()], parameters, evaluation["arcs"][0]["r"])
    u, of_u, _ = derivative(begun, 0.0, z)  # constant in the cycle, like their derivative
    Phi, arcs = np.eye(n), []
    parameters |= dict(zip(corrected, u.tolist(), strict=True))
    pairs = statement["exchanged"] | {b: a for a, b in statement["exchanged"].items()}

    def extended(block, texts, number, r=()):
        return function(data, block["definitions"], texts, arcs_parameters[number], r, arcs_corrected[number])

    arcs_parameters, arcs_corrected = [], []
    for arc in evaluation["arcs"]:
        arcs_parameters.append(dict(parameters))
        arcs_corrected.append(list(corrected))
        if arc["ends_step"]:
            parameters |= {name: arcs_parameters[-1][other] for name, other in pairs.items()}
            corrected = [pairs.get(name, name) for name in corrected]
    for number, arc in enumerate(evaluation["arcs"]):
        block, guard = evaluation["modes"][arc["mode"]], arc["ends_with"]
        guard = guard if guard in block["margins"] else None  # others have a fixed time
        rates = extended(block, block["rates"], number, arc["r"])

        def variational(t, y, rates=rates):
            f, slope, _ = derivative(rates, t, np.append(y[:n], u))
            return np.append(f, slope @ np.vstack([y[n:].reshape(n, n), of_u]))

        end, slack = arc["end"], SLACK * (arc["end"] - arc["start"]) * (guard is not None)
        solved = solve_ivp(
            variational, (arc["start"], end + slack), np.append(z, Phi), "DOP853", dense_output=True, **ACCURACY
        )
        path = solved.sol
        if guard is not None:
            margin = extended(block, [block["margins"][guard]], number, arc["r"])

            def along(t, path=path, margin=margin):
                return margin(t, path(t)[:n])[0]

            if not solved.success or not along(end - slack) > 0 > along(end + slack):
                raise ValueError(f"{guard} does not fall to zero at {end:.9g} s in {arc['mode']}")
            end = brentq(along, end - slack, end + slack, xtol=1e-15)
        before, deviations = path(end)[:n], np.vstack([path(end)[n:].reshape(n, n), of_u])
        after, jump, at = before, np.eye(n, n + m), np.append(before, u)
        if arc["reset"]:
            reset = evaluation["resets"][arc["reset"]]
            after, jump, _ = derivative(extended(reset, reset["state"], number, arc["r"]), end, at)
        if guard is not None:
            _, slope, of_time = derivative(margin, end, at)
            f = np.array(rates(end, before), dtype=float)
            earlier = slope[0] / (slope[0, :n] @ f + of_time[0])  # by this much the event is earlier
            jump = jump - np.outer(jump[:, :n] @ f, earlier)
            if not arc["ends_step"]:
                following = evaluation["arcs"][number + 1]
                block = evaluation["modes"][following["mode"]]
                later = extended(block, block["rates"], number, following["r"])
                jump = jump + np.outer(later(end, after), earlier)
        found = {"end": end, "path": path, "rates": rates, "parameters": arcs_parameters[number]}
        arcs.append({**arc, **found, "before": before, "after": after})
        z, Phi = after, jump @ deviations
    return arcs, Phi, multipliers(data, arcs[-1], Phi, jump[:, :n])


def multipliers(data, arc, Phi, jump):
    """Eigenvalues of the return map's derivative on the section, to which the last ``jump`` leads from ``arc``."""
    z, t, statement = arc["before"], arc["end"], data["statement"]
    n, rows, contacts = z.size, [], statement.get("contacts", {})
    for name in locked(arc["mode"]):
        gap = stated(data, arc, [statement["further_parts"]["stops"][name]])

        def rate(z, gap=gap):
            return derivative(gap, t, z)[1][0, : n // 2] @ z[n // 2 :]

        moves = STEP * np.eye(n)
        rows += [derivative(gap, t, z)[1][0], [(rate(z + move) - rate(z - move)) / (2 * STEP) for move in moves]]
    for name in (name for name in closed(arc["mode"]) if contacts):
        height, moving = (derivative(stated(data, arc, contacts[name][what]), t, z)[1] for what in POINT)
        rows += [height[1], moving[1], *([moving[0]] if states_of(arc["mode"])[name] == "stick" else [])]
    _, sizes, V = np.linalg.svd(np.array(rows).reshape(-1, n))
    free = V[int((sizes > STEP * np.max(sizes, initial=0.0)).sum()) :].T  # directions in which the last mode can move
    stale, kept = without_influence(data, data["evaluation"]["arcs"][0]["mode"]), np.ones((n, 1))
    kept[[k for k, name in enumerate(statement["states"]) if name in stale or name.removeprefix("d") in stale]] = 0
    section, sizes, _ = np.linalg.svd(kept * jump @ free)
    section = section[:, : int((sizes > STEP * sizes[0]).sum())]
    return np.linalg.eigvals(section.T @ Phi @ section)


def states_of(mode):
    """The state of every contact in a mode by its name; the foot of a walker that has one on the ground is ``""``."""
    named, word = dict(re.findall(r"(\w+): (\w+)", mode)), mode.partition(",")[0]
    return {name: state for name, state in named.items() if name != "feet"} or {"": word.replace("flight", "off")}


def closed(mode):
    """Names of the contacts on the ground in a mode."""
    return [name for name, state in states_of(mode).items() if state != "off"]


def locked(mode):
    """Names of the stops that are locked in a mode."""
    return re.findall(r"(\w+) locked", mode)


def without_influence(data, mode):
    """The coordinates of massless contacts that are off: they keep their values, whatever forces act on them."""
    contacts = data["statement"].get("contacts", {}).items()
    return [key for name, contact in contacts if name not in closed(mode) for key in contact.get("places", ())]


def directions(data, arc, names, stops, t, z):
    """Derivatives of velocities of contacts, two each, and of gap rates of stops by the rates, shape (k, n_q, m)."""
    statement, states = data["statement"], list(data["statement"]["states"])
    coordinates = list(statement["coordinates"])
    D, still = np.zeros((2 * len(names) + len(stops), len(coordinates), t.size)), z.astype(complex)
    still[len(states) // 2 :] = 0
    contacts = statement.get("contacts", {})
    velocities = stated(data, arc, [text for name in names if name for text in contacts[name]["velocity"]])
    gaps = stated(data, arc, [statement["further_parts"]["stops"][name] for name in stops])
    for k, name in enumerate(coordinates):
        if f"d{name}" not in states:
            continue
        moving, moved = still.real.copy(), still.copy()
        moving[states.index(f"d{name}")] = 1
        moved[states.index(name)] += SMALL * 1j
        D[2 * len(names) :, k] = filled(gaps(t, moved), t).imag / SMALL if stops else 0
        if contacts and names:  # velocities are linear in the rates
            D[: 2 * len(names), k] = filled(velocities(t, moving), t)
    if not contacts:  # the foot is (x, y)
        D[: 2 * len(names), -2:] = np.eye(2)[: 2 * len(names), :, None]
    return D


def balance(D, laws, needed, drag):
    """Forces that balance the needed ones along D and satisfy the laws of slip, and directions that change neither.

    Returns
    -------
    forces (k, m), rest of the needed forces (n_q, m), rest of the laws (j, m), and a basis of the directions (k, i, m)
    """
    forces, free = np.zeros(D.shape[::2]), []
    for k in range(D.shape[2]):
        A = np.vstack([D[:, :, k].T, laws[:, :, k]])
        forces[:, k] = np.linalg.lstsq(A, np.append(needed[:, k], drag[:, k]), rcond=STEP)[0]
        if len(D):
            _, sizes, V = np.linalg.svd(A, full_matrices=True)
            free.append(V[int((sizes > STEP * sizes[0]).sum()) :].T)
    rest = needed - np.einsum("kqm,km->qm", D, forces)
    return (
        forces,
        rest,
        np.einsum("jkm,km->jm", laws, forces) - drag,
        np.array(free).transpose(1, 2, 0) if free else None,
    )


def laws_of(states, names, count, kinetic, static):
    """The laws of slip, f_t + s mu f_n, and the margins of the contacts, as rows that multiply forces (j, k, m).

    Parameters
    ----------
    states : state by contact; None if it is not known.
    count : number k of forces, of which the first ones are those of the contacts in ``names``.
    kinetic, static : coefficients by contact, shape (m,) each.
    """
    laws, margins, m = [], [], next(iter(static.values())).size if static else 0
    for k, name in enumerate(names):
        along, normal = np.zeros((2, count, m))
        along[2 * k], normal[2 * k + 1] = 1, 1
        direction = DIRECTIONS.get(states[name], 0)
        margins.append(normal)
        if direction:
            laws.append(along + direction * kinetic[name] * normal)
        else:
            margins += [static[name] * normal - along, static[name] * normal + along]
    return np.reshape(laws, (len(laws), count, m)), np.reshape(margins, (len(margins), count, m))


def smallest(margins, forces, free):
    """The smallest margin along an arc; undetermined forces are those with the largest of the smallest margins."""
    values = np.einsum("jkm,km->jm", margins, forces)
    if free is None or not free.shape[1]:
        return np.min(values, initial=np.inf)
    worst, size = np.inf, np.max(np.abs(forces)) or 1.0
    for k in range(0, values.shape[1], SPARSE):
        slopes = margins[:, :, k] @ free[:, :, k]
        A = np.hstack([-slopes, np.ones((len(slopes), 1))])
        limits = [(None, None)] * slopes.shape[1] + [(None, 1.0)]
        best = linprog([0.0] * slopes.shape[1] + [-1.0], A, values[:, k] / size, bounds=limits)
        worst = min(worst, -best.fun * size if best.success else -np.inf)
    return worst


def by_contact(data, names, forces, free):
    """(f_t, f_n) of all contacts, shape (2 n, m): zero if a contact is off, NaN if it is undetermined."""
    order, pairs = list(data["statement"].get("contacts", {})) or [""], np.zeros((forces.shape[1], 2))
    found = np.zeros((2 * len(order), forces.shape[1]))
    if free is not None and free.shape[1]:
        forces = np.where(np.max(np.abs(free), axis=(1, 2))[:, None] > STEP, np.nan, forces)
    for k, name in enumerate(names):
        pairs = forces[2 * k : 2 * k + 2]
        found[2 * order.index(name) : 2 * order.index(name) + 2] = pairs
    return found


def coefficients(data, arc, t, z):
    """Static, kinetic and viscous coefficient by contact, shape (m,) each."""
    friction = data["statement"]["friction"]
    laws = friction if data["statement"].get("contacts") else {"": friction}
    values = filled(stated(data, arc, [[law[kind] for kind in KINDS] for law in laws.values()])(t, z), t)
    return {kind: dict(zip(laws, values[:, k], strict=True)) for k, kind in enumerate(KINDS)}


def forces(data, arc, t, z):
    """Forces of all contacts, unbalanced rest, torques, size of the forces, and smallest margins along an arc."""
    statement, states, mode = data["statement"], list(data["statement"]["states"]), arc["mode"]
    coordinates, of, names = list(statement["coordinates"]), states_of(mode), closed(mode)
    texts = [statement["equations"][name] for name in ("M", "h", "E")]
    springs = [force for state, force in statement["further_parts"]["springs"].items() if acts(state, mode)]
    values = stated(data, arc, [*texts, statement["control"]["torques"][mode], springs])(t, z)
    M, h, E, u, springs = (filled(entry, t) for entry in values)
    rates = dict(zip(states, arc["rates"](t, z), strict=True))
    ddq = filled(tuple(rates.get(f"d{name}", 0.0) for name in coordinates), t)
    needed = np.einsum("ijm,jm->im", M, ddq) + h + (springs.sum(axis=0) if len(springs) else 0.0)
    needed = needed - np.einsum("ijm,jm->im", E.reshape(*E.shape[:2], -1), u) if len(u) else needed
    needed[[coordinates.index(name) for name in without_influence(data, mode)]] = 0
    mu, D = coefficients(data, arc, t, z), directions(data, arc, names, locked(mode), t, z)
    dq = filled(tuple(z[states.index(f"d{name}")] if f"d{name}" in states else 0.0 for name in coordinates), t)
    v_t = dict(zip(names, np.einsum("kqm,qm->km", D, dq)[: 2 * len(names) : 2], strict=True))
    sliding = [name for name in names if DIRECTIONS[of[name]]]
    drag = np.array([-mu["viscous"][name] * v_t[name] for name in sliding]).reshape(-1, t.size)
    laws, margins = laws_of(of, names, len(D), mu["kinetic"], mu["static"])
    force, rest, broken, free = balance(D, laws, needed, drag)
    size = np.max(np.abs(h))
    least = [smallest(margins, force, free) / size, -np.max(np.abs(broken), initial=0.0) / size]
    least += [np.min(DIRECTIONS[of[name]] * v_t[name]) for name in names]
    return by_contact(data, names, force, free), rest, u, size, least


def acts(state, mode):
    """Whether a spring acts in a mode: while a foot or contact is on the ground, or in a state of a stop or switch."""
    return state in closed(mode) or (state == "contact" and closed(mode) != []) or state in mode.split(", ")


def landing(data, arc, event):
    """Impulses of all contacts, unbalanced rest and smallest margin of the impact at the end of an arc.

    Locked stops, and those that lock, have impulses, too. A foot without mass lands without an impulse; the rest is
    then that of the momenta and places of the bodies. A massless contact has its ``places`` just after its landing.
    """
    statement, states, t = data["statement"], list(data["statement"]["states"]), np.array([arc["end"]])
    names, contacts = list(statement["coordinates"]), statement.get("contacts", {})
    at = {when: arc[when][:, None] for when in ("before", "after")}
    dq = {when: np.array([z[states.index(f"d{name}")][0] if f"d{name}" in states else 0.0 for name in names])
          for when, z in at.items()}  # fmt: skip
    of, before, swaps = states_of(event["impact"]), closed(arc["mode"]), swaps_feet(data, arc)
    texts = [statement["equations"][name] for name in ("M", "swing_jacobian", "relabel_jacobian", "swing_foot")]
    values = stated(data, arc, texts if swaps else texts[:1])(t, at["before"])
    M, S, R, foot = (*(filled(value, t)[..., 0] for value in values), None, None, None)[:4]
    n, lands = len(names) - 2, not contacts and swaps
    if lands and np.linalg.matrix_rank(M) < len(M):
        none, rest = np.zeros((2, 1)), moved_bodies(data, arc, foot[0])
        return none, rest, 0.0
    plus = dq["after"]
    if swaps:
        shape = np.linalg.solve(R, plus[:n])
        plus = np.append(shape, np.linalg.solve(S[:, n:], plus[n:] - S[:, :n] @ shape))
    if swaps and contacts:
        if data["format"] == FIRST_FORMAT:  # which does not tell the partners
            of = {name: None for name in contacts if any(event["impulse"][f"F_{way}.{name}"] for way in "tn")}
        else:
            of = {contacts[name]["partner"] or name: state for name, state in of.items()}
    struck, stops = [name for name, state in of.items() if state != "off"], locked(arc["mode"])
    stops += [name for name in locked(event["to"]) if name not in stops]
    D = directions(data, arc, struck, stops, t, at["before"])
    leaving = directions(data, arc, before, [], t, at["before"])
    if lands:
        D[:2] = S[:, :, None]
    elif not contacts:
        leaving = leaving[:0]
    push = np.zeros(len(names))
    if LANDS.match(event["what"]):
        for name, impulse in statement["further_parts"]["push"].items():
            if name in before or (not contacts and before):
                k = 2 * before.index(name if contacts else "")
                push += leaving[k : k + 2, :, 0].T @ filled(stated(data, arc, impulse)(t, at["before"]), t)[:, 0]
    mu = coefficients(data, arc, t, at["before"])
    if statement["impact_law"] == "frictionless":
        mu["kinetic"] |= {name: 0 * mu["kinetic"][name] for name in struck if name not in before or lands}
    laws, margins = laws_of(of, struck, len(D), mu["kinetic"], mu["static"])
    change = (M @ (plus - dq["before"]) - push)[:, None]
    impulse, rest, broken, free = balance(D, laws, change, np.zeros((len(laws), 1)))
    size, v = np.max(np.abs(M @ dq["before"])) or 1.0, D[:, :, 0] @ plus
    least = [smallest(margins, impulse, free) / size, -np.max(np.abs(broken), initial=0.0) / size]
    least += [-abs(v[2 * k + 1]) for k in range(len(struck))]
    for k, name in enumerate(struck):
        direction = DIRECTIONS.get(of[name])
        least.append(0.0 if direction is None else direction * v[2 * k] if direction else -abs(v[2 * k]))
    back = {name: partner for name in struck if swaps and contacts and (partner := contacts[name].get("partner"))}
    for name in (name for name in struck if name not in before and contacts.get(name, {}).get("places")):
        placed = stated(data, arc, [*contacts[name]["places"].values()])(t, at["before"])
        own = [states.index(key) for key in contacts[back.get(name, name)]["places"]]  # after the feet have swapped
        least += (-np.abs(at["after"][own, 0] - filled(placed, t)[:, 0])).tolist()
    off = [k for k, name in enumerate(before) if name not in struck or lands][: len(leaving) // 2]
    least += [leaving[2 * k + 1, :, 0] @ plus for k in off]
    return by_contact(data, struck, impulse, free), rest[:, 0] / size, min(least)


def moved_bodies(data, arc, foot):
    """Differences of the momenta and places of the bodies before and after the landing of a foot at x = ``foot``."""
    found, n = [], len(arc["before"]) // 2
    for when, shift in (("before", 0.0), ("after", foot - arc["after"][list(data["statement"]["states"]).index("x")])):
        z = arc[when]
        for body in data["statement"]["bodies"]:
            (mass,) = stated(data, arc, [body["mass"]])(arc["end"], z)
            place, slopes, _ = derivative(stated(data, arc, body["position"]), arc["end"], z)
            found += [place[0] + shift, place[1], *(mass * slopes[:, :n] @ z[n:])]
    return np.subtract(*np.split(np.array(found), 2))


def swaps_feet(data, arc):
    """Whether the feet swap roles at the end of an arc."""
    return arc.get("swaps", arc["ends_step"] and arc["ends_with"] != "clock")


def guards(data):
    """The expressions that are zero at an event, by its name."""
    statement = data["statement"]
    gaps = {
        f"gap.{name}": contact["gap"] for name, contact in statement.get("contacts", {}).items() if "gap" in contact
    }
    ends = statement.get("cycle_end", {"event": "touchdown", "margin": None})
    section = {ends["event"]: ends["margin"]} if ends["margin"] else {}
    further = statement["further_parts"]["stops"] | statement["further_parts"]["switches"]
    return {"touchdown": statement["equations"]["touchdown"]} | gaps | section | further


def smallest_margins(data, arc):
    """The smallest value of every condition that an arc must satisfy, relative to the size of its terms."""
    statement, mode, t = data["statement"], arc["mode"], np.linspace(arc["start"], arc["end"], POINTS)
    z = arc["path"](t)[: len(statement["states"])]
    yield from forces(data, arc, t, z)[-1]
    of_guards, guard = guards(data), arc["ends_with"]
    held = [name for name in of_guards if f"{name} free" in mode or f"{name} off" in mode]
    held += [f"gap.{name}" for name, state in states_of(mode).items() if state == "off"]
    for name, text in of_guards.items():
        margin = np.broadcast_to(stated(data, arc, [text])(t, z)[0], t.shape)
        size = np.max(np.abs(margin)) or 1.0
        if name in held:  # a contact that has left may touch until its gap has been positive
            above = np.flatnonzero(margin > STEP * size)[:1] if name.startswith("gap.") else [0]
            yield from (np.min(margin[k:]) / size for k in above)
        if name == guard:
            yield -abs(margin[-1]) / size


def touches_earlier(data, arcs):
    """By how much the swing foot touches the ground before it lands, after it has been above it."""
    ends = [k for k, arc in enumerate(arcs) if swaps_feet(data, arc)]
    if "contacts" in data["statement"] or not ends:
        return 0.0
    largest, heights = 0.0, np.zeros(0)
    for arc in (*arcs[ends[-1] + 1 :], *arcs[: ends[-1] + 1]):  # from one landing to the next
        t = np.linspace(arc["start"], arc["end"], POINTS)
        z = arc["path"](t)[: len(data["statement"]["states"])]
        rising = stated(data, arc, [data["statement"]["equations"]["touchdown"]])(t, z)[0]
        heights = np.append(heights, np.broadcast_to(rising, t.shape))
        if swaps_feet(data, arc):
            size = np.max(np.abs(heights))
            above = np.flatnonzero(heights < -STEP * size)
            largest = max(largest, np.inf if not above.size else np.max(heights[above[0] :]) / size)
            heights = np.zeros(0)
    return largest


def judge(data):
    """The largest difference of every group of numbers; infinite where numbers are missing or words differ."""
    arcs, _, found = recompute(data)
    statement, orbit, n = data["statement"], data["orbit"], len(data["statement"]["states"])
    errors = dict.fromkeys(LIMITS, 0.0)

    def compare(group, stated, true, unit=1.0):
        stated, true = (np.array(numbers, dtype=float) for numbers in (stated, true))  # NaN if there is no number
        if stated.shape != true.shape or (np.isnan(stated) != np.isnan(true)).any():
            errors[group] = np.inf
        else:
            error = np.max(np.abs(stated - true)[~np.isnan(true)] / unit, initial=0.0)
            errors[group] = max(errors[group], float(error))

    def same(group, stated, true):
        errors[group] = errors[group] if stated == true else np.inf

    for entry in statement["parameters"].values():
        number, _, unit = str(entry["exact"]).partition(" ")
        value = np.deg2rad(float(number)) if unit == "deg" else float(number)
        compare("parameters", entry["value"], value, abs(value) or 1.0)
    compare("initial state", [entry["value"] for entry in orbit["initial_state"].values()], arcs[-1]["after"])

    begins = np.cumsum([0.0, *(arc["end"] for arc in arcs if arc["ends_step"])])
    steps = np.cumsum([0, *(arc["ends_step"] for arc in arcs)])[:-1]  # of each arc
    phases = [(begins[k], k, arc) for k, arc in zip(steps, arcs, strict=True) if arc["ends_with"] is not None]
    times = np.array([began + arc["end"] for began, _, arc in phases])
    begun = [arc["mode"] for _, _, arc in (*phases[1:], phases[0])]
    ends = "end of step", "end of cycle"
    next_modes = [
        mode if not arc["ends_step"] else "impact" if swaps_feet(data, arc) else ends[arc is arcs[-1]]
        for (_, _, arc), mode in zip(phases, begun, strict=True)
    ]
    compare("period", orbit["period"]["value"], begins[-1])
    same("ends of phases", orbit["n_steps"], len(begins) - 1)
    compare("ends of phases", [phase["duration"]["value"] for phase in orbit["phases"]], np.diff([0.0, *times]))
    compare("ends of phases", [event["time"] for event in orbit["events"]], times)
    compare("ends of phases", [arc["end"] for arc in data["evaluation"]["arcs"]], [arc["end"] for arc in arcs])
    words = [(int(k) + 1, arc["mode"], arc["ends_with"]) for _, k, arc in phases]
    same("ends of phases", [(phase["step"], phase["mode"], phase["ends_with"]) for phase in orbit["phases"]], words)
    same("events", [(event["step"], event["from"], event["what"]) for event in orbit["events"]], words)
    same("events", [event["to"] for event in orbit["events"]], next_modes)
    if "cycle_end" in statement:
        event, period = statement["cycle_end"]["event"], statement["cycle_end"]["period"]
        last = [arc for arc in arcs if arc["ends_step"]]
        found_ends = {"touchdown" if swaps_feet(data, arc) else arc["ends_with"] for arc in last}
        same("ends of phases", found_ends, {event})
        compare("ends of phases", np.diff(begins) if period else [], [period] * (len(begins) - 1) if period else [])
    lengths, x = [], list(statement["states"]).index("x")
    for event, (_, _, arc) in zip(orbit["events"], phases, strict=False):
        compare("events", list(event["state_before"].values()), arc["before"])
        strikes = LANDS.match(event["what"]) or event["what"] in statement["further_parts"]["stops"]
        if strikes and (arc["ends_step"] or data["format"] != FIRST_FORMAT):
            impulse, rest, margin = landing(data, arc, event)
            errors["margins"] = max(errors["margins"], -margin)
            compare("events", list(event["impulse"].values()), impulse[:, 0])
            compare("equations", rest, 0 * rest)
        elif not strikes:
            same("events", {"impact", "impulse"} & set(event), set())
            kept = arc["before"] - arc["after"]
            kept[x] *= not arc["ends_step"]
            compare("events", kept, 0 * kept)
        same("events", "state_after" in event, arc["ends_step"] or "impact" in event)
        if "state_after" in event:
            compare("events", list(event["state_after"].values()), arc["after"])
        if arc["ends_step"]:
            foot = stated_foot(data, arc) if swaps_feet(data, arc) else arc["before"][x]
            lengths.append(foot)
            compare("events", [event["step_length"], arc["after"][x]], [foot, 0.0])
    compare("scalars", orbit["scalars"]["step_length"]["value"], sum(lengths), max(1.0, abs(sum(lengths))))
    compare("scalars", orbit["scalars"]["speed"]["value"], sum(lengths) / begins[-1], max(1.0, abs(sum(lengths))))

    columns, rows = orbit["samples"]["columns"], orbit["samples"]["rows"]
    splits = np.flatnonzero(np.diff([row[0] for row in rows]) < STEP * STEP) + 1
    groups = [rows[a:b] for a, b in zip([0, *splits], [*splits, len(rows)], strict=True)]
    same("samples", len(groups), len(arcs))
    for group, k, arc in zip(groups, steps, arcs, strict=False):
        errors["margins"] = max(errors["margins"], -min(smallest_margins(data, arc), default=0.0))
        t, z = np.array([row[0] for row in group]) - begins[k], np.array([row[2 : 2 + n] for row in group]).T
        same("samples", {row[1] for row in group}, {arc["mode"]})
        compare("samples", z, arc["path"](t)[:n])
        force, rest, u, size, _ = forces(data, arc, t, z)
        true = np.vstack([force, u]) if len(u) else force
        compare("samples", np.array([row[2 + n :] for row in group], dtype=float).T, true, size)
        compare("equations", rest, 0 * rest, size)
    same("samples", columns[: 2 + n], ["t", "mode", *statement["states"]])
    errors["margins"] = max(errors["margins"], touches_earlier(data, arcs))

    listed = np.array([complex(entry["re"], entry["im"]) for entry in orbit["multipliers"]])
    if listed.size == found.size:
        distances = np.abs(listed[:, None] - found) / np.maximum(1.0, np.abs(found))
        pairs = linear_sum_assignment(distances)
        compare("multipliers", distances[pairs], np.zeros(listed.size))
    same("multipliers", listed.size, found.size)
    radius = float(np.max(np.abs(found)))
    compare("multipliers", orbit["spectral_radius"]["value"], radius, max(1.0, radius))
    same("multipliers", orbit["stable"], radius < 1)
    errors["enclosures"] = max(map(outside, enclosed(orbit)), default=0.0)
    return errors


def stated_foot(data, arc):
    """Where along the ground the foot lands that the walker stands on next."""
    return stated(data, arc, data["statement"]["equations"]["swing_foot"])(arc["end"], arc["before"])[0]


def enclosed(entry):
    """All values with their lower and upper bounds in an orbit."""
    if isinstance(entry, dict):
        bounds = entry.get("enclosure")
        names = {"re": "re", "im": "im"} if isinstance(bounds, dict) else {"value": None}
        for name, part in names.items() if bounds else ():
            yield entry[name], *map(float, bounds if part is None else bounds[part])
    for each in entry.values() if isinstance(entry, dict) else entry if isinstance(entry, list) else ():
        yield from enclosed(each)


def outside(entry):
    """By how much a value lies outside of its bounds, relative to its size if that exceeds one."""
    value, lower, upper = entry
    return max(lower - value, value - upper, 0.0 if lower <= upper else np.inf) / max(1.0, abs(value))


def main(files):
    """Judge the orbits in some files; 1 if a number differs."""
    code = 0
    for file in files:
        try:
            errors = judge(json.loads(Path(file).read_text()))
        except (OSError, ValueError, KeyError, TypeError) as error:
            print(f"{file}: DIFFERS: {type(error).__name__}: {error}")
            code = 1
            continue
        wrong = [group for group, error in errors.items() if not error <= LIMITS[group]]
        print(f"{file}: {'DIFFERS in ' + ', '.join(wrong) if wrong else 'agrees'}")
        for group, error in errors.items():
            print(f"  {group:16} {error:8.1e}   limit {LIMITS[group]:.0e}")
        code = 1 if wrong else code
    return code


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    sys.exit(main(sys.argv[1:]))
