"""Several gaits as tables: searches, families, basins, sweeps, fronts and many starts, from their JSON records."""

from collections.abc import Mapping, Sequence
from typing import Any

from rich.console import Console

from gaitopt.gait import TERMINAL
from gaitopt.gait.cascade import cascades
from gaitopt.library.print_gait import STABILITY
from gaitopt.library.tables import number, section, with_degrees
from gaitopt.mechanics import Cycle
from gaitopt.problem.scalars import unit_of
from gaitopt.runs.multistart import Optimum

Record = Mapping[str, Any]


def sequence(record: Record) -> str:
    """The mode sequence of the record of a gait."""
    steps = [str(step) for step in Cycle.from_record(record).steps]
    return f"{len(steps)} times {steps[0]}" if len(steps) > 1 and len(set(steps)) == 1 else " | ".join(steps)


def print_gaits(console: Console, record: Record) -> None:
    """What a search has found, one line per gait, and what was searched."""
    searched = record["searched"]
    tried = ", ".join(f"{count} of {method}" for method, count in searched["starts"].items())
    console.print(f"{record['problem']}: {len(record['gaits'])} gaits from {tried}", style="bold")
    if record["gaits"]:
        _print_list(console, "gaits", record["gaits"])
    for lost in searched["rejected"]:
        console.print(f"no gait: {lost['sequence']}, from {len(lost['starts'])} starts: {lost['reason']}")
    for reason in searched["failed"]:
        console.print(f"a part of the search failed: {reason}")


def print_explanation(console: Console, record: Record) -> None:
    """Why there is no gait, what happens instead, and where it begins to exist."""
    if record["exists"]:
        console.print(f"{record['problem']}: this gait exists; `gaitopt solve` shows it", style="bold")
        return
    console.print(f"{record['problem']}: there is no such gait", style="bold")
    for cause in record["causes"]:
        console.print(f"  {cause['words']}")
    if record["simulated"]:
        walk = record["simulated"]
        console.print(f"from the guess: {walk['steps']} steps, {walk['status']}: {walk['message']}")
    for nearest in record["nearest"]:
        where = f"{nearest['parameter']} = {nearest['value']:.10g}"
        console.print(f"the phases begin to exist at {where} ({_words(nearest['type'])}): {nearest['reason']}")
    if record["instead"]:
        _print_list(console, "gaits that there are", record["instead"])
    else:
        console.print("no gait of any other mode sequence was found here")


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


def print_branch(console: Console, records: Sequence[Record], parameter: str) -> None:
    """The branches of a family, what happens on them, and its cascades; records may state their ``sequence``."""
    specials = [record for record in records if record["record"] == "special"]
    unit = unit_of(parameter)
    rows = list[tuple[str, ...]]()
    for branch in sorted({record["branch"] for record in records if record["record"] == "point"}):
        points = [record for record in records if record["record"] == "point" and record["branch"] == branch]
        radii = [point["spectral_radius"] for point in points]
        own = [s for s in specials if s["branch"] == branch and (s["next"] or s["type"] in TERMINAL)]
        joints = [" -> ".join(filter(None, (_words(s["type"]), ", ".join(map(str, s["next"]))))) for s in own]
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
    columns = ("branch", "mode sequence", *between, "points", "|multiplier|", "joints")
    section(console, "branches", columns, rows, numbers=(2, 3, 4))
    for k, special in enumerate(specials):
        guess = "" if special["status"] == "converged" else " (only bracketed)"
        place = f"{special['value']:.12g} {with_degrees(special['value'], unit)}".rstrip()
        console.print(f"{k}: branch {special['branch']}, {place}{guess}: {event(special)}")
    for cascade in cascades(records):
        console.print(f"cascade: {cascade}")


def event(special: Record) -> str:
    """What happens at a special point."""
    return ": ".join(filter(None, (_words(special["type"]), special["reason"])))


def print_basin(console: Console, record: Record) -> None:
    """The gaits that states settle on, and how the others fail."""
    gaits = [
        (str(k), g["kind"], f"{g['states']:,}", f"{g['share']:.2%}", f"{', '.join(g['phases'])}; {g['impact']}")
        for k, g in enumerate(record["gaits"])
    ]
    failures = sorted(record["failures"].items(), key=lambda failure: -failure[1])
    failed = [("", _words(name), f"{n:,}", f"{n / record['states']:.2%}", "") for name, n in failures]
    title = f"{record['problem']}: {record['states']:,} states"
    section(console, title, ("", "ends on", "states", "share", "modes; impact"), [*gaits, *failed], numbers=(0, 2, 3))


def print_sweep(console: Console, record: Record) -> None:
    """How many points of a grid have a gait, and what became of the others."""
    statuses = ", ".join(f"{count} {_words(status)}" for status, count in record["statuses"].items())
    console.print(f"{record['problem']}: {record['jobs']} jobs, {statuses}")
    console.print(f"verified: {record['verified']}" + (f", REFUTED: {record['refuted']}" if record["refuted"] else ""))
    for job in record["set_aside"]:
        place = ", ".join(f"{key} = {value:g}" for key, value in job["at"].items())
        console.print(f"set aside: {place}: {job['reason']}")


def print_front(console: Console, record: Record) -> None:
    """The designs of a front in the order of what is varied."""
    rows = list[tuple[str, ...]]()
    for point in record["points"]:
        if point["objective"] is None:
            rows.append((number(point["value"]), "", "", "", "", f"{_words(point['status'])}: {point['message']}"))
            continue
        scalars = (number(point[key]) for key in ("value", "objective", "speed", "spectral_radius"))
        checked = "verified" if point["verification"]["passed"] else "REFUTED"
        rows.append((*scalars, "front" if point["pareto"] else "beaten", checked))
    columns = (record["over"].partition("=")[0], "objective", "speed [m/s]", "radius", "", "")
    section(console, record["problem"], columns, rows, numbers=(0, 1, 2, 3))


def print_optima(console: Console, optima: Sequence[Optimum], starts: int) -> None:
    """One line per distinct solution of many starts."""
    converged = sum(len(optimum.starts) for optimum in optima)
    console.print(f"{starts} starts: {converged} found a gait, {len(optima)} of them distinct")
    for optimum in optima:
        times = f"{len(optimum.starts)} start{'s' if len(optimum.starts) > 1 else ''}"
        checked = "verified" if optimum.verified else "REFUTED"
        gait = f"period {optimum.record['period']:.6g} s, radius {optimum.radius:.4g}"
        console.print(f"  objective {optimum.objective:.9g}, {gait}, {times}, {checked}")


def _words(name: str) -> str:
    return name.replace("_", " ")
