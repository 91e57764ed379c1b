"""Tables of problems and of all results, in a terminal of any width or as HTML in a notebook.

Results are printed from their records, the JSON objects of the command line.
"""

import math
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from decimal import Decimal
from functools import singledispatch
from io import StringIO
from itertools import chain, repeat
from typing import Any, Literal

from rich import box
from rich.console import Console
from rich.table import Table

from gaitopt.design.derivatives import Derivatives
from gaitopt.display import counted, spelled
from gaitopt.gait.branch import TERMINAL, Branch, cascades
from gaitopt.gait.gait import Gait
from gaitopt.gait.records import VerificationRecord
from gaitopt.gait.trajectory import Trajectory
from gaitopt.model.cycle import UNTIL, Cycle, mode_words
from gaitopt.model.modes import Mode
from gaitopt.model.section import cycle_end, cycle_start
from gaitopt.model.units import words_and_unit
from gaitopt.problem.problem import Problem
from gaitopt.problem.scalars import SCALARS, label_of, relevant_scalars, scalar_values, state_unit, unit_of
from gaitopt.problem.statement import OpenSequence
from gaitopt.runs.atlas import Atlas
from gaitopt.runs.attractors import Attractors
from gaitopt.runs.basin import Basin
from gaitopt.runs.front import Front
from gaitopt.runs.multistart import Optimum
from gaitopt.runs.robustness import Robustness
from gaitopt.runs.sweep import Sweep
from gaitopt.search.explain import Explanation
from gaitopt.search.find import Gaits, counted_gaits
from gaitopt.solver.program import NonlinearProgram
from gaitopt.verification.verify import OUTCOMES, Verification, recorded_claims
from gaitopt.verification.walk import Walk

Record = Mapping[str, Any]

FOLDED = 12
"""Largest number of parameters that a table of results lists unless all are asked for."""
UNFOLD = "--all lists them"
GAP = 3
"""Number of characters between two columns."""
LARGEST_ZERO = 1e-12
"""Size below which a number is shown as zero, because it is rounding in all units of these tables."""
FRICTION_KEYS = ("friction", "friction.static", "friction.kinetic")
MODES = "phases; impact"
LIST_COLUMNS = ("problem", "walker", MODES, "period [s]", "radius", "", "about")
NARROWEST_ABOUT = {MODES: 40, "period [s]": 20, "radius": 20, "": 20}
"""Columns that are left out if the column ``about`` would be narrower than this beside them."""
LONGEST_MODES = 80
"""Largest number of characters of a mode sequence in the list of problems; instead of a longer one, the list states its
number of phases."""
ENDED = "the time was over before the search was complete: more gaits or values may exist"
AGGREGATES = {"worst": "worst over {}", "mean": "mean over {}", "at": "at {} = {}"}
"""The names of the ways in which values of an objective over a range count."""
STABILITY = {True: "stable", False: "unstable"}
FOUND_BY = {"newton": "Newton's method", "ipopt": "IPOPT"}
CHAOTIC = 1e-3
"""Lyapunov exponent above which a motion without a period is chaos; below it the motion may be a torus."""
SHOWN_DIGEST = 16
"""Number of digits of a problem's SHA-256 in a table."""
LONGEST_BOUND = 15
"""Largest number of digits of a bound in a table."""
WIDTH = 110
"""Number of characters of a line in a notebook."""
BLOCK = '<pre style="font-family: monospace; line-height: 1.25; overflow-x: auto">{code}</pre>'
TILE_KINDS = {
    "friction_low": "friction of icy tiles",
    "friction_high": "friction of sticky tiles",
    "step_up": "step up [m]",
    "step_down": "step down [m]",
    "slope_up": "slope of tiles, more [rad]",
    "slope_down": "slope of tiles, less [rad]",
}
"""The names of the patches that walks cross, by their keys in JSON."""
NORM_UNITS = {"period": "s", "step_length": "m", "foot_clearance": "m", "cone_distance": "N"}
TILE_UNITS = {"friction": "", "height": "/m", "slope": "/rad"}


def table(
    columns: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    numbers: Sequence[int] = (),
    widths: Sequence[int] | None = None,
) -> Table:
    """A plain table; the columns at ``numbers`` are right-aligned, and words wrap in a narrow terminal."""
    grid = Table(box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False)
    cells = [tuple(row) for row in rows]
    for index, (column, *own) in enumerate(zip(columns, *cells, strict=True)):  # no word is broken or lost
        justify: Literal["right", "left"] = "right" if index in numbers else "left"
        narrowest = max(map(_longest_word, (column, *own)))
        fixed = None if widths is None else widths[index]
        grid.add_column(column, justify=justify, overflow="fold", min_width=narrowest, width=fixed)
    for row in cells:
        grid.add_row(*row)
    return grid


def section(
    console: Console,
    title: str,
    columns: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    numbers: Sequence[int] = (),
) -> None:
    """Print a table under its title."""
    console.print(f"\n{title}", style="bold")
    print_table(console, columns, rows, numbers=numbers)


def print_table(
    console: Console, columns: Sequence[str], rows: Iterable[Sequence[str]], *, numbers: Sequence[int] = ()
) -> None:
    """Print a table; if its columns do not fit side by side, print every row as a block of lines instead."""
    cells = [tuple(row) for row in rows]
    widths = _widths(list(zip(columns, *cells, strict=True)), console.width - GAP * (len(columns) - 1))
    if widths is not None:
        console.print(table(columns, cells, numbers=numbers, widths=widths))
        return
    for row in cells:
        console.print(row[0], style="bold", soft_wrap=False, overflow="fold")
        for column, cell in list(zip(columns, row, strict=True))[1:]:
            if cell:
                console.print(f"  {column}: {cell}" if column else f"  {cell}", overflow="fold")


def _widths(columns: Sequence[tuple[str, ...]], room: int) -> list[int] | None:
    """Widths of columns. The widest ones are narrowed until all fit into ``room``; None if they cannot fit."""
    narrowest = [max(map(_longest_word, column)) for column in columns]
    widths = [max(len(line) for cell in column for line in cell.split("\n")) for column in columns]
    if sum(narrowest) > room:
        return None
    while sum(widths) > room:
        widths[max((k for k, width in enumerate(widths) if width > narrowest[k]), key=widths.__getitem__)] -= 1
    return widths


