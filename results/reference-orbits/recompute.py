"""Recompute an orbit from its JSON file with numpy and scipy alone: python recompute.py compass-passive-a.json"""

import ast
import json
import sys
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

ARITHMETIC = (ast.Module, ast.Assign, ast.Name, ast.List, ast.BinOp, ast.UnaryOp, ast.Call, ast.Constant)
ARITHMETIC += (ast.expr_context, ast.operator, ast.unaryop)
FUNCTIONS = {f.__name__: f for f in (np.sin, np.cos, np.tan, np.tanh, np.sqrt, np.exp, np.log, np.abs)} | {
    "asin": np.arcsin, "acos": np.arccos, "atan": np.arctan, "atan2": np.arctan2, "abs": np.abs
}  # fmt: skip
SIGN = {"stick": 0, "slip_forward": 1, "slip_backward": -1}


def recompute(data):
    """Times at which the phases end, and state (q, dq) after each impact."""
    s, orbit = data["statement"], data["orbit"]
    if any(s["further_parts"].values()) or any(phase["mode"] not in SIGN for phase in orbit["phases"]):
        raise ValueError(f"{data['name']}: stops, switches, springs, push-offs and flight need a longer program")
    torques = {f"u_{mode}": u for mode, u in s["control"]["torques"].items()}
    formulas = [*s["definitions"], *(s["equations"] | s["friction"] | torques).items()]
    tree = ast.parse("\n".join(f"{name} = {text}".replace("'", "") for name, text in formulas))
    if not all(isinstance(node, ARITHMETIC) for node in ast.walk(tree)):
        raise ValueError(f"{data['name']}: a formula is not arithmetic")
    code, states, n = compile(tree, data["name"], "exec"), [*s["states"]], len(s["states"]) // 2 - 1
    p = {name: entry["value"] for name, entry in s["parameters"].items()}

    def at(t, z, r=()):
        """All expressions at a time and a state."""
        names = (
            FUNCTIONS
            | p
            | dict(zip(states, z, strict=True))
            | {"t": t, "y": 0.0}
            | {f"r{k}": v for k, v in enumerate(r)}
        )
        exec(code, {"__builtins__": {}}, names)  # noqa: S102 - checked above to be arithmetic
        return {name: np.array(names[name], dtype=float) for name, _ in formulas[len(s["definitions"]) :]}

    def motion(t, z, mode, r):
        """Accelerations (shape, x) and force (f_t, f_n), from the equations of motion and the law of friction."""
        e, A = at(t, z, r), np.zeros((n + 3, n + 3))
        A[: n + 2, : n + 1], A[n, n + 1], A[n + 1, n + 2] = e["M"][:, : n + 1], -1, -1
        A[n + 2, n if mode == "stick" else n + 1] = 1
        A[n + 2, n + 2] = SIGN[mode] * e["kinetic"]
        drag = 0 if mode == "stick" else -e["viscous"] * z[-1]
        return np.linalg.solve(A, [*(e["E"].reshape(n + 2, -1) @ e[f"u_{mode}"] - e["h"]), drag]), e

    def rates(t, z, mode, r):
        return np.array([*z[n + 1 :], *motion(t, z, mode, r)[0][: n + 1]])

    def guard(t, path, mode, r, name):
        """What is zero at the end of a phase."""
        z = path(t)
        (*_, f_t, f_n), e = motion(t, z, mode, r)
        cones = {"cone_forward": e["static"] * f_n + f_t, "cone_backward": e["static"] * f_n - f_t}
        return float({"touchdown": e["touchdown"], "slip_velocity": z[-1], **cones}[name])

    def impact(t, z, mode):
        """The state after an impact, the feet having swapped roles."""
        e, A = at(t, z, s["control"]["segments"][0]["r"]), np.zeros((n + 4, n + 4))
        S, dq = e["swing_jacobian"], np.array([*z[n + 1 :], 0.0])
        A[: n + 2, : n + 2], A[: n + 2, n + 2 :], A[n + 2, : n + 2] = e["M"], -S.T, S[1]
        A[n + 3] = [*S[0], 0, 0] if mode == "stick" else [0] * (n + 2) + [1, SIGN[mode] * e["kinetic"]]
        if mode != "stick" and s["impact_law"] == "frictionless":
            A[n + 3, n + 3] = 0
        dq_plus = np.linalg.solve(A, [*(e["M"] @ dq), 0, 0])[: n + 2]
        return np.array([*e["relabel"], 0, *(e["relabel_jacobian"] @ dq_plus[:n]), S[0] @ dq_plus])

    z = np.array([entry["value"] for entry in orbit["initial_state"].values()])
    t, times, after = 0.0, [], []
    impacts = iter([event["impact"] for event in orbit["events"] if event["to"] == "impact"])
    for phase in orbit["phases"]:
        mode, end, step = phase["mode"], t + phase["duration"]["value"], 0.01 * phase["duration"]["value"]
        pieces = [k for k in s["control"]["segments"] if (k["end"] or np.inf) > t and k["start"] < end]
        for piece in pieces:
            last = piece is pieces[-1]
            span = t, end + step if last else piece["end"]
            args, tolerance = (mode, piece["r"]), {"rtol": 1e-11, "atol": 1e-13}
            found = solve_ivp(rates, span, z, "DOP853", dense_output=True, args=args, **tolerance)
            t, z = found.t[-1], found.y[:, -1]
        t = brentq(guard, end - step, end + step, args=(found.sol, *args, phase["ends_with"]))
        z = found.sol(t)
        times.append(t)
        if phase["ends_with"] == "touchdown":
            t, z = 0.0, impact(t, z, next(impacts))
            after.append(z)
            swapped = {**s["exchanged"], **{b: a for a, b in s["exchanged"].items()}}
            p = p | {a: p[b] for a, b in swapped.items()}
    return np.array(times), np.array(after)


if __name__ == "__main__":
    data = json.loads(Path(sys.argv[1]).read_text())
    times, after = recompute(data)
    start = [entry["value"] for entry in data["orbit"]["initial_state"].values()]
    print("phases end at", *times, "s after the last impact")
    print("state after one cycle less initial state:", np.abs(after[-1] - start).max())
