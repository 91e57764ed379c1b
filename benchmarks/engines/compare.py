"""Compare physics engines with gaits: ``python benchmarks/engines/compare.py``, in less than ten minutes on two cores.

Replays gaits in every engine, validates the adapters, and writes ``results.json`` and ``tables.md`` here, and the
figures of the page "Do simulators stick?" in docs. Siconos is left out where it is not installed. ``--draw`` draws them
again from ``results.json``.
"""

import argparse
import json
import platform
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter
from rich.progress import track

import gaitopt as go
from gaitopt.engines.plant import Reference
from gaitopt.engines.replay import ENGINES, INSTALL, TIME_STEPS, adapter
from gaitopt.errors import ProblemError
from gaitopt.show.motion import motion_of, smooth
from gaitopt.show.style import COLOURS, dashes, encoded, figure_style, legend_below

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
sys.path[:0] = [str(HERE), str(ROOT / "docs" / "examples")]

from numpy_engine import Simulator as Template  # noqa: E402
from validation import CASES, OF_MUJOCO, PERTURBATIONS, is_flagged  # noqa: E402

RESULTS = HERE / "results.json"
GAIT, STICKING = "compass-passive-a", "compass-passive-stick"
GAITS = (
    GAIT,
    "compass-passive-b",
    STICKING,
    "compass-torque-slip",
    "compass-torque-impact-slip",
    "compass-pd-impact-slip",
    "compass-passive-two-step",
    "compass-unequal",
    "round-feet-passive",
    "torso-passive",
    "torso-upright",
    "rimless-wheel-slip",
)
STEPS = (*TIME_STEPS, 0.000125)
SHOWN = 0.001
"""Time step of the tables [s]."""
CLOSED = 0.001
"""Time step of the closed forms [s]."""
DPI = 130