def _longest_word(text: str) -> int:
    return max((len(word) for word in text.split()), default=0)


def number(value: float | None) -> str:
    """A number with six digits; the JSON has all of them."""
    if value is None:
        return "-"
    return f"{0.0 if abs(value) < LARGEST_ZERO else value:.6g}"


def with_degrees(value: float, unit: str) -> str:
    """The unit; that of an angle is followed by the value in degrees."""
    return f"{unit} ({math.degrees(value):.5g} deg)" if unit == "rad" else unit


def print_problems(console: Console, problems: Sequence[tuple[Problem, Record]]) -> None:
    """Print problems in one table in the order of walkers, each with period and stability of its gait if known.

    Empty columns are left out, and those of ``NARROWEST_ABOUT`` if the terminal has no room for them.
    """
    rows = list[tuple[str, ...]]()
    for problem, record in sorted(problems, key=lambda pair: (pair[0].walker.model, pair[0].name)):
        gait, radius = ("", "", ""), record.get("spectral_radius")
        if radius is not None:
            gait = number(record["period"]), number(radius), STABILITY[radius < 1]
        modes = str(problem.modes)
        if isinstance(problem.modes, Cycle) and len(modes) > LONGEST_MODES:
            modes = counted(len(problem.modes.phases), "phase")
        rows.append((problem.name, problem.walker.model, modes, *gait, problem.about.strip()))
    columns = list(zip(LIST_COLUMNS, *rows, strict=True))
    columns = [column for column in columns if any(column[1:])]
    everything = columns
    for heading, narrowest in NARROWEST_ABOUT.items():
        widths = [max(map(_longest_word if column[0] == MODES else len, column)) for column in columns[:-1]]
        if console.width - sum(widths) - GAP * len(widths) < narrowest:
            columns = [column for column in columns if column[0] != heading]
    if _widths(columns, console.width - GAP * (len(columns) - 1)) is None:
        columns = everything  # every row is printed as a block
    headings, *cells = zip(*columns, strict=True)
    print_table(console, headings, cells)


def print_problem(console: Console, problem: Problem, *, every: bool = True) -> None:
    """Print a problem: walker, control, mode sequence, guess, unknowns; for ``every`` see ``print_gait``."""
    console.print(problem.name, style="bold")
    if problem.about:
        console.print(problem.about)
    walker = list[tuple[str, ...]]()
    for name, field in type(problem.walker).model_fields.items():
        value = getattr(problem.walker, name)
        meaning, unit = words_and_unit(field.description or "")
        walker.append((name, number(value), with_degrees(value, unit), meaning))
    section(console, f"walker {problem.walker.model}", ("key", "value", "unit", ""), walker, numbers=(1,))
    parameters = problem.parameters.items()
    contact = [(key, number(v), unit_of(key)) for key, v in parameters if key.partition(".")[0] == "friction"]
    contact += [("impact_law", str(problem.impact_law), ""), ("control", problem.control.type, "")]
    of_law = [(key, value) for key, value in parameters if key.startswith("control.")]
    if every or len(of_law) <= FOLDED:
        for key, value in of_law:
            contact.append((key.partition(".")[2], number(value), with_degrees(value, unit_of(key, problem))))
    else:
        contact.append(("its parameters", str(len(of_law)), UNFOLD))
    if problem.reference is not None:
        ends = {str(getattr(each, "beyond_end", "")) for each in problem.control.targets.values()} - {""}
        contact.append(("reference", problem.reference.name, f"beyond its end: {', '.join(ends)}" if ends else ""))
    section(console, "contact and control", ("key", "value", "unit"), contact, numbers=(1,))
    if not problem.has_gait:
        if problem.until is not None:
            limits = [(k, number(v), "s" if k == "time" else "") for k, v in problem.until.data.items()]
            section(console, "simulation ends after", ("", "value", "unit"), limits, numbers=(1,))
    elif isinstance(problem.modes, OpenSequence):
        title = "one step" if problem.modes.steps == 1 else f"at most {problem.modes.steps} steps"
        impact = str(problem.modes.impact or "to be found")
        section(console, title, ("phase", "mode"), [("1, 2, ...", "to be found"), ("impact", impact)])
    else:
        steps = problem.modes.steps
        for k, step in enumerate(steps, start=1):
            phases = [(str(index), mode.brief) for index, mode in enumerate(step.phases, start=1)]
            title = "one step" if len(steps) == 1 else f"step {k} of {len(steps)}"
            section(console, title, ("phase", "mode"), [*phases, (cycle_end(problem), step.impact.brief)])
    if problem.start is not None:
        values = problem.start.state.items()
        state = ((name, number(value), with_degrees(value, state_unit(name))) for name, value in values)
        title = f"guess, {cycle_start(problem)}" if problem.has_gait else "start of the simulation"
        section(console, title, ("state", "value", "unit"), state, numbers=(1,))
    if problem.free:
        unknowns = ((key, number(f.lower), number(f.upper), number(f.guess)) for key, f in problem.free.items())
        columns = ("key", "from", "to", "guess")
        _folded_section(console, "unknown parameters", columns, [*unknowns], (1, 2, 3), every=every)
    _print_question(console, problem)


def _print_question(console: Console, problem: Problem) -> None:
    """Print the objective of a design, its constraints, and the range over which it holds."""
    over = problem.over
    if problem.objective:
        weights = ((name, number(weight)) for name, weight in problem.objective.items())
        title = "minimised"
        if over is not None:
            at = problem.parameters[over.key] if over.at is None else over.at
            title += f", {AGGREGATES[over.aggregate].format(over.key, number(at))}"
        section(console, title, ("scalar", "weight"), weights, numbers=(1,))
    if problem.constraints:
        spans = ((name, number(s.minimum), number(s.maximum)) for name, s in problem.constraints.items())
        section(console, "constraints", ("scalar", "from", "to"), spans, numbers=(1, 2))
    if over is not None:
        row = (over.key, number(over.lower), number(over.upper), unit_of(over.key, problem))
        section(console, "holds over", ("parameter", "from", "to", "unit"), [row], numbers=(1, 2))


