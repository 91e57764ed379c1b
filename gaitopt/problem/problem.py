"""A problem: a statement with its source, loaded from a file, changed by overrides and identified by a digest.

A problem that tracks another gait contains the problem of that gait, which overrides never change.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from copy import deepcopy
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Protocol, TypeAlias, runtime_checkable

from gaitopt.errors import ProblemError, UnknownNameError
from gaitopt.model.control import Control
from gaitopt.model.cycle import Cycle
from gaitopt.model.declaration import check_class
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.modes import Mode
from gaitopt.model.open_loop import OpenLoop
from gaitopt.model.registry import (
    CONTROLS,
    OWN_PACKAGE,
    WALKERS,
    Kind,
    built_in,
    refused_controls,
    refused_walkers,
    registered_controls,
    registered_walkers,
)
from gaitopt.model.section import TOUCHDOWN
from gaitopt.model.urdf import MAX_BYTES, walker_from_text
from gaitopt.model.walker import Walker
from gaitopt.problem.faults import ChangedPlace, Fault, FilePlace, Place, fault_lines, raise_faults, shown
from gaitopt.problem.reading import Known, read_statement
from gaitopt.problem.rules import impossible, over_faults, reference_faults, remarks
from gaitopt.problem.source import SUFFIXES, find_problem, parse_source, read_text
from gaitopt.problem.statement import (
    ProblemStatement,
    changed_values,
    cycle_data,
    digest_of,
    file_entries,
    guessed_names,
    override,
    problem_data,
    reference_keys,
)

Walkers: TypeAlias = Sequence[type[Walker]]
Controls: TypeAlias = Sequence[type[Control]]
RESOLVED_FILE = "resolved.json"
"""Name of the file in a run folder that contains the resolved problem."""
FOLLOWED_FROM = "followed_from"
"""Key of a resolved problem, with the file's values of the parameters that were changed."""
GUESSED_STATE = "gait.guess.state."
"""Dotted key of a coordinate of the guess, without the name of the coordinate."""
OF_FEEDBACK = "control.step_feedback"
"""Dotted key of the feedback from step to step."""
_NONE = Known(walkers={}, controls={})
_PASSED = ContextVar("passed", default=_NONE)
"""Classes that are not registered and may occur in restored records, see ``passing``."""


