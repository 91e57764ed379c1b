"""A problem: which gait of which walker is wanted, complete and in SI; how it is loaded, changed and identified.

A problem that tracks another gait holds that gait's own problem, which overrides never touch.
"""

import hashlib
import json
from collections.abc import Callable, Mapping
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gaitopt.errors import ProblemError, UnknownNameError
from gaitopt.mechanics.modes import ImpactLaw, ModeSequence
from gaitopt.mechanics.walker import Walker
from gaitopt.problem.assemble import assemble
from gaitopt.problem.catalogue import find_problem
from gaitopt.problem.faults import Fault, FilePlace, Key, OverridePlace, Place, raise_faults, shown
from gaitopt.problem.overrides import apply_overrides
from gaitopt.problem.record import problem_data
from gaitopt.problem.sections import ControlSpec, CurveReference, Free, Guess, PDSpec, Range
from gaitopt.problem.source import parse_source, read_text


@dataclass(frozen=True, slots=True, kw_only=True)
class Problem:
    """One gait to be found, complete and validated.

    Attributes
    ----------
    name, about : from the file.
    walker : the walker with its parameters; a freed parameter has its guess, here and below.
    friction : coefficient of friction mu.
    impact_law : tangential law of a slipping impact.
    control : what the motors do.
    sequence : modes of one step, and its impact.
    guess : first guess of the gait, its state complete.
    free : the unknown parameters by dotted key.
    objective : weights of the scalars whose sum is minimised; empty if there is none.
    constraints : ranges of scalars by name.
    reference : the problem whose gait the control tracks or its curve starts from.
    path, text : where it came from, verbatim; overrides are not in the text.
    """

    name: str
    about: str = ""
    walker: Walker
    friction: float
    impact_law: ImpactLaw = ImpactLaw.COULOMB
    control: ControlSpec
    sequence: ModeSequence
    guess: Guess
    free: Mapping[str, Free]
    objective: Mapping[str, float]
    constraints: Mapping[str, Range]
    reference: "Problem | None" = None
    path: Path | None = None
    text: str = ""

    @property
    def parameters(self) -> dict[str, float]:
        """Every scalar parameter by dotted key, in a fixed order: walker, friction, control."""
        walker = {key: value for key, value in self.walker if isinstance(value, int | float)}
        control = self.control.model_dump(exclude={"type", "reference"})
        control = control.get("torques", control)
        groups = {f"walker.{key}": value for key, value in walker.items() if not isinstance(value, bool)}
        return {**groups, "friction": self.friction, **{f"control.{key}": value for key, value in control.items()}}

    def reference_problem(self) -> "Problem | None":
        """The problem whose gait the control tracks or its curve starts from; never touched by ``replace``."""
        return self.reference

    def replace(self, overrides: Mapping[str, object]) -> "Problem":
        """The problem with some values changed, validated as a whole.

        Parameters
        ----------
        overrides : values as in the file by dotted key, for instance ``{"friction": 0.16, "walker.slope": "2 deg"}``.

        Raises
        ------
        ProblemError
            If the result is wrong; each line names the override: ``--set KEY: ...``.
        """
        faults: list[Fault] = []
        data, place = apply_overrides(problem_data(self), overrides, faults)
        raise_faults(faults, place)

        def reference_of(name: str) -> Problem:
            kept = self.reference is not None and name == _reference_name(self.control)[0]
            chain = () if self.path is None else (self.path.resolve(),)
            return self.reference if kept and self.reference else _load(name, self._folder, chain)

        return _build(data, place, reference_of, faults, path=self.path, text=self.text)

    def resolved(self) -> dict[str, Any]:
        """The whole problem in SI as JSON-able data; in a reference the other problem stands in place of its name."""
        data = problem_data(self)
        data["gait"]["guess"]["state"] = dict(self.guess.state)
        if self.reference is not None:
            reference = data["control"]["reference"]
            target = reference["curve"] if "curve" in reference else reference
            target["start" if "curve" in reference else "gait"] = self.reference.resolved()
        return data

    @property
    def digest(self) -> str:
        """SHA-256 of everything that determines the gait, and of the name; the texts ``about`` do not count."""
        canonical = json.dumps(_without_about(self.resolved()), sort_keys=True, separators=(",", ":"), allow_nan=False)
        return hashlib.sha256(canonical.encode()).hexdigest()

    @property
    def hash8(self) -> str:
        """The first eight digits of the digest."""
        return self.digest[:8]

    @property
    def _folder(self) -> Path | None:
        return None if self.path is None else self.path.parent