def print_gait(console: Console, record: Record, problem: Problem, *, every: bool = True) -> None:
    """Print a gait of a problem from its JSON object.

    Parameters
    ----------
    every : whether a long table of the values that were found is printed instead of their number.
    """
    stable = STABILITY[record["spectral_radius"] < 1]
    console.print(f"{record['problem']}: {record['status']}, {stable}", style="bold")
    if record["solver"].get("method") in FOUND_BY:  # earlier versions did not say
        console.print(f"found by {FOUND_BY[record['solver']['method']]}")
    _print_motion(console, record, problem)
    rows = ((number(m["re"]), number(m["im"]), number(abs(complex(m["re"], m["im"])))) for m in record["multipliers"])
    section(console, "Floquet multipliers", ("re", "im", "modulus"), rows, numbers=(0, 1, 2))
    if record["verification"]:
        print_verification(console, record["verification"])
    if record["parameters"]:
        values = record["parameters"].items()
        freed = [(key, number(value), with_degrees(value, unit_of(key, problem))) for key, value in values]
        _folded_section(console, "values found", ("key", "value", "unit"), freed, (1,), every=every)
    if "over" in record:
        _print_range(console, record["over"], problem)
    for remark in record["message"].split("; ")[1:]:
        console.print(remark, soft_wrap=True)


def _print_range(console: Console, over: Record, problem: Problem) -> None:
    """Print the results of a design over a range, from the entry ``over`` of its record."""
    key, (lower, upper), rows = over["parameter"], over["range"], list[tuple[str, str, str]]()
    own, points = number(problem.parameters[key]), over["points"]
    if over["objective"] is not None:
        names = ", ".join(problem.objective)
        title = f"{names}, {AGGREGATES[over['aggregate']].format(key, number(over['at']))}"
        where = {"worst": over["worst_at"], "at": over["at"]}.get(over["aggregate"])
        rows.append((title, number(over["objective"]), "" if where is None else number(where)))
        rows.append(("the same of the design for one value", number(over["single"]), own))
    for column in ("objective", "spectral_radius") if over["objective"] is not None else ("spectral_radius",):
        pairs = list(zip(points[column], points["value"], strict=True))
        for extreme, (value, at) in (("least", min(pairs)), ("largest", max(pairs))):
            rows.append((f"{column.replace('_', ' ')}, {extreme}", number(value), number(at)))
    rows += [(f"{name} is at its bound", "", number(at)) for name, at in over["binding"].items()]
    title = f"over {key} from {number(lower)} to {number(upper)}, {counted(len(points['value']), 'gait')} followed"
    section(console, title, ("", "value", f"at {key}"), rows, numbers=(1, 2))


def _folded_section(
    console: Console,
    title: str,
    columns: Sequence[str],
    rows: Sequence[tuple[str, ...]],
    numbers: tuple[int, ...],
    *,
    every: bool,
) -> None:
    """Print a section; if it has many rows, print only their number unless every row is requested."""
    if every or len(rows) <= FOLDED:
        section(console, title, columns, rows, numbers=numbers)
    else:
        console.print(f"\n{title}: {len(rows)}; {UNFOLD}")


def print_atlas(console: Console, record: Record) -> None:
    """Print an atlas from its JSON object: its size, its regions and its codimension-two points."""
    axes = record["over"]
    keys = [f"{axis['key']} [deg]" if axis["unit"] else axis["key"] for axis in axes]
    spans = [
        f"{name} {number(_in_unit(axis['lower'], axis))} to {number(_in_unit(axis['upper'], axis))}"
        for name, axis in zip(keys, axes, strict=True)
    ]
    counts = f"{record['branches']} branches"
    console.print(f"{record['problem']} over {' and '.join(spans)}", style="bold")
    sheets = "" if record["sheets"] == 1 else f", {record['sheets']} sheets"
    console.print(f"{counts}, {counted(len(record['curves']), 'curve')}{sheets}")
    for low, high in record["unexplained"]:
        gap = " and ".join(number(_in_unit(value, axes[1])) for value in (low, high))
        console.print(f"A curve is missing between {keys[1]} {gap}: try more --refinements.")
    rows = []
    for region in record["regions"]:
        gait, at = region.get("gait") or {}, region.get("at") or {}
        stable = "" if region["stable"] is None else STABILITY[region["stable"]]
        point = [number(_in_unit(at[axis["key"]], axis)) if at else "" for axis in axes]
        remark = region.get("reason", "verified" if gait else "")
        figures = number(gait["spectral_radius"]) if gait else ""
        rows.append((f"{region['area']:.1%}", region["modes"], stable, *point, figures, remark))
    columns = ("area", MODES, "", *(f"gait at {key}" for key in keys), "radius", "")
    section(console, "regions", columns, rows, numbers=(0, 3, 4, 5))
    if record["points"]:
        located = [
            (spelled(point["type"]), *(f"{_in_unit(point['values'][a['key']], a):.9g}" for a in axes), point["status"])
            for point in record["points"]
        ]
        section(console, "codimension-two points", ("type", *keys, ""), located, numbers=(1, 2))


def _in_unit(value: float, axis: Record) -> float:
    return math.degrees(value) if axis["unit"] else value


def print_derivatives(console: Console, record: Record) -> None:
    """Print the derivatives of a gait from their JSON object: what changes its stability most, and the whole table."""
    at, units, by = record["parameters"], record["units"], record["derivatives"]
    radius, slopes = record["values"].get("spectral_radius"), by.get("spectral_radius", {})
    console.print(f"{record['problem']}: derivatives in {counted(len(at), 'parameter')}", style="bold")
    effects = {key: slope * at[key] / 100 for key, slope in slopes.items() if slope is not None}
    rows = [
        (key, number(at[key]), units.get(key, ""), number(slopes[key]), number(radius + effect))
        for key, effect in sorted(effects.items(), key=lambda pair: -abs(pair[1]))
    ]
    if rows:
        title = f"stability: spectral radius {number(radius)}"
        columns = ("parameter", "value", "unit", "derivative", "radius at +1 %")
        section(console, title, columns, rows, numbers=(1, 3, 4))
    headings = ("quantity", "value", "unit", *(f"{key} [{units[key]}]" if key in units else key for key in at))
    cells = [
        (key, number(record["values"][key]), units.get(key, ""), *(number(slope) for slope in by[key].values()))
        for key in by
    ]
    section(console, "derivatives, per unit of the parameter", headings, cells, numbers=(1, *range(3, len(headings))))
    for key, reason in record["reasons"].items():
        console.print(f"{key}: {reason}", soft_wrap=True)