@runtime_checkable
class Recorded(Protocol):
    """A gait, as ``with_guess`` and ``with_gait`` read it."""

    @property
    def dynamics(self) -> Dynamics:
        """The system of the gait at its parameters."""

    def to_record(self) -> Any:
        """The record of the gait."""


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Problem(ProblemStatement):
    """A complete, validated statement of one gait in SI units, with its source.

    A problem contains a walker with its parameters, friction and impact law, a control law, the mode sequence, a first
    guess, and for designs the free parameters, objective and constraints (see ``ProblemStatement``). It is immutable:
    ``replace`` changes values, ``with_guess``, ``with_gait`` and ``with_modes`` start from a known gait, ``with_fixed``
    turns a design into an ordinary problem. It has ``parameters``, ``remarks`` on unusual numbers, ``objection``
    (whether a value is possible), and the ``resolved`` data with their ``digest``, which identify its gait.

    Attributes
    ----------
    reference : the problem whose gait the control tracks or its curve starts from; ``replace`` never changes it.
    path, text : its file and the verbatim text, without overrides.
    origin : the problem with an open sequence whose solution this is; results are stored under its name and digest.
    file : the problem in the file, before ``replace`` changed it; None for that problem itself.
    place : locates each value: a line of the file, or an override.
    """

    reference: "Problem | None" = None
    path: Path | None = None
    text: str = ""
    place: Place = field(compare=False, repr=False)
    origin: "Problem | None" = None
    file: "Problem | None" = None

    def __hash__(self) -> int:
        return hash(self.digest)

    @property
    def remarks(self) -> tuple[str, ...]:
        """Remarks on unusual numbers, one line each with its location; empty for most problems."""
        return tuple(fault_lines(remarks(self), self.place))

    @property
    def followed_from(self) -> "Problem | None":
        """The file's problem, if this one differs only in values of continuous parameters; otherwise None.

        The gait of this problem is then the gait of the file, followed from the file's values to these. The posture of
        a guess with several contacts follows from its section coordinates and the parameters, so that it may differ.
        """
        if self.file is None or self.is_open or self.is_design or self.origin is not None:
            return None
        if self.reference != self.file.reference or type(self.walker) is not type(self.file.walker):
            return None
        before, after = self.file.parameters, self.parameters
        changed = changed_values(problem_data(self.file), problem_data(self))
        changed = [key for key in changed if not key.startswith(f"{OF_FEEDBACK}.at")]
        if self.section is not None:
            following = {
                f"{GUESSED_STATE}{name}" for name in self.walker.state_names() if name not in self.section.names
            }
            changed = [key for key in changed if key not in following]
        continuous = [key for key in changed if type(before.get(key)) is type(after.get(key)) is float]
        return self.file if changed and len(continuous) == len(changed) else None

    @property
    def nominal(self) -> "Problem | None":
        """The problem whose gait feedback from step to step leads back to; None without such feedback.

        It has no feedback, and the values and the mode sequence at which the feedback was stated.
        """
        feedback = self.control.step_feedback
        if feedback is None or not self.has_gait:
            return None
        law = self.control.model_copy(update={"step_feedback": None})
        plain = replace(self, control=law, free={}, objective={}, constraints={}, over=None, origin=None, file=None)
        return plain.replace(feedback.at).from_guess() if feedback.at else plain

    def from_guess(self) -> "Problem":
        """The same problem, to be solved from its guess: ``solve`` then does not follow the gait of the file."""
        return replace(self, file=None)

    def replace(self, overrides: Mapping[str, object] | None = None, *, label: str = "", **names: object) -> "Problem":
        """The problem with some values changed, validated as a whole.

        If only values of continuous parameters change, ``solve`` follows the gait of the unchanged problem to the new
        values. If the guess, the mode sequence or the structure changes too, it starts from the guess.

        Parameters
        ----------
        overrides : values as in the file by dotted key, for instance ``{"friction": 0.16, "walker.slope": "2 deg"}``.
        label : text before the keys in messages, such as the option that sets them.
        names : an error; pass a mapping, because most keys contain dots.

        Raises
        ------
        ProblemError
            If the result is not valid; each line names the override.
        """
        if names or not isinstance(overrides, Mapping):
            example = ", ".join(f"{key!r}: {value!r}" for key, value in names.items()) or "'friction': 0.16"
            raise ProblemError(f"replace takes one mapping of values by dotted key: replace({{{example}}})")
        faults: list[Fault] = []
        data = problem_data(self)
        overrides = {**overrides, **self._nominal_values(data, overrides)}
        overridden = override(data, overrides, faults, label)
        raise_faults(faults, overridden)
        known = {} if self.reference is None else {self.control.source[0]: self.reference}
        files = () if self.path is None else (self.path,)
        changed = build_problem(data, overridden, faults, self._classes, files, text=self.text, known=known)
        file = self if self.file is None else self.file
        same = changed.reference == file.reference and all(
            getattr(changed, entry.name) == getattr(file, entry.name) for entry in fields(ProblemStatement)
        )
        return replace(changed, place=ChangedPlace.of(self.place, overridden), file=None if same else file)

    def _nominal_values(self, data: Mapping[str, Any], overrides: Mapping[str, object]) -> dict[str, object]:
        """The override that keeps the values which others change for the nominal gait of feedback from step to step."""
        feedback = self.control.step_feedback
        if feedback is None or "control" in overrides or any(key.startswith(OF_FEEDBACK) for key in overrides):
            return {}
        kept = dict(feedback.at or {})
        for key in overrides:
            of_gait = key == "gait" or key.startswith("gait.")
            if of_gait and "gait" in data:
                kept.setdefault("gait", deepcopy(data["gait"]))
            elif key in self.parameters:
                kept.setdefault(key, self.parameters[key])
        return {f"{OF_FEEDBACK}.at": kept} if kept else {}

    def at_own_value(self) -> "Problem":
        """The problem of one gait of a design over a range: that at the problem's own value. Others are unchanged."""
        return self if self.over is None else replace(self, over=None, origin=self)

    def with_guess(
        self, gait: "Recorded | Mapping[str, Any]", parameters: Mapping[str, float] | None = None
    ) -> "Problem":
        """The problem with a known gait as its first guess; the modes stay those of the problem.

        Its durations are used if the phases are the same, and its slip velocity if the impact is the same.

        Parameters
        ----------
        gait : a gait of the same walker model, or its record, see ``Gait.to_record``.
        parameters : parameters of that gait by dotted key, control points of a curve as ``control.reference.JOINT.K``;
            they become the guesses of free numbers and curves. By default those of the gait or of its record.

        Raises
        ------
        ProblemError
            If the gait is a failed solve, or belongs to another walker; or for the reasons of ``replace``.
        """
        record, known = self._record_of(gait)
        values = known if parameters is None else parameters
        same_impact = Mode.from_record(record["impact"]) == self.cycle.impact
        names = guessed_names(type(self.walker), self.cycle, self.cycle_end)
        state = {name: record["state"][name] for name in names if same_impact or name != "dx"}
        same_phases = [Mode.from_record(phase) for phase in record["phases"]] == list(self.cycle.phases)
        changes: dict[str, object] = {f"{GUESSED_STATE}{name}": value for name, value in state.items()}
        if same_phases:
            changes["gait.guess.durations"] = [phase["duration"] for phase in record["phases"]]
        changes |= self.control.guesses(values, type(self.walker))
        return self.replace(changes | self.free_guesses(values))

    def with_gait(self, gait: "Recorded | Mapping[str, Any]") -> "Problem":
        """The problem with the modes of a known gait and its motion as the guess.

        It raises for the same reasons as ``with_guess``.

        Parameters
        ----------
        gait : a gait or its record, or the record of a candidate, which has the steps, or the phases and the impact,
            ``state`` and ``parameters``.
        """
        record, values = self._record_of(gait)
        cycle = Cycle.from_record(record)
        phases = [phase for step in record.get("steps", (record,)) for phase in step["phases"]]
        durations = [phase["duration"] for phase in phases]
        return self.with_modes(cycle, record["state"], durations, values)

    def _record_of(self, gait: "Recorded | Mapping[str, Any]") -> tuple[Mapping[str, Any], Mapping[str, float]]:
        """The record of a known gait, and its parameters by dotted key.

        Raises
        ------
        ProblemError
            If the gait is a failed solve, or lacks a coordinate of the walker.
        """
        if isinstance(gait, Mapping):
            return gait, gait.get("parameters", {})
        if not isinstance(gait, Recorded):
            raise ProblemError(f"expected a gait or its record, not a {type(gait).__name__}")
        record = gait.to_record()
        name, state = record["problem"], record["state"]
        if not state:
            raise ProblemError(f"{name} is {record['status']}: it has no motion from which {self.name} could start")
        missing = [entry for entry in self.walker.state_names() if entry not in state]
        if missing:
            reason = f"it is a gait of another walker than the {self.walker.model} of {self.name}"
            raise ProblemError(f"{name} has no {missing[0]}: {reason}")
        return record, gait.dynamics.parameters

    def with_modes(
        self,
        cycle: Cycle,
        state: Mapping[str, float],
        durations: Sequence[float] | None = None,
        parameters: Mapping[str, float] | None = None,
    ) -> "Problem":
        """The problem with another mode sequence. It raises for the same reasons as ``replace``.

        Parameters
        ----------
        cycle : the mode sequences of the steps.
        state : guess of the state just after the last impact by name; only section coordinates are used.
        durations : guess of the durations of the phases [s]. By default those of the problem, if its steps have the
            same numbers of phases.
        parameters : guesses of free numbers by dotted key.
        """
        if durations is None and not self.is_open and _phase_numbers(cycle) == _phase_numbers(self.cycle):
            durations = self.guess.durations
        names = guessed_names(type(self.walker), cycle, self.cycle_end)
        guess: dict[str, Any] = {"state": {name: float(state[name]) for name in names}}
        guess |= {} if durations is None else {"durations": list(durations)}
        gait = {**cycle_data(cycle.untimed), "guess": guess}
        if self.cycle_end != TOUCHDOWN:
            gait["section"] = problem_data(self).get("gait", {"section": self.cycle_end})["section"]
        return self.replace({"gait": gait, **self.free_guesses(parameters or {})})

    def free_guesses(self, values: Mapping[str, float]) -> dict[str, object]:
        """Overrides that make known values the guesses of the free numbers, clipped to their bounds."""
        return {key: free.near(values[key]).record for key, free in self.free.items() if key in values}

    def with_fixed(self, values: Mapping[str, float]) -> "Problem":
        """The problem with its free numbers fixed at values by dotted key, without objective and constraints."""
        plain = replace(self, free={}, objective={}, constraints={}, over=None)
        return plain.replace({key: values[key] for key in self.free})

    def with_torques(
        self,
        values: Mapping[str, float],
        state: Mapping[str, float],
        durations: Sequence[float],
        duration: float | None = None,
    ) -> "Problem":
        """The problem whose open-loop torques are fixed at values that were found, without objective and constraints.

        Parameters
        ----------
        values : values of the torques and of the free numbers by dotted key.
        state, durations : state just after the impact and durations of the phases [s], which become the guess.
        duration : duration of the control law [s]. By default the mean duration of a step; that of a gait differs from
            it by rounding.
        """
        law = self.control
        assert isinstance(law, OpenLoop)
        mean = float(sum(durations)) / len(self.cycle.steps)
        control = law.fixed(values, mean if duration is None else duration)
        plain = replace(self, control=control, free={}, objective={}, constraints={}, file=None)
        names = guessed_names(type(self.walker), self.cycle, self.cycle_end)
        changes: dict[str, object] = {f"{GUESSED_STATE}{name}": float(state[name]) for name in names}
        changes["gait.guess.durations"] = [float(duration) for duration in durations]
        return replace(plain.replace(changes | {key: float(values[key]) for key in self.free}), origin=self, file=None)

    def objection(self, key: str, value: float) -> str | None:
        """Why a parameter cannot have a value, regardless of other parameters; None if it can."""
        faults: list[Fault] = []
        data = problem_data(self)
        overridden = override(data, {key: value}, faults)
        read_statement(data, self._classes, faults)
        return next((fault.message for fault in faults if fault.path == overridden.keys[key]), None)

    @property
    def _classes(self) -> Known:
        """The classes of the problem's own walker and control law, which need not be registered."""
        walker, control = type(self.walker), type(self.control)
        return Known(walkers={walker.model: walker}, controls={control.type: control})

    def resolved(self) -> dict[str, Any]:
        """The whole problem in SI as JSON data; a reference contains the other problem in place of its name.

        If the gait of the file is followed, ``followed_from`` has the file's values of the changed parameters.
        """
        if self.origin is not None:
            return self.origin.resolved()
        data = problem_data(self)
        if self.start is not None and self.start.first is None and self.has_gait:
            data["gait"]["guess"]["state"] = dict(self.start.state)
        if self.reference is not None:
            for section, key in reference_keys(data):
                section[key] = self.reference.resolved()
        if self.followed_from is not None:
            before = self.followed_from.parameters
            changed = {key: before[key] for key, value in self.parameters.items() if value != before[key]}
            data[FOLLOWED_FROM] = changed
        return data

    @property
    def digest(self) -> str:
        """SHA-256 of the name and everything that determines the gait; the texts ``about`` do not count.

        It covers the resolved problem: all values, modes and guess, those of the reference, and the file's values of
        changed parameters, if the gait is followed from them.
        """
        return digest_of(self.resolved())

    @property
    def hash8(self) -> str:
        """The first eight digits of the digest."""
        return self.digest[:8]