def main() -> None:
    """Measure, or read what was measured; then draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draw", action="store_true", help="draw from results.json instead of measuring")
    if not parser.parse_args().draw:
        RESULTS.write_text(json.dumps(measured(), indent=1) + "\n")
    results = json.loads(RESULTS.read_text())
    docs = ROOT / "docs"
    (docs / "engines-slip.png").write_bytes(encoded(slip_figure(results), "png", DPI))
    (docs / "engines-error.png").write_bytes(encoded(error_figure(results), "png", DPI))
    (HERE / "tables.md").write_text(tables(results))


def measured() -> dict:
    """All replays, closed forms and judgements."""
    missing = [name for name, package in ENGINES.items() if find_spec(package) is None]
    if not set(missing) <= set(INSTALL):  # others come with the extra
        raise SystemExit(f"{', '.join(missing)} not installed: pip install '.[engines]'")
    simulators = [*(adapter(name) for name in ENGINES if name not in missing), Template]
    replays, motions = [], []
    for name in track(GAITS, "gaits"):
        gait = go.solve(name, progress=False)
        for simulator in simulators if name == GAIT else simulators[:-1]:
            steps = STEPS if name == GAIT else TIME_STEPS
            try:
                records = [r.to_record() for r in go.replay(gait, simulator, time_steps=steps, progress=False)]
            except ProblemError:  # Siconos has no links that are point masses
                continue
            replays += [{key: value for key, value in record.items() if key != "motion"} for record in records]
        if name == GAIT:
            for simulator in simulators[:-1]:
                for dt in (0.002, 0.00025):
                    shown = go.replay(gait, simulator, time_steps=[dt], progress=False)
                    motions += [{"engine": r.engine, "setting": r.setting, **r.to_record()["motion"]} for r in shown]
    machine = {"python": platform.python_version(), "gaitopt": go.__version__, "machine": platform.machine()}
    return {"machine": machine, "replays": replays, "motions": motions, **validated(simulators)}


def validated(simulators: list) -> dict:
    """Closed forms, and whether errors of engines are flagged."""
    reference, closed, flags = Reference(go.solve(GAIT, progress=False)), [], []
    for simulator in track(simulators, "validation"):
        for setting, values in simulator.settings.items():
            for case, solve in CASES.items():
                number, exact = solve(simulator, CLOSED, values)
                closed.append({"engine": simulator.name, "setting": setting, "case": case, "error": number / exact - 1})
        if simulator is not Template:
            changes = {"nothing": {}, **PERTURBATIONS, **(OF_MUJOCO if simulator.name == "mujoco" else {})}
            for change, values in changes.items():
                flagged = is_flagged(reference, simulator, {**simulator.settings["best"], **values})
                flags.append({"engine": simulator.name, "change": change, "flagged": flagged})
    return {"closed": closed, "flags": flags}


def engines_of(results: dict) -> list[str]:
    """Names of the engines that were measured."""
    measured = {replay["engine"] for replay in results["replays"]}
    return [name for name in ENGINES if name in measured]


def of(results: dict, engine: str, setting: str, problem: str = GAIT) -> dict | None:
    """One replay; None if the engine does not support the gait."""
    keys = {"engine": engine, "setting": setting, "problem": problem}
    return next((r for r in results["replays"] if all(r[key] == value for key, value in keys.items())), None)


def slip_figure(results: dict) -> Figure:
    """Place of the stance foot over a step, one panel per engine."""
    motion = motion_of(go.solve(GAIT, progress=False))
    names = engines_of(results)
    with figure_style():
        figure = Figure(figsize=(6.6, 0.5 + 2.3 * len(names)))
        panels = figure.subplots(len(names), 1, sharex=True)
    for axes, engine in zip(panels, names, strict=True):
        for shown in (m for m in results["motions"] if m["engine"] == engine):
            colour = COLOURS[1] if shown["setting"] == "default" else COLOURS[0]
            style = ":" if shown["dt"] > SHOWN else "-"
            label = f"{shown['setting']}, {1e3 * shown['dt']:g} ms"
            axes.plot(shown["t"], np.array(shown["x"]) * 1e3, color=colour, ls=style, lw=1.3, label=label)
        for began, arc in smooth(motion.steps):
            axes.plot(began + arc.times, 1e3 * arc.states[:, 2], color="k", linestyle=dashes(arc.mode), lw=1)
        axes.set(ylabel="stance foot [mm]", title=f"{engine} {of(results, engine, 'best')['version']}")
    panels[-1].set(xlabel="time since impact [s]")
    handles, labels = panels[0].get_legend_handles_labels()
    panels[0].plot([], [], color="k", lw=1, label="gait A")
    handles, labels = panels[0].get_legend_handles_labels()
    legend_below(figure, [handle for handle, _ in zip(handles, labels, strict=True)])
    return figure


def error_figure(results: dict) -> Figure:
    """Errors over the time step, one panel per engine."""
    names = engines_of(results)
    with figure_style():
        rows = (len(names) + 1) // 2
        figure = Figure(figsize=(6.6, 0.9 + 2.3 * rows))
        grid = figure.subplots(rows, 2, sharex=True, sharey=True)
    panels = grid.ravel()
    for axes in panels[len(names) :]:
        axes.set_axis_off()
    for axes, engine in zip(panels, names, strict=False):
        for setting, colour in (("default", COLOURS[1]), ("best", COLOURS[0])):
            replay = of(results, engine, setting)
            for key, style, moment in (
                ("error_before_impact", "o-", "before the impact"), ("state_error", "s:", "after one cycle")
            ):  # fmt: skip
                errors = [np.nan if error is None else error for error in replay[key]]
                axes.loglog(
                    1e3 * np.array(replay["dt"]),
                    errors,
                    style,
                    color=colour,
                    ms=3.5,
                    lw=1.2,
                    label=f"{setting}, {moment}",
                )
        dt = np.array([STEPS[-1], STEPS[0]])
        axes.loglog(1e3 * dt, 2 * dt, color="0.6", lw=0.8, ls="--", label="first order")
        axes.set(title=f"{engine} {replay['version']}")
        axes.set_xticks([1e3 * step for step in STEPS[::2]], [f"{1e3 * step:g}" for step in STEPS[::2]])
        axes.xaxis.set_minor_formatter(NullFormatter())
    for axes in grid[:, 0]:
        axes.set_ylabel("error of the state")
    for axes in grid[-1]:
        axes.set_xlabel("time step [ms]")
    legend_below(figure, panels[0].get_legend_handles_labels()[0])
    return figure


def table_of(header: list[str], rows: list[list[str]]) -> list[str]:
    """Lines of a table in Markdown."""
    return [f"| {' | '.join(cells)} |" for cells in (header, ["---"] * len(header), *rows)]


def tables(results: dict) -> str:
    """The tables of the page."""

    def number(value: float | None, unit: float = 1.0, digits: str = ".1e") -> str:
        return "–" if value is None else format(unit * value, digits).replace("-", "\N{NON-BREAKING HYPHEN}")

    def cell(replay: dict) -> str:
        error = replay["state_error"][at]
        text = replay["ending"][at] if error is None else number(error)
        return f"**{text}**" if replay["sequence_matches"][at] else text

    engines = engines_of(results)
    names = [*engines, Template.name]
    versions = {name: of(results, name, "default")["version"] for name in names}
    at = of(results, names[0], "best")["dt"].index(SHOWN)
    slip = of(results, names[0], "best")["slip"]["gait"]
    forward, backward = (number(slip[way], 1e3, ".3f") for way in ("slip_forward", "slip_backward"))
    slips = ["engine, setting", "forward [mm]", "backward [mm]", "creep [µm]", "missed, invented [%]", "modes right to"]
    errors = ["engine, setting", "before impact (order)", "after one cycle (order)", "impact", "energy", "s/s"]
    rows: list[list[list[str]]] = [[], []]
    for name in names:
        for setting in ("default", "best"):
            r = of(results, name, setting)
            way, label = r["slip"]["engine"], " ".join([name, *([versions[name]] if name in engines else [])])
            rows[0].append(
                [
                    number(way["slip_forward"][at], 1e3, ".3f"),
                    number(way["slip_backward"][at], 1e3, ".3f"),
                    number(r["creep"][at], 1e6, ".2g"),
                    f"{number(r['slip_missed'][at], 100, '.1f')}, {number(r['slip_invented'][at], 100, '.1f')}",
                    f"{number(r['largest_dt'], 1e3, 'g')} ms",
                ]
            )
            pairs = (("error_before_impact", "order_before_impact"), ("state_error", "order"))
            cells = [f"{number(r[error][at])} ({number(r[order], 1, '.1f')})" for error, order in pairs]
            cells += [number(r[error][at]) for error in ("impact_error", "energy_error")]
            rows[1].append([*cells, number(r["seconds_per_second"][at], 1, ".2f")])
            for table in rows:
                table[-1].insert(0, f"{label}, {setting}")
    lines = [
        f"Gait A at a time step of {1e3 * SHOWN:g} ms. Its foot slips {forward} mm forward, sticks, and slips "
        f"{backward} mm backward. Modes are right up to the time step in the last column.",
        "",
        *table_of(slips, rows[0]),
        "",
        f"Errors at {1e3 * SHOWN:g} ms: of the state before the impact and after one cycle, of the impulse and of the "
        "energy; seconds of computing per simulated second (s/s).",
        "",
        *table_of(errors, rows[1]),
        "",
        f"Error of the state after one cycle at {1e3 * SHOWN:g} ms with the default and the best setting; bold where "
        "the modes are right.",
        "",
        f"| gait | {' | '.join(engines)} |",
        "|---|" + "---|" * len(engines),
    ]
    for problem in GAITS:
        pairs = ([of(results, name, setting, problem) for setting in ("default", "best")] for name in engines)
        cells = ("point mass" if None in pair else ", ".join(map(cell, pair)) for pair in pairs)
        lines.append(f"| {problem} | {' | '.join(cells)} |")
    shown = of(results, names[0], "best")["dt"][: len(TIME_STEPS)]
    lines += [
        "",
        f"Error of the state after one cycle, best settings: the impact of {GAIT} needs 90 % of its friction, that of "
        f"{STICKING} 72 %.",
        "",
        f"| gait | engine | {' | '.join(f'{1e3 * dt:g} ms' for dt in shown)} |",
        "|---|---|" + "---|" * len(shown),
    ]
    for problem in (GAIT, STICKING):
        for name in engines:
            errors = of(results, name, "best", problem)["state_error"][: len(shown)]
            lines.append(f"| {problem} | {name} | {' | '.join(map(number, errors))} |")
    lines += [
        "",
        f"Modes of the engines where they differ from those of the gait at {1e3 * SHOWN:g} ms, best settings.",
        "",
    ]
    lines += ["| gait | engine | modes |", "|---|---|---|"]
    for problem in GAITS:
        for name in engines:
            r = of(results, name, "best", problem)
            if r is not None and not r["sequence_matches"][at]:
                modes = "; ".join(", ".join(step) for step in r["sequence"][at])
                lines.append(f"| {problem} | {name} | {modes} |")
    lines += ["", f"Relative error of motions with closed forms at {1e3 * CLOSED:g} ms.", ""]
    lines += [f"| engine, setting | {' | '.join(CASES)} |", "|---|" + "---|" * len(CASES)]
    for name in names:
        for setting in ("default", "best"):
            found = {c["case"]: c["error"] for c in results["closed"] if (c["engine"], c["setting"]) == (name, setting)}
            lines.append(f"| {name}, {setting} | {' | '.join(number(abs(found[case])) for case in CASES)} |")
    changes = list(dict.fromkeys(flag["change"] for flag in results["flags"]))
    lines += ["", "Small modelling errors: does the comparison detect them? (best settings)", ""]
    lines += [f"| error | {' | '.join(engines)} |", "|---|" + "---|" * len(engines)]
    for change in changes:
        found = {flag["engine"]: flag["flagged"] for flag in results["flags"] if flag["change"] == change}
        cells = ("–" if name not in found else "flagged" if found[name] else "passes" for name in engines)
        lines.append(f"| {change} | {' | '.join(cells)} |")
    machine = results["machine"]
    lines += ["", f"Measured with gaitopt {machine['gaitopt']} and Python {machine['python']} on {machine['machine']}."]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