def print_stabilised(console: Console, record: Record, problem: Problem, *, every: bool = True) -> None:
    """Print a gait under a law that was made for it: its distance from the given gait, then the table of the gait."""
    made, given = record["stabilised"], record["stabilised"]["given"]
    over = {"": "", "clock": " over the clock"}.get(made["phase"], f" over the phase {made['phase']}")
    console.print(f"{given['problem']} with {made['law'].replace('_', ' ')}{over}", style="bold")
    if made["degree"] is not None:
        console.print(
            f"curves of degree {made['degree']}, {made['torque_deviation']:.1%} additional torque", soft_wrap=True
        )
    if made["invariance"] is not None:
        console.print(f"outputs and their rates are below {made['invariance']:.1e} just after the impact")
    if made["phase"] not in ("", "clock"):
        console.print(f"the phase advances at {made['least_phase_rate']:.0%} of its mean rate or faster")
    for attempt in made["attempts"]:
        console.print(f"tried: {attempt}", soft_wrap=True)
    for objection in made["objections"]:
        console.print(f"NOT as asked for: {objection}", style="bold", soft_wrap=True)
    compared = {key: (given[key], record[key]) for key in given if key != "problem"}
    rows = [(key.replace("_", " "), *map(number, values), unit_of(key, problem)) for key, values in compared.items()]
    rows.append(("largest difference of a coordinate", "", number(made["distance"]), "rad"))
    section(console, "compared", ("", "given gait", "under the law", "unit"), rows, numbers=(1, 2))
    limits = [
        (name, number(each["needed"]), "none" if each["available"] is None else number(each["available"]))
        for name, each in made["torques"].items()
    ]
    section(console, "largest torques [N m]", ("motor", "needed", "available"), limits, numbers=(1, 2))
    print_gait(console, record, problem, every=every)


def print_walk(console: Console, record: Record, problem: Problem) -> None:
    """Print a simulated walk of a problem from its JSON object."""
    console.print(f"{record['problem']}: {counted(record['steps'], 'step')}, {record['status']}", style="bold")
    console.print(record["message"])
    _print_motion(console, record, problem, last=" of the last step" if record["steps"] else "")
    if record["steps"]:
        return
    rows = [
        (number(entry["time"]), name, number(impulse["F_t"]), number(impulse["F_n"]))
        for entry in record["impacts"]
        for name, impulse in _impulses(entry)
    ]
    if rows:
        section(console, "impacts", ("time [s]", "of", "F_t [N s]", "F_n [N s]"), rows, numbers=(0, 2, 3))
    _print_state(console, record["final_state"], "state at the end")


def _impulses(entry: Record) -> list[tuple[str, Record]]:
    """Impulses of an impact by the name of the contact."""
    impulse = entry["impulse"] or {}
    if "F_t" in impulse:
        return [(", ".join(entry["of"]), impulse)]
    return list(impulse.items())


def print_verification(console: Console, record: VerificationRecord) -> None:
    """Print every claim with its figure and tolerance."""
    rows = list[tuple[str, ...]]()
    for claim in recorded_claims(record):
        figure = f"{claim.figure:.2g}" if math.isfinite(claim.figure) else "-"
        outcome = "ok" if claim.passed else OUTCOMES[claim.outcome].upper()
        rows.append((claim.name, figure, f"{claim.tolerance:.2g}", outcome, claim.note))
    title = "verified by forward simulation" if record["passed"] else "NOT verified by forward simulation"
    section(console, title, ("claim", "value", "tolerance", "", ""), rows, numbers=(1, 2))


def _print_motion(console: Console, record: Record, problem: Problem, last: str = "") -> None:
    if record["phases"]:  # a walk without a complete step has neither phases nor figures
        steps = record["steps"] if isinstance(record.get("steps"), list) else [record]
        phases = list[tuple[str, str, str]]()
        for step in steps:
            for k, phase in enumerate(step["phases"], start=1):
                until = f" (until {phase[UNTIL]})" if UNTIL in phase else ""
                phases.append((str(k), f"{Mode.from_record(phase).brief}{until}", number(phase["duration"])))
            if step["impact"] is not None:
                phases.append((cycle_end(problem), Mode.from_record(step["impact"]).brief, ""))
        section(console, f"phases{last}", ("", "mode", "duration [s]"), phases, numbers=(2,))
        values = scalar_values(record)
        slips = any(Mode.from_record(phase).slips for step in steps for phase in step["phases"])
        labels = {"required_friction": SCALARS["required_friction"].meaning} if slips else {}  # not meant to stick
        keys = relevant_scalars([record])
        scalars = (
            (labels.get(key, label_of(key, problem)), number(values[key]), unit_of(key, problem)) for key in keys
        )
        if record["period"] is not None:
            section(console, f"figures{last}", ("", "value", "unit"), scalars, numbers=(1,))
    if "tracking_errors" in record:
        ends = record["tracking_errors"].items()
        errors = ((name, number(at["start"]), number(at["end"]), state_unit(name)) for name, at in ends)
        heads = ("joint", "after the impact", "before the next", "unit")
        section(console, f"distance from the reference{last}", heads, errors, numbers=(1, 2))
    if "fit_errors" in record:
        fits = ((name, number(error), state_unit(name)) for name, error in record["fit_errors"].items())
        section(console, f"error of the fitted reference{last}", ("joint", "largest", "unit"), fits, numbers=(1,))
    if "zero_dynamics" in record:
        zero, smallest = record["zero_dynamics"], record["decoupling_min_singular_value"]
        rows = [("decoupling matrix, least singular value", number(smallest), "1/(kg m^2)")]
        rows.append(("on the constraint surface", "yes" if zero["invariant"] else "no", ""))
        if zero["delta_squared"] is not None:
            rows.append(("delta_zero^2", number(zero["delta_squared"]), ""))
            rows.append(("largest V_zero", number(zero["potential_max"]), "kg^2 m^4/s^2"))
        section(console, f"virtual constraints{last}", ("", "value", "unit"), rows, numbers=(1,))
    when = "at the start" if record.get("steps") == 0 else cycle_start(problem)
    _print_state(console, record["state"], f"state {when}")