def _phase_numbers(cycle: Cycle) -> list[int]:
    return [len(step.phases) for step in cycle.steps]


def load_problem(name_or_path: str | Path, *, walkers: Walkers = (), controls: Controls = ()) -> Problem:
    """Load a problem by name or path.

    Parameters
    ----------
    name_or_path : a name from ``problem_names()``, or the path of a .yaml file.
    walkers, controls : classes of walkers and control laws that are not registered.

    Raises
    ------
    UnknownNameError
        If no problem has this name.
    ProblemError
        If the file or its content is wrong: one line ``file:line:column key: ...`` per fault.
    """
    return _load(name_or_path, passed_classes(walkers, controls), ())


def parse_problem(
    text: str | None = None, path: str | Path | None = None, *, walkers: Walkers = (), controls: Controls = ()
) -> Problem:
    """Load a problem from a YAML text; messages name ``path``, and references are relative to it.

    Raises
    ------
    ProblemError
        If the text is missing, is a path, or is wrong: one line ``file:line:column key: ...`` per fault.
    """
    if not isinstance(text, str) or (text.endswith(SUFFIXES) and "\n" not in text):
        given = text or path
        remedy = "" if given is None else f": load_problem({str(given)!r}) reads a file"
        raise ProblemError(f"parse_problem reads a YAML text, which is missing{remedy}")
    return _parse(text, passed_classes(walkers, controls), () if path is None else (Path(path),))


