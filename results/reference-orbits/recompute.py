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
from scipy.optimize import brentq, linear_sum_assignment

ARITHMETIC = re.compile(r"([A-Za-z]\w*|\d+\.?\d*(e[+-]?\d+)?|[-+*/(), ])+")
FUNCTIONS = {name: getattr(np, name) for name in ("sin", "cos", "tan", "tanh", "sqrt", "exp", "log")}
FUNCTIONS |= {"asin": np.arcsin, "acos": np.arccos, "atan": np.arctan, "abs": lambda x: np.where(np.real(x) < 0, -x, x)}
FUNCTIONS["max"] = lambda x, y: np.where(np.real(x) > np.real(y), x, y)
FUNCTIONS |= {
    "atan2": lambda y, x: np.arctan2(np.real(y), np.real(x)) + 1j * np.imag(y / x) / (1 + np.real(y / x) ** 2)
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


def function(data, definitions, texts, parameters, r=()):
    """(t, z) -> values of nested lists of texts; the entries of z may be arrays."""
    states = list(data["statement"]["states"])

    def joined(entry):
        return f"({''.join(f'{joined(each)}, ' for each in entry)})" if isinstance(entry, list) else entry

    lines = [*definitions, ("values", joined(texts))]
    for name, text in lines:
        if not ARITHMETIC.fullmatch(f"{name} {text}"):
            raise ValueError(f"{data['name']}: {text[:40]!r} is not arithmetic")
    code = compile("\n".join(f"{name} = {text}" for name, text in lines), data["name"], "exec")
    constants = FUNCTIONS | parameters | {f"r{k}": value for k, value in enumerate(r)}

    def evaluate(t, z):
        names = constants | {"t": t, "y": 0.0, "dy": 0.0} | dict(zip(states, z, strict=True))
        exec(code, {"__builtins__": {}}, names)  # noqa: S102 - arithmetic
        return names["values"]

    return evaluate


def derivative(values, t, z):
    """The vector values(t, z), its derivative by z, and that by t; shapes (m,), (m, n) and (m,)."""
    moved = np.hstack([z[:, None] + SMALL * 1j * np.eye(z.size), z[:, None]])
    times = t + SMALL * 1j * (np.arange(z.size + 1) == z.size)
    found = np.array([np.broadcast_to(row, z.size + 1) for row in values(times, moved)], dtype=complex)
    slopes = found.imag / SMALL
    return found.real[:, 0], slopes[:, :-1], slopes[:, -1]


def recompute(data):
    """The arcs of one cycle, the derivative of the return map, and the multipliers.

    Deviations follow the variational equations along an arc. At an event they jump, because its time moves with them.
    """
    evaluation, z = data["evaluation"], np.array([entry["value"] for entry in data["orbit"]["initial_state"].values()])
    parameters = {name: entry["value"] for name, entry in data["statement"]["parameters"].items()}
    arcs, n, Phi = [], z.size, np.eye(z.size)
    for number, arc in enumerate(evaluation["arcs"]):
        block, p, guard = evaluation["modes"][arc["mode"]], dict(parameters), arc["ends_with"]
        guard = guard if guard in block["margins"] else None  # others have a fixed time
        rates = function(data, block["definitions"], block["rates"], p, arc["r"])

        def variational(t, y, rates=rates):
            f, slope, _ = derivative(rates, t, y[:n])
            return np.append(f, slope @ y[n:].reshape(n, n))

        end, slack = arc["end"], SLACK * (arc["end"] - arc["start"]) * (guard is not None)
        solved = solve_ivp(
            variational, (arc["start"], end + slack), np.append(z, Phi), "DOP853", dense_output=True, **ACCURACY
        )
        path = solved.sol
        if guard is not None:
            margin = function(data, block["definitions"], [block["margins"][guard]], p, arc["r"])

            def along(t, path=path, margin=margin):
                return margin(t, path(t)[:n])[0]

            if not solved.success or not along(end - slack) > 0 > along(end + slack):
                raise ValueError(f"{guard} does not fall to zero at {end:.9g} s in {arc['mode']}")
            end = brentq(along, end - slack, end + slack, xtol=1e-15)
        before, Phi = path(end)[:n], path(end)[n:].reshape(n, n)
        after, jump = before, np.eye(n)
        if arc["reset"]:
            reset = evaluation["resets"][arc["reset"]]
            after, jump, _ = derivative(function(data, reset["definitions"], reset["state"], p), end, before)
        if guard is not None:
            _, slope, of_time = derivative(margin, end, before)
            f = np.array(rates(end, before), dtype=float)
            earlier = slope[0] / (slope[0] @ f + of_time[0])  # by this much the event is earlier
            jump = jump - np.outer(jump @ f, earlier)
            if not arc["ends_step"]:
                following = evaluation["arcs"][number + 1]
                block = evaluation["modes"][following["mode"]]
                later = function(data, block["definitions"], block["rates"], p, following["r"])
                jump = jump + np.outer(later(end, after), earlier)
        arcs.append(
            {**arc, "end": end, "path": path, "rates": rates, "parameters": p, "before": before, "after": after}
        )
        z, Phi = after, jump @ Phi
        if arc["ends_step"]:
            parameters |= {a: p[b] for pair in data["statement"]["exchanged"].items() for a, b in (pair, pair[::-1])}
    return arcs, Phi, multipliers(data, arcs[-1], Phi, jump)


def multipliers(data, arc, Phi, jump):
    """Eigenvalues of the return map's derivative on the section, to which the last ``jump`` leads from ``arc``."""
    z, t, stops = arc["before"], arc["end"], data["statement"]["further_parts"]["stops"]
    n, rows = z.size, []
    for name in (name for name in stops if f"{name} locked" in arc["mode"]):
        gap = function(data, data["statement"]["definitions"], [stops[name]], arc["parameters"], arc["r"])

        def rate(z, gap=gap):
            return derivative(gap, t, z)[1][0, : n // 2] @ z[n // 2 :]

        moves = STEP * np.eye(n)
        rows += [derivative(gap, t, z)[1][0], [(rate(z + move) - rate(z - move)) / (2 * STEP) for move in moves]]
    for name, (position, velocity) in touching(data, arc).items():
        height, moving = (derivative(each, t, z)[1] for each in (position, velocity))
        rows += [height[1], moving[1], *([moving[0]] if states_of(arc["mode"])[name] == "stick" else [])]
    free = np.linalg.svd(np.array(rows).reshape(-1, n))[2][len(rows) :].T  # directions in which the last mode can move
    section, sizes, _ = np.linalg.svd(jump @ free)
    section = section[:, : int((sizes > STEP * sizes[0]).sum())]
    return np.linalg.eigvals(section.T @ Phi @ section)


def states_of(mode):
    """The states of named contacts in a mode."""
    return dict(re.findall(r"(\w+): (\w+)", mode))


def touching(data, arc):
    """Functions (t, z) of position and velocity of every contact on the ground by name, if a walker has several."""
    statement = data["statement"]
    return {
        name: [
            function(data, statement["definitions"], point[what], arc["parameters"], arc["r"])
            for what in ("position", "velocity")
        ]
        for name, point in statement.get("contacts", {}).items()
        if states_of(arc["mode"]).get(name) != "off"
    }


def contact_jacobians(data, arc, names, t, z):
    """Jacobians (2, n_q) of contacts by name, with columns in the order of the coordinates."""
    statement, found = data["statement"], {}
    order = [list(statement["states"]).index(f"d{name}") for name in statement["coordinates"]]
    for name in names:
        texts = statement["contacts"][name]["velocity"]
        velocity = function(data, statement["definitions"], texts, arc["parameters"], arc["r"])
        found[name] = derivative(velocity, t, z)[1][:, order]
    return found


def forces(data, arc):
    """(t, z) -> contact force (f_t, f_n), unbalanced rest of the equations of motion, friction, size of the forces."""
    statement, names = data["statement"], list(data["statement"]["coordinates"])
    equations, friction, states = statement["equations"], statement["friction"], list(statement["states"])
    texts = [*(equations[name] for name in ("M", "h", "E")), statement["control"]["torques"][arc["mode"]]]
    several = list(statement.get("contacts", {}))
    laws = [friction[name] for name in several] or [friction]
    texts = [*texts, [law[name] for law in laws for name in ("static", "kinetic", "viscous")]]
    values = function(data, statement["definitions"], texts, arc["parameters"], arc["r"])

    def shared(t, z, needed):
        """Forces of all contacts, one after the other, and the rest that they do not balance."""
        force, names = np.zeros((2 * len(several), t.size)), list(touching(data, arc))
        for k in range(t.size if names else 0):
            J = contact_jacobians(data, arc, names, t[k], z[:, k])
            G = np.hstack([J[name].T for name in names])
            found = np.linalg.lstsq(G, needed[:, k], rcond=None)[0]
            needed[:, k] -= G @ found
            for j, name in enumerate(names):
                force[2 * several.index(name) : 2 * several.index(name) + 2, k] = found[2 * j : 2 * j + 2]
        return force, needed

    def evaluate(t, z):
        def filled(entry):
            return np.array(
                [filled(each) if isinstance(each, tuple) else np.broadcast_to(each, t.shape) for each in entry]
            )

        M, h, E, u, mu = (filled(entry) for entry in values(t, z))
        rates = dict(zip(states, arc["rates"](t, z), strict=True))
        ddq = filled(tuple(rates.get(f"d{name}", 0.0) for name in names))
        needed = np.einsum("ijm,jm->im", M, ddq) + h
        needed = needed - np.einsum("ijm,jm->im", E.reshape(*E.shape[:2], -1), u) if len(u) else needed
        force, rest = shared(t, z, needed) if several else (needed[-2:], needed[:-2])
        return force, rest, mu, u, np.max(np.abs(h))

    return evaluate


def landing(data, arc, event):
    """Step length, impulse (F_t, F_n), unbalanced rest and smallest margin of the impact at the end of an arc.

    A walker with further parts, which may have impulses of their own, has only the step length.
    """
    statement, equations = data["statement"], data["statement"]["equations"]
    names, states, friction = list(statement["coordinates"]), list(statement["states"]), statement["friction"]
    texts = [equations[name] for name in ("M", "swing_jacobian", "relabel_jacobian", "swing_foot")]
    several = list(statement.get("contacts", {}))
    laws = [friction[name] for name in several] or [friction]
    texts = [*texts, [law[kind] for law in laws for kind in ("static", "kinetic")]]
    values = function(data, statement["definitions"], texts, arc["parameters"], arc["r"])
    M, S, R, foot, coefficients = map(np.array, values(arc["end"], arc["before"]))
    if arc["ends_with"] == "clock":
        return arc["before"][states.index("x")], None, None, 0.0
    if any(statement["further_parts"].values()):
        return foot[0], None, None, 0.0
    before, after = (dict(zip(states, arc[when], strict=True)) for when in ("before", "after"))
    shape = np.linalg.solve(R, [after[f"d{name}"] for name in names[: len(R)]])
    moved = [after["dx"], after.get("dy", 0.0)]
    base = np.linalg.solve(S[:, len(R) :], moved - S[:, : len(R)] @ shape)  # rates of the other foot
    change = M @ (np.append(shape, base) - [before.get(f"d{name}", 0.0) for name in names])
    if several:
        jacobians = contact_jacobians(data, arc, several, arc["end"], arc["before"])
        closed = [k for k, name in enumerate(several) if any(event["impulse"][f"F_{way}.{name}"] for way in "tn")]
        G = np.hstack([jacobians[several[k]].T for k in closed])
        found, impulse = np.linalg.lstsq(G, change, rcond=None)[0], np.zeros(2 * len(several))
        for j, k in enumerate(closed):
            impulse[2 * k : 2 * k + 2] = found[2 * j : 2 * j + 2]
        size = np.max(np.abs(impulse))
        edges = coefficients[::2] * impulse[1::2] - np.abs(impulse[::2])
        slips = edges < STEP * size  # at the edge of the cone, or at rest without an impulse
        return (
            foot[0],
            impulse,
            change - G @ found,
            min(impulse[1::2].min(), np.where(slips, -np.abs(edges), edges).min()) / size,
        )
    static, kinetic = coefficients
    impulse = np.linalg.lstsq(S.T, change, rcond=None)[0]
    F_t, F_n = impulse / np.max(np.abs(impulse))
    direction, kinetic = DIRECTIONS[arc["reset"]], kinetic * (statement["impact_law"] == "coulomb")
    law = -abs(F_t + direction * kinetic * F_n) if direction else static * F_n - abs(F_t)
    return foot[0], impulse, change - S.T @ impulse, min(F_n, base[1], law, direction * after["dx"])


def smallest_margins(data, arc, evaluate):
    """The smallest value of every condition that an arc must satisfy, relative to the size of its terms."""
    statement, mode, t = data["statement"], arc["mode"], np.linspace(arc["start"], arc["end"], POINTS)
    z = arc["path"](t)[: len(statement["states"])]
    if "flight" not in mode:
        force, _, mu, _, size = evaluate(t, z)
        several = touching(data, arc)
        order = list(statement.get("contacts", {}))
        for k, name in enumerate(several or [""]):
            place = order.index(name) if name else k
            (f_t, f_n), (static, kinetic, viscous) = force[2 * place :][:2], mu[3 * place :][:3]
            state = states_of(mode)[name] if name else mode.partition(",")[0]
            direction, speed = DIRECTIONS[state], several[name][1](t, z)[0] if name else z[-1]
            yield np.min(f_n) / size
            yield np.min(direction * speed)
            sliding = f_t + direction * kinetic * f_n + viscous * speed
            yield -np.max(np.abs(sliding)) / size if direction else np.min(static * f_n - np.abs(f_t)) / size
    for kind, state in (("stops", "free"), ("switches", "off")):
        for name, text in statement["further_parts"][kind].items():
            if f"{name} {state}" in mode:
                margin = function(data, statement["definitions"], [text], arc["parameters"], arc["r"])(t, z)[0]
                yield np.min(margin) / np.max(np.abs(margin))


def touches_earlier(data, arcs):
    """By how much the swing foot touches the ground before the end of a step, in which it has been above it."""
    largest, heights = 0.0, np.zeros(0)
    for arc in arcs:
        t = np.linspace(arc["start"], arc["end"], POINTS)
        statement, z = data["statement"], arc["path"](t)[: len(data["statement"]["states"])]
        texts = [statement["equations"]["touchdown"]]
        rising = function(data, statement["definitions"], texts, arc["parameters"], arc["r"])(t, z)[0]
        heights = np.append(heights, np.broadcast_to(rising, t.shape))
        if arc["ends_step"] and "contacts" not in statement:
            size = np.max(np.abs(heights))
            above = np.flatnonzero(heights < -STEP * size)
            largest = max(largest, np.inf if not above.size else np.max(heights[above[0] :]) / size)
            heights = np.zeros(0)
    return largest


def judge(data):
    """The largest difference of every group of numbers; infinite where numbers are missing or words differ."""
    arcs, _, found = recompute(data)
    statement, orbit, n = data["statement"], data["orbit"], len(data["statement"]["states"])
    simple = not any(statement["further_parts"].values())
    errors = dict.fromkeys(LIMITS, 0.0)

    def compare(group, stated, true, unit=1.0):
        comparable = np.shape(stated) == np.shape(true) and not any(entry is None for entry in np.ravel(stated))
        error = np.max(np.abs(np.subtract(stated, true)) / unit, initial=0.0) if comparable else np.inf
        errors[group] = max(errors[group], np.inf if np.isnan(error) else float(error))

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
    ends = {True: "end of cycle", False: "impact"}
    next_modes = [
        ends[arc["ends_with"] == "clock"] if arc["ends_step"] else mode
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
    lengths = []
    for event, (_, _, arc) in zip(orbit["events"], phases, strict=False):
        compare("events", list(event["state_before"].values()), arc["before"])
        if not arc["ends_step"]:
            continue
        same("events", event.get("impact"), arc["reset"] if arc["ends_with"] != "clock" else None)
        compare("events", list(event["state_after"].values()), arc["after"])
        length, impulse, rest, margin = landing(data, arc, event)
        errors["margins"] = max(errors["margins"], -margin)
        lengths.append(length)
        compare("events", event["step_length"], length)
        if impulse is not None:
            compare("events", list(event["impulse"].values()), impulse)
            compare("equations", rest, 0 * rest, np.max(np.abs(impulse)))
    compare("scalars", orbit["scalars"]["step_length"]["value"], sum(lengths), max(1.0, abs(sum(lengths))))
    compare("scalars", orbit["scalars"]["speed"]["value"], sum(lengths) / begins[-1], max(1.0, abs(sum(lengths))))

    columns, rows = orbit["samples"]["columns"], orbit["samples"]["rows"]
    splits = np.flatnonzero(np.diff([row[0] for row in rows]) < STEP * STEP) + 1
    groups = [rows[a:b] for a, b in zip([0, *splits], [*splits, len(rows)], strict=True)]
    same("samples", len(groups), len(arcs))
    for group, k, arc in zip(groups, steps, arcs, strict=False):
        evaluate = forces(data, arc)
        errors["margins"] = max(errors["margins"], -min(smallest_margins(data, arc, evaluate), default=0.0))
        t, z = np.array([row[0] for row in group]) - begins[k], np.array([row[2 : 2 + n] for row in group]).T
        same("samples", {row[1] for row in group}, {arc["mode"]})
        compare("samples", z, arc["path"](t)[:n])
        if "flight" in arc["mode"]:
            continue
        force, rest, _, u, size = evaluate(t, z)
        true = np.vstack([force, u]) if len(u) else force
        compare("samples", np.array([row[2 + n :] for row in group]).T, true, size)
        if simple:
            compare("equations", rest, 0 * rest, size)
    same("samples", columns[: 2 + n], ["t", "mode", *statement["states"]])
    errors["margins"] = max(errors["margins"], touches_earlier(data, arcs))

    stated = np.array([complex(entry["re"], entry["im"]) for entry in orbit["multipliers"]])
    if stated.size == found.size:
        distances = np.abs(stated[:, None] - found) / np.maximum(1.0, np.abs(found))
        pairs = linear_sum_assignment(distances)
        compare("multipliers", distances[pairs], np.zeros(stated.size))
    same("multipliers", stated.size, found.size)
    radius = float(np.max(np.abs(found)))
    compare("multipliers", orbit["spectral_radius"]["value"], radius, max(1.0, radius))
    same("multipliers", orbit["stable"], radius < 1)
    errors["enclosures"] = max(map(outside, enclosed(orbit)), default=0.0)
    return errors


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