def _print_state(console: Console, values: Record, title: str) -> None:
    state = ((name, number(value), with_degrees(value, state_unit(name))) for name, value in values.items())
    section(console, title, ("", "value", "unit"), state, numbers=(1,))


def friction(problem: Problem) -> str:
    """The coefficient of friction, or static and kinetic coefficient."""
    return " / ".join(number(problem.parameters[key]) for key in FRICTION_KEYS if key in problem.parameters)


def sequence(record: Record) -> str:
    """The mode sequence of the record of a gait."""
    steps = [str(step) for step in Cycle.from_record(record).steps]
    return f"{len(steps)} times {steps[0]}" if len(steps) > 1 and len(set(steps)) == 1 else " | ".join(steps)


def print_gaits(console: Console, record: Record) -> None:
    """Print the gaits of a search, one line each, and the starts of the search."""
    searched = record["searched"]
    found = counted_gaits([gait["spectral_radius"] < 1 for gait in record["gaits"]])
    console.print(f"{record['problem']}: found {found}; the search can miss gaits", style="bold")
    if record["gaits"]:
        _print_list(console, "gaits", record["gaits"])
    for lost in searched["rejected"]:
        console.print(f"no gait: {lost['sequence']}, from {counted(len(lost['starts']), 'start')}: {lost['reason']}")
    for reason in searched["failed"]:
        console.print(f"a part of the search failed: {reason}")
    if not searched["complete"]:
        console.print(ENDED)
    tried = ", ".join(f"{count} of {method}" for method, count in searched["starts"].items())
    console.print(f"searched: cycles of up to {counted(searched['n_steps'], 'step')}; starts: {tried}")
    for heading, ranges in zip(chain(["start states:"], repeat("then:")), searched["boxes"], strict=False):
        spans = (f"{name} {lo:.4g}:{hi:.4g} {state_unit(name)}" for name, (lo, hi) in ranges.items())
        console.print(f"{heading} {', '.join(spans)}")


def explanation_lines(record: Record) -> list[str]:
    """The reasons why there is no gait, and the nearest values with the gait."""
    if record["exists"]:
        return [f"{record['problem']}: this gait exists; `gaitopt solve` shows it"]
    lines = [f"{record['problem']}: this gait does not exist", *(f"  {cause['words']}" for cause in record["causes"])]
    if record["simulated"]:
        lines.append(f"simulated from the guess: {record['simulated']['status']}: {record['simulated']['message']}")
    for nearest in record["nearest"]:
        where = f"{nearest['parameter']} = {nearest['value']:.10g}"
        lines.append(f"this mode sequence begins at {where} ({spelled(nearest['type'])}): {nearest['reason']}")
    return lines


def print_explanation(console: Console, record: Record, printed: Collection[str] = ()) -> None:
    """Print the lines of an explanation that are not ``printed`` yet, and the gaits with other mode sequences."""
    for number, line in enumerate(explanation_lines(record)):
        if line not in printed:
            console.print(line, style=None if number else "bold")
    if record["instead"]:
        _print_list(console, "existing gaits", record["instead"])
    elif not record["exists"]:
        console.print("no gait with another mode sequence was found")
    if not record["complete"]:
        console.print(ENDED)


def _print_list(console: Console, title: str, gaits: Sequence[Record]) -> None:
    columns = ("", "phases; impact", "steps", "period [s]", "speed [m/s]", "radius", "", "starts")
    rows = (
        (
            str(k),
            sequence(gait),
            str(gait["n_steps"]),
            number(gait["period"]),
            number(gait["speed"]),
            number(gait["spectral_radius"]),
            STABILITY[gait["spectral_radius"] < 1],
            str(len(gait["starts"])),
        )
        for k, gait in enumerate(gaits)
    )
    section(console, title, columns, rows, numbers=(2, 3, 4, 5, 7))


def print_branch(console: Console, records: Sequence[Record], parameter: str, problem: Problem | None = None) -> None:
    """Print the branches of a family, its special points and cascades; records may have a ``sequence``."""
    specials = [record for record in records if record["record"] == "special"]
    unit = unit_of(parameter, problem)
    rows = list[tuple[str, ...]]()
    for branch in sorted({record["branch"] for record in records if record["record"] == "point"}):
        points = [record for record in records if record["record"] == "point" and record["branch"] == branch]
        radii = [point["spectral_radius"] for point in points]
        own = [s for s in specials if s["branch"] == branch and (s["next"] or s["type"] in TERMINAL)]
        joints = [" -> ".join(filter(None, (spelled(s["type"]), ", ".join(map(str, s["next"]))))) for s in own]
        rows.append(
            (
                str(branch),
                points[0].get("sequence") or sequence(points[0]),
                number(points[0]["value"]),
                number(points[-1]["value"]),
                str(len(points)),
                f"{min(radii):.4f} to {max(radii):.4f}",
                "; ".join(joints),
            )
        )
    between = [f"{end} [{unit}]" if unit else end for end in ("from", "to")]
    columns = ("branch", "mode sequence", *between, "points", "|multiplier|", "special points")
    section(console, "branches", columns, rows, numbers=(2, 3, 4))
    for k, special in enumerate(specials):
        guess = "" if special["status"] == "converged" else " (only bracketed)"
        value = f"{special['value']:.12g} {with_degrees(special['value'], unit)}".rstrip()
        console.print(f"{k}: branch {special['branch']}, {value}{guess}: {event(special)}")
    for cascade in cascades(records):
        console.print(f"cascade: {cascade}")