def walker_from_urdf(path: str | Path, *, feet: Sequence[str]) -> type[Walker]:
    """Read a planar robot from a URDF file as a class, for ``walkers=[...]`` and ``check_walker``.

    Parameters
    ----------
    path : the file.
    feet : names of two links whose origins are the feet; the first one is the stance foot of the first step.

    Raises
    ------
    ProblemError
        If the file cannot be read, or its robot is not a planar tree with inertia and point feet.
    """
    path, names = Path(path), (*feet,) if not isinstance(feet, str) else (feet,)
    if len(names) != 2 or not all(isinstance(name, str) for name in names):
        raise ProblemError(f"feet is {shown(feet)}, but must name two links: feet=('left_foot', 'right_foot')")
    walker = walker_from_text(read_text(path, MAX_BYTES), (names[0], names[1]), path.name)
    check_class(walker)
    return walker


def restore_problem(record: Mapping[str, Any], *, walkers: Walkers = (), controls: Controls = ()) -> Problem:
    """The problem of a record that ``Problem.resolved`` wrote, with its references.

    Raises
    ------
    ProblemError
        If the record is wrong.
    """
    data = deepcopy(dict(record))
    classes = passed_classes(walkers, controls) if walkers or controls else _PASSED.get()
    before = data.pop(FOLLOWED_FROM, None)
    place = FilePlace(f"record of {shown(data.get('name'))}", {(): (1, 1)})
    known: dict[str, Problem] = {}
    for section, key in reference_keys(data):
        if isinstance(section, dict) and isinstance(section[key], Mapping):
            reference = restore_problem(section[key], walkers=walkers, controls=controls)
            known, section[key] = {reference.name: reference}, reference.name
    problem = build_problem(data, place, [], classes, (), known=known)
    return problem if before is None else replace(problem, file=problem.replace(before).from_guess())


