"""The robustness of a gait on an uncertain floor: figures that are computed one by one and stored in the run folder.

One job computes one figure: the stable interval of a parameter, the limit of a patch of one kind and length, the limit
of a push of one rate in one direction, the nearest state that fails, the sensitivity norm, the falls of a group of
walks, or the metastable eigenvalue.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gaitopt.branches.request import Request, check_parameter
from gaitopt.callbacks import Stop
from gaitopt.display import Reported
from gaitopt.errors import SolveError
from gaitopt.gait.frames import data_frame
from gaitopt.gait.gait import Gait, require_converged, require_gait
from gaitopt.gait.records import FigureRecord, RobustnessRecord
from gaitopt.problem.floor import QUANTITIES, Floor, RandomFloor
from gaitopt.problem.problem import Problem
from gaitopt.requests import Engine, RobustnessRequest
from gaitopt.runs.jobs import Plan, ResultFile, all_results
from gaitopt.simulation.engine import choose_engine
from gaitopt.simulation.ground import check_floor, may_vary
from gaitopt.store.formats import json_file
from gaitopt.store.run import Run
from gaitopt.threads import cached_property
from gaitopt.uncertainty.falls import count_falls, mean_steps, metastable
from gaitopt.uncertainty.interval import stable_interval
from gaitopt.uncertainty.limits import KINDS, LENGTHS, Limit, nearest_failure, patch_limit, push_limit, pushed_rates
from gaitopt.uncertainty.norm import sensitivity_norm
from gaitopt.workers.jobs import Job, ResumableJobs, key_of

if TYPE_CHECKING:
    from pandas import DataFrame

ROBUSTNESS_FILE = "robustness.json"
FIGURES = ResultFile(name="figures.jsonl", key="job", model=FigureRecord)
PUSH, FALLS, EIGENVALUE = "push", "falls", "eigenvalue"
WALKS_AT_ONCE = 500
"""Number of walks in one job that counts falls. Such a job takes a few seconds; a kill loses no more work than that."""
SPREAD = 0.2
"""Largest difference of random friction from the nominal one by default, relative to the nominal one."""
UNLIKELY = 0.5 * 2**0.5
"""A value that no problem states. A parameter is checked by a request to continue to this value, which is not run."""
MANY_STEPS = 1_000_000
"""The engine is chosen as for this number of steps, which the longest figures take."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Robustness(Reported):
    """The figures that describe how robust a gait is.

    Attributes
    ----------
    problem : problem of the gait.
    figures : values of all figures by their names, such as ``patch:friction_low:1``.
    folder : folder of its files.
    """

    problem: Problem
    figures: Mapping[str, Any]
    folder: Path | None = None

    def __repr__(self) -> str:
        return f"<Robustness {self.problem.name}: {', '.join(key for key in self.to_record() if key != 'problem')}>"

    def to_record(self) -> dict[str, Any]:
        """One JSON object, with the keys of ``gaitopt robustness --json``."""
        record: dict[str, Any] = {"problem": self.problem.name}
        for name, value in self.figures.items():
            group, *keys = name.split(":")
            if group == "patch":
                record.setdefault("patch", {}).setdefault(keys[0], {})[keys[1]] = shown_limit(keys[0], value)
            elif group == PUSH:
                record.setdefault(PUSH, {}).setdefault(keys[0], [None, None])[int(keys[1])] = value["value"]
            elif group == "range":
                record["range"] = {keys[0]: value}
            elif name == FALLS or group not in (FALLS, EIGENVALUE):  # earlier versions stored all falls as one figure
                record[group] = value
        if falls := [value for name, value in self.figures.items() if name.startswith(f"{FALLS}:")]:
            record[FALLS] = _falls_record(falls) | _eigenvalue_record(self.figures[EIGENVALUE])
        return record

    def to_frame(self) -> "DataFrame":
        """One row per number: its keys, joined by dots, and the value."""
        rows = list[tuple[str, Any]]()

        def collect(prefix: str, value: Any) -> None:
            if isinstance(value, Mapping):
                for key, inner in value.items():
                    collect(f"{prefix}.{key}" if prefix else str(key), inner)
            elif isinstance(value, list):
                for key, inner in zip(("low", "high"), value, strict=False):
                    collect(f"{prefix}.{key}", inner)
            else:
                rows.append((prefix, value))

        collect("", {key: value for key, value in self.to_record().items() if key != "problem"})
        return data_frame(("figure", "value"), rows, {"figure": "", "value": ""}, problem=self.problem.name)

    @property
    def strips(self) -> dict[str, dict[str, list[Limit]]]:
        """The values that were tried, by kind of patch and number of tiles, and under ``push`` by rate, down and up."""
        found = dict[str, dict[str, list[Limit]]]()
        for name, value in self.figures.items():
            group, *keys = name.split(":")
            if group in ("patch", PUSH):
                kind, row = (PUSH, keys[0]) if group == PUSH else keys
                tried, survived = tuple(value["tried"]), tuple(map(bool, value["survived"]))
                limit = Limit(value=value["value"], tried=tried, survived=survived)
                found.setdefault(kind, {}).setdefault(row, []).append(limit)
        return found