def print_trace(console: Console, records: Sequence[Record], parameters: tuple[str, str]) -> None:
    """Print the curves of a special point over two parameters, and their special points."""
    rows, specials = list[tuple[str, ...]](), [record for record in records if record["record"] == "special"]
    points = [record for record in records if record["record"] == "point"]
    for curve in sorted({record["curve"] for record in points}):
        own = [record for record in points if record["curve"] == curve]
        ends = (number(own[k]["values"][key]) for key in parameters for k in (0, -1))
        rows.append((str(curve), own[0].get("sequence") or sequence(own[0]), *ends, str(len(own))))
    columns = [f"{key} {end}" for key in parameters for end in ("from", "to")]
    section(console, "curves", ("curve", "mode sequence", *columns, "points"), rows, numbers=(2, 3, 4, 5, 6))
    for k, special in enumerate(specials):
        values = ", ".join(f"{key} = {value:.12g}" for key, value in special["values"].items())
        guess = "" if special["status"] == "converged" else " (only bracketed)"
        form = "".join(f", {name} = {v:.6g}" for name, v in special["coefficients"].items() if v is not None)
        console.print(f"{k}: curve {special['curve']}, {values}{form}{guess}: {event(special)}")
        for n, start in enumerate(special["next"]):
            console.print(f"   next {n}: {spelled(start['type'])}", markup=False)


def event(special: Record) -> str:
    """Type and reason of a special point."""
    return ": ".join(filter(None, (spelled(special["type"]), special["reason"])))


def print_basin(console: Console, record: Record) -> None:
    """Print the gaits on which states end, and the endings of the other states."""
    gaits = [
        (str(k), g["kind"], f"{g['states']:,}", f"{g['share']:.2%}", f"{', '.join(g['phases'])}; {g['impact']}")
        for k, g in enumerate(record["gaits"])
    ]
    failures = sorted(record["failures"].items(), key=lambda failure: -failure[1])
    failed = [("", spelled(name), f"{n:,}", f"{n / record['states']:.2%}", "") for name, n in failures]
    title = f"{record['problem']}: {record['states']:,} states"
    section(console, title, ("", "ends on", "states", "share", "modes; impact"), [*gaits, *failed], numbers=(0, 2, 3))


def print_robustness(console: Console, result: Robustness) -> None:
    """Print the figures of the robustness of a gait, and how each of them was found."""
    title, columns = f"{result.problem.name}: robustness", ("figure", "value, lower end", "upper end", "found by")
    section(console, title, columns, robustness_rows(result))


def robustness_rows(result: Robustness) -> list[tuple[str, str, str, str]]:
    """The rows of the table: name of the figure, value or lower end, upper end, and the method that found it."""
    rows, record = list[tuple[str, str, str, str]](), result.to_record()
    norm = "derivatives of the walk" if result.problem.walker.stands_on_one() else "differences of walks"
    for key, found in record.get("range", {}).items():
        ends = [(found[side], spelled(found[f"{side}_end"])) for side in ("low", "high")]
        low, high = ("no end found" if end is None else f"{end:.9g} ({kind})" for end, kind in ends)
        rows.append((f"stable range of {key}", low, high, "continuation"))
    for kind, of_length in record.get("patch", {}).items():
        values = ", ".join(
            f"{'none fails' if value is None else _figure(value)} ({length})" for length, value in of_length.items()
        )
        rows.append((f"{TILE_KINDS[kind]}, by number of tiles", values, "", "simulated walks"))
    for rate, ends in record.get("push", {}).items():
        low, high = ("none fails" if end is None else _figure(end) for end in ends)
        rows.append((f"push of {rate}", low, high, "simulated walks"))
    nearest = record.get("nearest")
    if nearest is not None:
        state = nearest["state"] or {}
        values = ", ".join(f"{name} = {value:.6g}" for name, value in state.items())
        rows.append(("nearest state that does not return", _figure(nearest["distance"]), values, "search along rays"))
    for quantity, outputs in record.get("sensitivity", {}).items():
        for name, value in outputs.items():
            unit = f"{NORM_UNITS[name]}{TILE_UNITS[quantity]}"
            title = f"norm from {quantity} to {name.replace('_', ' ')} [{unit}]"
            rows.append((title, _figure(value), "", norm))
    falls = record.get("falls")
    if falls is not None:
        low, high = falls["interval"]
        interval = f"{_figure(low)} to {_figure(high)}"
        rows.append((f"mean steps to a fall, {falls['floor']}", _figure(falls["mean_steps"]), interval, "random walks"))
        known, reason = falls["eigenvalue"], falls.get("eigenvalue_reason") or "weighted walks"
        rows.append(("1 - metastable eigenvalue", _figure(None if known is None else 1 - known), "", reason))
        if (steps := falls.get("metastable")) is not None and known is not None:
            interval = " to ".join(map(_figure, steps["interval"]))
            rows.append(("mean steps to a fall from it", _figure(steps["mean_steps"]), interval, reason))
    return rows


def _figure(value: float | None, digits: int = 6) -> str:
    return "-" if value is None else f"{value:.{digits}g}"