def load_problem(name_or_path: str | Path) -> Problem:
    """The problem of a name in the catalogue, or of a file.

    Raises
    ------
    UnknownNameError
        If no problem has this name.
    ProblemError
        If the file or what it says is wrong: one line ``file:line:column key: ...`` per fault.
    """
    return _load(name_or_path, None, ())


def parse_problem(text: str, path: Path | None = None) -> Problem:
    """The problem stated by a YAML text; ``path`` names it in messages, and references are relative to it.

    Raises
    ------
    ProblemError
        As ``load_problem``.
    """
    return _parse(text, path, ())


def restore_problem(record: Mapping[str, Any]) -> Problem:
    """The problem that ``Problem.resolved`` has written, references included.

    Raises
    ------
    ProblemError
        If the record is wrong.
    """
    data = deepcopy(dict(record))
    nested: list[Problem] = []
    reference = data.get("control", {}).get("reference", {})
    for holder, key in ((reference, "gait"), (reference.get("curve", {}), "start")):
        if isinstance(holder.get(key), Mapping):
            nested.append(restore_problem(holder[key]))
            holder[key] = nested[0].name
    place = FilePlace(f"record of {shown(data.get('name'))}", {(): (1, 1)})
    return _build(data, place, lambda name: nested[0] if nested else _load(name, None, ()), [])


def _load(name_or_path: str | Path, folder: Path | None, chain: tuple[Path, ...]) -> Problem:
    path = find_problem(name_or_path, folder)
    return _parse(read_text(path), path, chain)


def _parse(text: str, path: Path | None, chain: tuple[Path, ...]) -> Problem:
    """``chain`` holds the files that led here by their references, so that a circle is seen."""
    here = () if path is None else (path.resolve(),)
    if set(here) & set(chain):
        circle = " -> ".join(file.stem for file in (*chain, *here))
        raise ProblemError(f"references run in a circle: {circle}")
    source = parse_source(text, "problem" if path is None else str(path))
    place = FilePlace("problem" if path is None else str(path), source.marks)
    faults = list(source.faults)
    if not isinstance(source.data, Mapping):
        faults.append(Fault((), "the file holds no mapping of keys; `gaitopt schema` describes a problem file"))
        raise_faults(faults, place)
    folder = None if path is None else path.parent
    return _build(source.data, place, lambda name: _load(name, folder, chain + here), faults, path=path, text=text)


def _build(
    data: Mapping[str, Any],
    place: Place,
    reference_of: Callable[[str], Problem],
    faults: list[Fault],
    *,
    path: Path | None = None,
    text: str = "",
) -> Problem:
    """A problem from data, or all that is wrong with them."""
    fields = assemble(data, faults)
    reference = _read_reference(fields["control"], fields["walker"], reference_of, faults)
    raise_faults(faults, place)
    return Problem(**fields, reference=reference, path=path, text=text)


def _read_reference(
    control: ControlSpec | None, walker: Walker | None, reference_of: Callable[[str], Problem], faults: list[Fault]
) -> Problem | None:
    name, key = _reference_name(control)
    if not name:
        return None
    try:
        reference = reference_of(name)
    except (UnknownNameError, ProblemError) as error:
        faults.append(Fault(key, f"the reference {shown(name)} cannot be used: {error}"))
        return None
    untracked = [] if walker is None else [angle for angle in walker.tracked if angle not in reference.walker.shape]
    if untracked:
        message = (
            f"the reference {shown(name)} is a {reference.walker.model}, which has no {', '.join(untracked)} to track"
        )
        faults.append(Fault(key, message))
    return reference


def _reference_name(control: ControlSpec | None) -> tuple[str, Key]:
    """Name or path of the other problem in a control, and the key that gives it; empty if there is none."""
    if not isinstance(control, PDSpec):
        return "", ()
    if isinstance(control.reference, CurveReference):
        return control.reference.start, ("control", "reference", "curve", "start")
    return control.reference.gait, ("control", "reference", "gait")


def _without_about(data: Any) -> Any:
    if isinstance(data, Mapping):
        return {key: _without_about(value) for key, value in data.items() if key != "about"}
    return data