def check_installed(record: Mapping[str, Any]) -> None:
    """Check that the walker and the control law of a record that ``Problem.resolved`` wrote are registered or passed.

    Raises
    ------
    ProblemError
        If one of them is not.
    """
    passed = _PASSED.get()
    kinds: dict[tuple[str, str], tuple[str, Mapping[str, object], Mapping[str, str]]] = {
        ("walker", "model"): ("walker", registered_walkers() | passed.walkers, refused_walkers()),
        ("control", "type"): ("control law", registered_controls() | passed.controls, refused_controls()),
    }
    for (section, key), (kind, known, refused) in kinds.items():
        stated = record.get(section)
        name = stated.get(key) if isinstance(stated, Mapping) else None
        if isinstance(name, str) and name not in known:
            if name in refused:
                raise ProblemError(f"the run needs the {kind} {shown(name)}: {refused[name]}")
            fault = f"no {kind} is called {shown(name)} here; the run needs the package that registers it"
            remedy = f"load_run(..., {'walkers' if section == 'walker' else 'controls'}=[...]) takes its class"
            raise ProblemError(f"{fault}, because classes that are passed to a function are not stored; {remedy}")


def _load(name_or_path: str | Path, classes: Known, files: Sequence[Path]) -> Problem:
    """Load a problem; ``files`` is the chain of files that refer to it, the nearest one last."""
    path = find_problem(name_or_path, files[-1].parent if files else None)
    if files and path.is_dir():
        return _stored(path, classes)
    text = read_text(path)
    if path.resolve() in [file.resolve() for file in files]:
        raise ProblemError(f"circular reference: {' -> '.join(file.stem for file in (*files, path))}")
    return _parse(text, classes, (*files, path))


def _stored(run: Path, classes: Known) -> Problem:
    """The problem of a stored run. Another problem refers to it by the run folder."""
    file = run / RESOLVED_FILE
    try:
        record = json.loads(read_text(file, MAX_BYTES))
    except ValueError as error:
        raise ProblemError(f"{file}:1:1: is not JSON: {error}") from error
    if not isinstance(record, dict):
        raise ProblemError(f"{file}:1:1: is not a problem of a run")
    return restore_problem(record, walkers=[*classes.walkers.values()], controls=[*classes.controls.values()])


def _parse(text: str, classes: Known, files: Sequence[Path]) -> Problem:
    name = str(files[-1]) if files else "problem"
    source = parse_source(text, name)
    place = FilePlace(name, source.marks)
    faults = list(source.faults)
    if not isinstance(source.data, Mapping):
        faults.append(Fault((), "the file is not a mapping of keys; `gaitopt schema` describes a problem file"))
        raise_faults(faults, place)
    return build_problem(source.data, place, faults, classes, files, text=text)