def print_attractors(console: Console, result: Attractors) -> None:
    """Print the attractors of walks; neighbouring values with the same attractors share a row."""
    key, unit = result.axis.key, result.axis.unit or unit_of(result.axis.key, result.problem)
    rows, before, lost = list[tuple[str, ...]](), "", list[int]()
    for record in result.records:
        value = number(math.degrees(record["value"]) if unit == "deg" else record["value"])
        runs = record["attractors"]
        ended = sum(record["endings"].values())
        starts = ended + sum(run["starts"] for run in runs)
        attractors = ", ".join(sorted({_attractor_name(run) for run in runs})) or "none"
        rates = [run["lyapunov"] for run in runs if run["lyapunov"] is not None]
        span = [min(rates), max(rates)] if rates else []
        if attractors == before:
            first, _, _, _, lowest, highest = rows.pop()
            span = [*span, *(float(text) for text in (lowest, highest) if text)]
            lost.append(ended)
        else:
            first, lost = value, [ended]
        fewest, most_lost = min(lost), max(lost)
        ended_starts = f"{fewest if fewest == most_lost else f'{fewest} to {most_lost}'} of {starts}"
        ends = (f"{min(span):.4g}", f"{max(span):.4g}") if span else ("", "")
        rows.append((first, value, attractors, ended_starts, *ends))
        before = attractors
    title = f"{result.problem.name}: what walks settle on over {key}{f' [{unit}]' if unit else ''}"
    columns = ("from", "to", "attractors", "starts that end", "least exponent", "largest exponent")
    section(console, title, columns, rows, numbers=(0, 1, 3, 4, 5))
    endings = Counter[str]()
    for record in result.records:
        endings.update(record["endings"])
    if endings:
        console.print("ends: " + ", ".join(f"{spelled(name)} {count:,}" for name, count in endings.most_common()))


def _attractor_name(run: Record) -> str:
    if run["period_steps"] is not None:
        return f"cycle of {counted(run['period_steps'], 'step')}"
    return "chaos" if (run["lyapunov"] or 0.0) > CHAOTIC else "no cycle"


def print_sweep(console: Console, record: Record) -> None:
    """Print the numbers of points of a grid by status."""
    statuses = ", ".join(f"{count} {spelled(status)}" for status, count in record["statuses"].items())
    console.print(f"{record['problem']}: {counted(record['jobs'], 'job')}, {statuses}")
    console.print(f"verified: {record['verified']}" + (f", REFUTED: {record['refuted']}" if record["refuted"] else ""))
    if record.get("several"):
        console.print(f"several gaits: at {counted(record['several'], 'point')}; column gaits of the table")
    for job in record["set_aside"]:
        point = ", ".join(f"{key} = {value:g}" for key, value in job["at"].items())
        console.print(f"set aside: {point}: {job['reason']}")


def print_front(console: Console, record: Record) -> None:
    """Print the designs of a front in the order of the varied number."""
    rows = list[tuple[str, ...]]()
    for point in record["points"]:
        if point["objective"] is None:
            rows.append((number(point["value"]), "", "", "", "", f"{spelled(point['status'])}: {point['message']}"))
            continue
        scalars = (number(point[key]) for key in ("value", "objective", "speed", "spectral_radius"))
        checked = "verified" if point["verification"]["passed"] else "REFUTED"
        rows.append((*scalars, "front" if point["pareto"] else "beaten", checked))
    columns = (record["over"].partition("=")[0], "objective", "speed [m/s]", "radius", "", "")
    section(console, record["problem"], columns, rows, numbers=(0, 1, 2, 3))


def print_optima(console: Console, optima: Sequence[Optimum], starts: int) -> None:
    """Print one line per distinct solution of many starts."""
    converged = sum(len(optimum.starts) for optimum in optima)
    console.print(f"{counted(starts, 'start')}: {converged} found a gait, {len(optima)} of them distinct")
    for optimum in optima:
        times = f"{len(optimum.starts)} start{'s' if len(optimum.starts) > 1 else ''}"
        checked = "verified" if optimum.verified else "REFUTED"
        gait = f"period {optimum.record['period']:.6g} s, radius {optimum.radius:.4g}"
        console.print(f"  objective {optimum.objective:.9g}, {gait}, {times}, {checked}")


def print_proof(console: Console, record: Record) -> None:
    """Print a theorem and its claims, with bounds that are rounded for reading; the JSON has all digits."""
    verdict = "proved" if record["proved"] else "NOT PROVED"
    if not record["statement"]:  # proofs do not cover this gait
        console.print(f"{verdict}: {record['claims'][0]['words']}", style="bold")
        return
    undecided = ", stability undecided" if record["multipliers"] else ""  # a bracket of a special point has none
    stability = {True: ", stable", False: ", unstable", None: undecided}[record["stable"]]
    console.print(f"{record['problem']}: {verdict}{stability}", style="bold")
    section(console, "statement", ("hypothesis", "value"), _theorem_rows(record["statement"]))
    claims = (
        (c["claim"], "yes" if c["proved"] else "NO", f"{float(c['margin']):.3g}" if c["margin"] else "")
        for c in record["claims"]
    )
    section(console, "claims", ("claim", "proved", "margin"), claims, numbers=(2,))
    for claim in record["claims"]:
        if not claim["proved"]:
            console.print(f"{claim['claim']}: {claim['words']}")
    bounds = {**(record["state"] or {}), **{name: record.get(name) for name in SCALARS}}
    rows = [(name, enclosure(*value)) for name, value in bounds.items() if value is not None]
    if record.get("interval"):
        (lower, _, unit), (upper, _, _) = (end.strip().partition(" ") for end in record["interval"].split(".."))
        rows.append((record["parameter"], f"{enclosure(lower, upper)} {unit}".rstrip()))
    for k, m in enumerate(record["multipliers"], start=1):
        re, im = enclosure(*m["re"]), enclosure(*m["im"])
        rows.append((f"multiplier {k}", re if im == "0" else f"{re}, im {im}"))
    if rows:
        section(console, "bounds, rounded; --json prints all digits", ("quantity", "value"), rows)


def enclosure(lower: str, upper: str) -> str:
    """The text of an interval of decimal numbers: its middle and half of its width, rounded for reading."""
    low, high = Decimal(lower), Decimal(upper)
    middle, half = (low + high) / 2, (high - low) / 2
    digits = LONGEST_BOUND if not half else middle.adjusted() - half.adjusted() + 1
    text = f"{float(middle):.{min(max(digits, 1), LONGEST_BOUND)}g}"
    return f"{text} ± {float(half):.1g}" if half else text


