"""Processor time of two versions of the package, row by row: ``python benchmarks/paired.py --before COMMIT``.

A process of each version measures the same rows, a row's first call apart from the later ones, and the two take turns
call by call, so that other work on the machine disturbs both alike. The smallest processor time of each row counts. A
ratio above one means that the later version is slower.

A version is a commit, which gets a work tree of its own for the time of the measurement, or a folder. Both run in the
environment of this interpreter, so that only the package differs; its entry points are those of its own version.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import Any

TURNS = 5
"""Turns of each version at the later calls of a row."""
SLICE = 0.1
"""Processor time of a turn; it ends with the call that exceeds it [s]."""
CYCLES = 20
"""Number of cycles of a simulated walk, if the gait is stable."""
GAITS = (
    "compass-passive-a",
    "compass-passive-stick",
    "compass-passive-static-kinetic",
    "compass-passive-two-step",
    "compass-pd-impact-slip",
    "rimless-wheel-slip",
    "kneed-passive",
    "heel-toe",
    "crawler",
    "flat-foot",
)
FAMILIES = {
    "compass-passive-stick": ("friction", 0.16),
    "compass-passive-a": ("friction", 0.125),
    "kneed-passive": ("walker.slope", 0.0488692),
    "heel-toe": ("friction", 0.6),
}
"""Parameter and target of the continuations."""
PROCESSES = {"gaitopt --help": ["--help"], "gaitopt solve compass-passive-a": ["solve", "compass-passive-a", "--json"]}
"""Whole processes, imports included."""
ROOT = Path(__file__).resolve().parent.parent


def main() -> None:
    """Measure both versions in turn, print the table, write JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--before", help="commit or folder of the earlier version")
    parser.add_argument("--after", default=str(ROOT), help="commit or folder of the later version; this one by default")
    parser.add_argument("--rounds", type=int, default=3, help="processes of each version")
    parser.add_argument("--gaits", nargs="+", default=GAITS, metavar="PROBLEM", help="measure these problems only")
    parser.add_argument("--json", type=Path, help="where to write the rows")
    parser.add_argument("--measure", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.measure:
        steps = measured(options.gaits)
        while sys.stdin.readline():
            print(json.dumps(next(steps, None)), flush=True)
        return
    if options.before is None:
        parser.error("--before is required: the commit of the last release, or a folder")
    with (
        tempfile.TemporaryDirectory() as scratch,
        version(options.before, Path(scratch) / "before") as (before, tree_before),
        version(options.after, Path(scratch) / "after") as (after, tree_after),
    ):
        trees = (tree_before, tree_after)
        gaits = [
            name for name in options.gaits if all((tree / "problems" / f"{name}.yaml").is_file() for tree in trees)
        ]
        if missing := set(options.gaits).difference(gaits):
            print(f"not in both versions: {', '.join(sorted(missing))}", file=sys.stderr)
        shortest: list[dict[str, float]] = [{}, {}]
        for number in range(options.rounds):
            for times, (name, seconds) in one_round((before, after), gaits):
                shortest[times][name] = min(shortest[times].get(name, seconds), seconds)
            print(f"round {number + 1} of {options.rounds}", file=sys.stderr)
    rows = [
        {
            "what": name,
            "before": seconds,
            "after": shortest[1].get(name),
            "ratio": shortest[1].get(name, float("nan")) / seconds,
        }
        for name, seconds in shortest[0].items()
    ]
    width = max((len(row["what"]) for row in rows), default=0)
    print(f"{'':{width}}  {'before':>10}  {'after':>10}  ratio")
    for row in rows:
        after_ms = "-" if row["after"] is None else f"{1e3 * row['after']:.2f} ms"
        print(f"{row['what']:{width}}  {1e3 * row['before']:>7.2f} ms  {after_ms:>10}  {row['ratio']:.2f}")
    if options.json is not None:
        record = {"before": options.before, "after": options.after, "rounds": options.rounds, "rows": rows}
        options.json.write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")


@contextmanager
def version(name: str, scratch: Path) -> Iterator[tuple[dict[str, str], Path]]:
    """The environment in which processes import the package of a commit or of a folder, and its checkout.

    A first process compiles the bytecode.
    """
    folder, is_folder = Path(name).resolve(), Path(name).is_dir()
    if not is_folder:
        folder = scratch / "tree"
        subprocess.run(["git", "-C", str(ROOT), "worktree", "add", "--detach", "-q", str(folder), name], check=True)
    try:
        metadata = scratch / "metadata"
        entry_points(folder, metadata)
        environment = {key: value for key, value in os.environ.items() if key != "PYTHONDONTWRITEBYTECODE"}
        environment["PYTHONPATH"] = os.pathsep.join((str(folder), str(metadata)))
        environment["PYTHONPYCACHEPREFIX"] = str(scratch / "bytecode")
        process_seconds([sys.executable, "-m", "gaitopt", "solve", "rimless-wheel-stick"], environment, str(scratch))
        yield environment, folder
    finally:
        if not is_folder:
            subprocess.run(["git", "-C", str(ROOT), "worktree", "remove", "--force", str(folder)], check=True)


def entry_points(folder: Path, metadata: Path) -> None:
    """The package's entry points as an installation of this version would state them, ahead of the installed ones."""
    project = tomllib.loads((folder / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    installed = metadata / "gaitopt-0.dist-info"
    installed.mkdir(parents=True)
    (installed / "METADATA").write_text("Metadata-Version: 2.1\nName: gaitopt\nVersion: 0\n", encoding="utf-8")
    groups = {**project.get("entry-points", {}), "console_scripts": project.get("scripts", {})}
    lines = [
        line
        for group, points in groups.items()
        for line in (f"[{group}]", *(f"{key} = {at}" for key, at in points.items()))
    ]
    (installed / "entry_points.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")


def one_round(environments: Sequence[dict[str, str]], gaits: Sequence[str]) -> Iterator[tuple[int, tuple[str, float]]]:
    """Index of the version, and a row with its processor time [s], the versions in turn."""
    command = [sys.executable, __file__, "--measure", "--gaits", *gaits]
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        processes = [
            stack.enter_context(
                subprocess.Popen(command, env=env, cwd=folder, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
            )
            for env in environments
        ]
        running = True
        while running:
            for index, process in enumerate(processes):
                print(file=process.stdin, flush=True)
                answer = process.stdout.readline()
                if not answer:
                    raise SystemExit(f"version {index + 1} fails; its error is above")
                row = json.loads(answer)
                running = row is not None
                if running:
                    yield index, row
        for process in processes:
            process.stdin.close()
        for name, arguments in PROCESSES.items():
            for index, environment in enumerate(environments):
                output = ["-o", str(Path(folder) / f"run-{index}")] if "solve" in arguments else []
                whole = [sys.executable, "-m", "gaitopt", *arguments, *output]
                yield index, (name, process_seconds(whole, environment, folder))


def process_seconds(command: list[str], environment: dict[str, str], folder: str) -> float:
    """Processor time of a whole process [s]."""
    before = os.times()
    subprocess.run(command, env=environment, cwd=folder, check=True, capture_output=True)
    after = os.times()
    return after.children_user + after.children_system - before.children_user - before.children_system


def measured(gaits: Sequence[str]) -> Iterator[tuple[str, float]]:
    """Rows with their processor time in this process [s]: of each its first call, then the shortest of every turn."""
    import gaitopt as go

    made: dict[str, Any] = {}

    def timed(call: Callable[[], Any]) -> tuple[Any, float]:
        began = time.process_time()
        result = call()
        return result, time.process_time() - began

    for name in gaits:
        calls: dict[str, Callable[[], Any]] = {
            "read": partial(go.load_problem, name),
            "solve": lambda: go.solve(made["read"]),
            "verify": lambda: go.verify(made["solve"]),
            "simulate": lambda: go.simulate(made["solve"], steps=CYCLES),
        }
        if name in FAMILIES:
            key, to = FAMILIES[name]
            calls["continue"] = lambda key=key, to=to: go.continuation(made["solve"], key, to=to)
        for verb, call in calls.items():
            if verb == "simulate" and not made["solve"].spectral_radius < 1:
                continue
            row = f"{verb} {name}"
            made[verb], seconds = timed(call)
            yield f"{row}, first in a process", seconds
            for _ in range(TURNS):
                shortest, spent = float("inf"), 0.0
                while spent < SLICE:
                    _, seconds = timed(call)
                    shortest, spent = min(shortest, seconds), spent + seconds
                yield row, shortest


if __name__ == "__main__":
    main()