def build_problem(
    data: Mapping[str, Any],
    place: Place,
    faults: list[Fault],
    classes: Known,
    files: Sequence[Path] | None,
    *,
    text: str = "",
    known: Mapping[str, Problem] | None = None,
) -> Problem:
    """The problem that some data state.

    Parameters
    ----------
    data : data in the layout of a problem file.
    place : the file or mapping in which the data were stated, for messages.
    faults : faults that were found while the text of the file was read.
    classes : classes that the data may name in addition to the registered ones.
    files : the files that refer to this problem, followed by its own file; empty if it comes from no file. If None,
        nothing is loaded: the data then contain robots and tables, and ``known`` contains references.
    text : text of the file.
    known : references by name, which are not loaded.

    Raises
    ------
    ProblemError
        If there are faults; the message has one line for each.
    """
    data = _with_files(data, files[-1].parent if files else Path(), faults, place)
    every = Known(walkers=registered_walkers() | classes.walkers, controls=registered_controls() | classes.controls)
    fields = read_statement(data, every, faults)
    walker, control, reference = fields["walker"], fields["control"], None
    name, key = control.source if control else ("", ())
    if name:
        try:
            reference = (known or {}).get(name)
            if reference is None and files is None:
                raise UnknownNameError("its text is missing")
            reference = reference or _load(name, classes, files or ())
        except (UnknownNameError, ProblemError) as error:
            faults.append(Fault(key, f"the reference {shown(name)} cannot be used: {error}"))
    if reference and walker:
        faults += reference_faults(control, walker, reference)
    raise_faults(faults, place)
    path = files[-1] if files else None
    problem = Problem(**fields, reference=reference, path=path, text=text, place=place)
    raise_faults([*impossible(problem), *over_faults(problem, problem.objection)], place)
    return problem


def _with_files(data: Mapping[str, Any], folder: Path, faults: list[Fault], place: Place) -> Mapping[str, Any]:
    """The data in which the content of a robot's file and of tables replaces their paths, relative to the folder.

    Raises
    ------
    ProblemError
        If one cannot be read.
    """
    for path, file in file_entries(data):
        if isinstance(file, Mapping):
            continue
        try:
            if not isinstance(file, str) or not file or "\0" in file:
                kind = "URDF" if path[-1] == "urdf" else "CSV"
                raise ProblemError(f"{shown(file)} is not a path of a {kind} file")
            content = {"file": Path(file).name, "text": read_text(folder / file, MAX_BYTES)}
        except ProblemError as error:
            raise_faults([*faults, Fault(path, str(error))], place)
            raise
        data = deepcopy(dict(data))
        section: Any = data
        for key in path[:-1]:
            section = section[key]
        section[path[-1]] = content
    return data


@contextmanager
def passing(walkers: Walkers, controls: Controls) -> Iterator[None]:
    """Within the block, records are restored with these classes too.

    Raises
    ------
    ProblemError
        For the reasons of ``passed_classes``.
    """
    token = _PASSED.set(passed_classes(walkers, controls))
    try:
        yield
    finally:
        _PASSED.reset(token)


def passed_classes(walkers: Walkers, controls: Controls) -> Known:
    """Classes that a caller passes, by the names that problem files use.

    Raises
    ------
    ProblemError
        If they are not in a list or tuple, one is no well-formed class, or two have one name.
    """
    return Known(walkers=_named(WALKERS, "walkers", walkers), controls=_named(CONTROLS, "controls", controls))


def _named(kind: Kind, argument: str, classes: Sequence[Any]) -> dict[str, Any]:
    if not isinstance(classes, list | tuple):
        example = f"{argument}=[My{argument.capitalize().removesuffix('s')}]"
        raise ProblemError(f"{argument} is {shown(classes)}, but must be a list of classes: {example}")
    named: dict[str, Any] = {}
    for passed in classes:
        try:
            kind.check(passed)
        except ProblemError as error:
            raise ProblemError(f"{argument}: {error}") from error
        name = getattr(passed, kind.attribute)
        if not passed.__module__.startswith(OWN_PACKAGE) and built_in(kind, name) is not None:
            conflict = f"{kind.attribute} is {name!r}, the name of a {kind.title} of gaitopt: choose another one"
            raise ProblemError(f"{argument}: {passed.__name__}: {conflict}")
        if named.setdefault(name, passed) is not passed:
            both = f"{named[name].__name__} and {passed.__name__}"
            raise ProblemError(
                f"{argument}: {both} are both called {name!r}: give each {kind.attribute} a name of its own"
            )
    return named