def print_replay(console: Console, record: Record) -> None:
    """Print a gait in another engine at one setting: a row per time step."""
    console.print(
        f"{record['problem']} in {record['engine']} {record['version']}, setting {record['setting']}", style="bold"
    )
    slip, steps = record["slip"], range(len(record["dt"]))
    columns = ("dt [s]", "error", "before impact", "creep [m]", *(f"{way.split('_')[1]} [mm]" for way in slip["gait"]))
    columns += ("missed", "invented", "modes", "impact", "energy", "s/s", "")
    rows = [
        (
            number(record["dt"][k]),
            *(_brief(record[name][k]) for name in ("state_error", "error_before_impact", "creep")),
            *(_brief(values[k], 1e3, ".4f") for values in slip["engine"].values()),
            *(_brief(record[name][k], 1.0, ".3f") for name in ("slip_missed", "slip_invented")),
            "ok" if record["sequence_matches"][k] else "-",
            *(_brief(record[name][k]) for name in ("impact_error", "energy_error", "seconds_per_second")),
            "" if record["ending"][k] == "completed" else record["ending"][k],
        )
        for k in steps
    ]
    section(console, "one cycle", columns, rows, numbers=range(len(columns) - 1))
    stated = ", ".join(f"{way.split('_')[1]} {_brief(value, 1e3, '.4f')} mm" for way, value in slip["gait"].items())
    console.print(f"slip of the gait: {stated}")
    orders = (record["order"], record["order_before_impact"])
    console.print("observed order: {}, before the impact {}".format(*(_brief(order, 1.0, ".2f") for order in orders)))
    largest = record["largest_dt"]
    console.print(f"modes are right up to dt = {largest:g} s" if largest else "modes are right at no time step")
    verdict = {True: "consistent with the gait", False: "NOT consistent with the gait", None: "consistency unknown"}
    console.print(f"{verdict[record['consistent']]}: {record['consistent_reason']}")


def _brief(value: float | None, unit: float = 1.0, digits: str = ".1e") -> str:
    return "-" if value is None else format(unit * value, digits)


def _theorem_rows(statement: Record) -> list[tuple[str, str]]:
    """Hypotheses of a theorem with their values, and statements that it does not prove."""
    rows = [
        (k, value[:SHOWN_DIGEST] if k == "sha256" else value)
        for k, value in statement.items()
        if isinstance(value, str)
    ]
    rows += [(f"text {name}", value[:SHOWN_DIGEST]) for name, value in statement.get("texts", {}).items()]
    rows += [(f"changed {key}", str(value)) for key, value in statement.get("changed", {}).items()]
    rows += [*statement.get("walker_data", {}).items()]
    rows += [(f"control.{key}", value) for key, value in statement.get("law", {}).items()]
    designed = statement.get("designed", ())
    rows += [
        (key, f"{value} (designed)" if key in designed else value)
        for key, value in statement.get("parameters", {}).items()
    ]
    rows += [("not proved", text) for text in statement.get("not_proved", ())]
    inner = _theorem_rows(statement["reference"]) if "reference" in statement else []
    return rows + [(f"law's gait: {key}", value) for key, value in inner]


def printed(result: Any, *, titled: bool = False) -> str:
    """The printed table of a result as a block of HTML; ``titled``: below a line that says what the result is."""
    plain: Any = {"markup": False, "highlight": False, "emoji": False, "force_jupyter": False}  # not shown by itself
    console = Console(record=True, file=StringIO(), width=WIDTH, **plain)
    if titled:
        console.print(repr(result).strip("<>"), style="bold")
    print_result(result, console)
    return console.export_html(inline_styles=True, code_format=BLOCK)


@singledispatch
def print_result(result: Any, console: Console) -> None:
    """Print a result."""
    raise TypeError(f"a {type(result).__name__} has no table")


@print_result.register
def _(result: Gait, console: Console) -> None:
    if result.converged:
        print_gait(console, result.to_record(), result.problem)
    else:
        console.print(f"{result.problem.name}: {result.status}: {result.message}")


@print_result.register
def _(result: NonlinearProgram, console: Console) -> None:
    unknowns = Counter((label.name, label.unit) for label in result.x_labels)
    kinds = (
        "equation" if lower == upper else "inequality" for lower, upper in zip(result.lbg, result.ubg, strict=True)
    )
    rows = Counter((label.name, kind) for label, kind in zip(result.g_labels, kinds, strict=True))
    section(console, "unknowns", ("", "unit", "count"), ((*key, str(n)) for key, n in unknowns.items()), numbers=(2,))
    section(console, "constraints", ("", "", "count"), ((*key, str(n)) for key, n in rows.items()), numbers=(2,))


@print_result.register
def _(result: Trajectory, console: Console) -> None:
    rows = [
        (
            str(k),
            mode_words(mode for mode, _ in step.phases),
            "-" if step.impact is None else step.impact.mode.brief,
            number(step.period),
            "-" if step.impact is None else number(step.impact.step_length),
        )
        for k, step in enumerate(result.steps, start=1)
    ]
    section(console, "steps", ("", "phases", "impact", "time [s]", "length [m]"), rows, numbers=(0, 3, 4))
    console.print(result.message)


print_result.register(Problem, lambda problem, console: print_problem(console, problem))
print_result.register(Walk, lambda walk, console: print_walk(console, walk.to_record(), walk.problem))
print_result.register(Derivatives, lambda found, console: print_derivatives(console, found.to_record()))
print_result.register(Verification, lambda checked, console: print_verification(console, checked.to_record()))
print_result.register(Gaits, lambda gaits, console: print_gaits(console, gaits.to_record()))
print_result.register(Explanation, lambda why, console: print_explanation(console, why.to_record()))
print_result.register(Basin, lambda basin, console: print_basin(console, basin.to_record()))
print_result.register(Attractors, lambda attractors, console: print_attractors(console, attractors))
print_result.register(Robustness, lambda robust, console: print_robustness(console, robust))
print_result.register(Atlas, lambda atlas, console: print_atlas(console, atlas.to_record()))
print_result.register(Sweep, lambda sweep, console: print_sweep(console, sweep.to_record()))


@print_result.register
def _(result: Branch, console: Console) -> None:
    problem = result.points[0].gait.problem if result.points else None
    print_branch(console, result.to_records(), result.parameter, problem)


@print_result.register
def _(result: Front, console: Console) -> None:
    record = {"problem": result.problem.name, "over": result.key, "points": result.to_records()}
    print_front(console, record)