def _falls_record(groups: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The record of the falls of all walks, from the records of groups of walks."""
    completed = np.concatenate([group["completed"] for group in groups])
    mean, interval = mean_steps(completed)
    endings = Counter[str]()
    for group in groups:
        endings.update(group["endings"])
    return {
        "mean_steps": mean,
        "interval": list(interval),
        "walks": completed.size,
        "steps": int(np.abs(completed).sum()),
        "endings": dict(endings),
        "floor": groups[0]["floor"],
        "seed": groups[0]["seed"],
    }


def _eigenvalue_record(found: Mapping[str, Any] | float | None) -> dict[str, Any]:
    """The metastable eigenvalue, from its figure; earlier versions stored the number alone."""
    if not isinstance(found, Mapping):
        return {EIGENVALUE: found}
    steps = {name: found[name] for name in ("mean_steps", "interval")}
    return {EIGENVALUE: found[EIGENVALUE], "metastable": steps, f"{EIGENVALUE}_reason": found["reason"]}


def shown_limit(kind: str, value: Mapping[str, Any]) -> float | None:
    """The limit of a patch as it is shown: a coefficient of friction, or a step or slope without its sign."""
    limit = value["value"]
    return None if limit is None else float(limit) if kind.startswith("friction") else abs(float(limit))


def read_robustness(folder: Path) -> Robustness:
    """The result in a subfolder of the run of its problem."""
    run = Run.at(folder)
    stated = run.read_record(ROBUSTNESS_FILE, RobustnessRecord)
    figures = {record["figure"]: record["value"] for record in FIGURES.finished(run, stated["jobs"])}
    return Robustness(problem=run.problem(), figures=figures, folder=folder)


def check_question(problem: Problem, request: RobustnessRequest) -> None:
    """Refuse a parameter or a distribution that is wrong for a problem, before its gait is solved.

    Raises
    ------
    UnknownNameError, ProblemError
        See ``gaitopt.robustness``.
    """
    choose_engine(request.engine, steps=MANY_STEPS)
    if request.over is not None and "range" in request.groups:
        check_parameter(problem, request.over)
    if request.random is not None:
        RandomFloor.parse(request.random, request.seed)


@dataclass(frozen=True, kw_only=True)
class RobustnessPlan(Plan[Robustness], RobustnessRequest):
    """Figures to be computed.

    Attributes
    ----------
    gait : the gait that is examined.
    """

    results = FIGURES
    gait: Gait

    @cached_property
    def run(self) -> Run:
        """The run, with the subfolder of the files."""
        return Run(self.folder, f"robustness-{key_of([job.key for job in self.jobs])[:8]}")

    @property
    def key(self) -> str:
        """The parameter of the interval."""
        return self.over or self.problem.friction_law.parameters[0]

    @property
    def floor(self) -> RandomFloor:
        """The distribution of the tiles on which falls are counted."""
        nominal = self.gait.dynamics.static_friction
        default = f"friction={(1 - SPREAD) * nominal:.12g}:{(1 + SPREAD) * nominal:.12g}"
        return RandomFloor.parse(self.random or default, self.seed)

    def check(self) -> None:
        """Refuse gaits that are not stable, and floors on which the walker cannot walk."""
        require_gait(self.gait, "robustness")
        require_converged(self.gait)
        if not self.gait.stable:
            radius = self.gait.scalar("spectral_radius")
            error = SolveError(
                f"{self.problem.name} is unstable, its spectral radius is {radius:.6g}, so that no walk returns to it; "
                "`gaitopt stabilise` finds a law that walks it stably"
            )
            error.result = replace(self.gait, message=str(error))
            raise error
        groups = self.groups
        if "range" in groups:
            Request(parameter=self.key, to=(UNLIKELY,)).first_gait(self.gait)
        if {"patch", "sensitivity", FALLS} & {*groups}:
            check_floor(self.gait.system, Floor(friction=1.0))
        if FALLS in groups and not self.floor.is_even:
            check_floor(self.gait.system, self.floor.draw(2))
        _ = self.jobs

    def result(self, jobs: ResumableJobs) -> Robustness:
        """The result with all figures."""
        records = all_results(jobs, figure_job, self.jobs, "figure")
        self.run.write({ROBUSTNESS_FILE: json_file({"jobs": [job.key for job in self.jobs]})})
        figures = {record["figure"]: record["value"] for record in records}
        return Robustness(problem=self.problem, figures=figures, folder=self.run.result_folder)

    @cached_property
    def jobs(self) -> list[Job]:
        """One job per figure."""
        engine = choose_engine(self.engine, steps=MANY_STEPS)
        varied = {name for name in QUANTITIES if may_vary(self.gait.system, name)}
        fitting = [kind for kind in KINDS if kind.replace("step", "height").rpartition("_")[0] in varied]
        of_group: dict[str, list[str]] = {
            "range": [f"range:{self.key}"],
            "patch": [f"patch:{kind}:{length}" for kind in fitting for length in LENGTHS],
            PUSH: [f"{PUSH}:{rate}:{side}" for rate in pushed_rates(self.gait) for side in (0, 1)] + ["nearest"],
            "sensitivity": ["sensitivity"],
            FALLS: [*(f"{FALLS}:{first}" for first in range(0, self.walks, WALKS_AT_ONCE)), EIGENVALUE],
        }
        names = [name for group in self.groups for name in of_group[group]]
        request = RobustnessRequest(**{**self.arguments, "engine": engine})
        state = [f"{value:.9g}" for value in self.gait.state]  # a stored gait has other last digits
        jobs = list[Job]()
        for name in names:
            group, *numbers = name.split(":")
            seeded: list[Any] = [self.seed] if group in ("nearest", FALLS, EIGENVALUE) else []
            if group in (FALLS, EIGENVALUE):
                seeded.append(str(self.floor))
            if group == EIGENVALUE:
                seeded.append("weighted walks")
            if group == FALLS:
                seeded += [min(self.walks, int(numbers[0]) + WALKS_AT_ONCE), self.steps]
            identity = [self.problem.digest, state, name, *seeded, engine]
            jobs.append(Job(key=key_of(identity), argument=(self.gait, name, self.floor, request)))
        return jobs


def figure_job(
    argument: tuple[Gait, str, RandomFloor, RobustnessRequest], _: None = None, should_stop: Stop = None
) -> dict[str, Any]:
    """The job of one figure, in any process; returns its record."""
    gait, name, floor, request = argument
    group, *keys = name.split(":")
    engine = Engine(request.engine)
    value: Any
    if group == "range":
        value = asdict(stable_interval(gait, keys[0], should_stop=should_stop))
    elif group == "patch":
        whole = keys[0] == "friction_low"
        value = _limit_record(patch_limit(gait, keys[0], int(keys[1]), engine, whole=whole, should_stop=should_stop))
    elif group == PUSH:
        value = _limit_record(push_limit(gait, keys[0], (-1, 1)[int(keys[1])], engine, should_stop=should_stop))
    elif group == "nearest":
        nearest = nearest_failure(gait, engine, seed=request.seed, should_stop=should_stop)
        distance, state = (None, None) if nearest is None else nearest
        value = {"distance": distance, "state": None if state is None else dict(state)}
    elif group == "sensitivity":
        value = sensitivity_norm(gait)
    elif group == EIGENVALUE:
        value = metastable(gait, floor, engine, should_stop=should_stop)
    else:
        first = int(keys[0])
        completed, endings = count_falls(
            gait, floor, first=first, walks=min(WALKS_AT_ONCE, request.walks - first), steps=request.steps,
            engine=engine, should_stop=should_stop,
        )  # fmt: skip
        falls = {"completed": completed.tolist(), "endings": endings}
        value = falls | {"floor": str(floor), "seed": floor.seed}
    return {"figure": name, "value": value}


def _limit_record(limit: Limit) -> dict[str, Any]:
    return {"value": limit.value, "tried": list(limit.tried), "survived": [int(each) for each in limit.survived]}
