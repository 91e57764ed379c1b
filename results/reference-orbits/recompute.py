"""Recompute an orbit from its JSON file with numpy and scipy alone: python recompute.py compass-passive-a.json"""

import json
import re
import sys
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

ARITHMETIC = re.compile(r"([A-Za-z]\w*|\d+\.?\d*(e[+-]?\d+)?|[-+*/(), ])+")
FUNCTIONS = {name: getattr(np, name) for name in ("sin", "cos", "tan", "tanh", "sqrt", "exp", "log", "abs")}
FUNCTIONS |= {"asin": np.arcsin, "acos": np.arccos, "atan": np.arctan, "atan2": np.arctan2}


def recompute(data):
    """Ends of the phases [s since the last impact], and the state after each step."""
    evaluation, statement, states = data["evaluation"], data["statement"], list(data["statement"]["states"])
    parameters = {name: entry["value"] for name, entry in statement["parameters"].items()}

    def function(block, texts):
        """(t, z, r) -> values of some texts."""
        lines = [*block["definitions"], ("values", f"({', '.join(texts)},)")]
        for name, text in lines:
            if not ARITHMETIC.fullmatch(f"{name} {text}"):
                raise ValueError(f"{data['name']}: {text[:40]!r} is not arithmetic")
        code = compile("\n".join(f"{name} = {text}" for name, text in lines), data["name"], "exec")

        def evaluate(t, z, r=()):
            known = {"t": t} | dict(zip(states, z, strict=True)) | {f"r{k}": value for k, value in enumerate(r)}
            exec(code, {"__builtins__": {}}, names := FUNCTIONS | parameters | known)  # noqa: S102 - arithmetic
            return names["values"]

        return evaluate

    def along(t, path, margin, r):
        return margin(t, path(t), r)[0]

    z, ends, after = [entry["value"] for entry in data["orbit"]["initial_state"].values()], [], []
    for arc in evaluation["arcs"]:
        block, t, slack = evaluation["modes"][arc["mode"]], arc["end"], 0.01 * (arc["end"] - arc["start"])
        rates, is_phase = function(block, block["rates"]), arc["ends_with"] is not None
        span, accuracy = (arc["start"], t + slack * is_phase), {"rtol": 1e-12, "atol": 1e-14}
        path = solve_ivp(rates, span, z, "DOP853", dense_output=True, args=(arc["r"],), **accuracy).sol
        if is_phase:
            margin = function(block, [block["margins"][arc["ends_with"]]])
            t = brentq(along, t - slack, t + slack, args=(path, margin, arc["r"]), xtol=1e-15)
            ends.append(t)
        z = path(t)
        if arc["reset"]:
            reset = evaluation["resets"][arc["reset"]]
            z = function(reset, reset["state"])(t, z)
        if arc["ends_step"]:
            after.append(z)
            parameters |= {a: parameters[b] for pair in statement["exchanged"].items() for a, b in (pair, pair[::-1])}
    return np.array(ends), np.array(after)


if __name__ == "__main__":
    orbit = json.loads(Path(sys.argv[1]).read_text())
    ends, after = recompute(orbit)
    start = [entry["value"] for entry in orbit["orbit"]["initial_state"].values()]
    print("phases end", *ends, "s after the last impact")
    print("state after one cycle less initial state:", np.abs(after[-1] - start).max())
