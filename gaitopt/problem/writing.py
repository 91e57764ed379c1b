"""Writing a problem as texts from which any machine reads it again, and the decimals that these give for its numbers.

The texts of a problem that comes from a file are the text of the file, the values that were changed since, and the
files that the text names. Any other problem is written as JSON data, which are YAML too.
"""

import json
import re
from collections.abc import Iterator, Mapping
from copy import deepcopy
from dataclasses import dataclass, field
from io import StringIO
from typing import Any

from ruamel.yaml import YAML

from gaitopt.errors import ProblemError
from gaitopt.model.units import ANGLE_UNITS
from gaitopt.problem.faults import Fault, FilePlace, Key, raise_faults, shown
from gaitopt.problem.problem import Controls, Problem, Walkers, build_problem, passed_classes
from gaitopt.problem.source import parse_source
from gaitopt.problem.statement import (
    changed_values,
    file_entries,
    override,
    parameter_key,
    point_key,
    problem_data,
    reference_keys,
)

DECIMAL = r"[+-]?([0-9]{1,4000}\.?[0-9]{0,4000}|\.[0-9]{1,4000})([eE][+-]?[0-9]{1,3})?"
YAML_WIDTH = 110
"""Length of the longest line of a problem file that is written [characters]."""
EXACT_VALUE = rf"{DECIMAL}( (deg|rad))?"
"""A decimal number, or one with ``deg`` or ``rad``."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ProblemText:
    """A problem as texts.

    Attributes
    ----------
    text : text of its file, or the text that ``write_problem`` makes.
    changes : values that replace those of the text, by dotted key.
    files : contents of the files of robots and tables, by the name in the text.
    problems : the problem whose gait the control law needs, by the name in the text.
    """

    text: str
    changes: Mapping[str, Any] = field(default_factory=dict)
    files: Mapping[str, str] = field(default_factory=dict)
    problems: Mapping[str, "ProblemText"] = field(default_factory=dict)


def read_problem(source: ProblemText, *, walkers: Walkers = (), controls: Controls = ()) -> Problem:
    """The problem that some texts state. No file is read.

    Raises
    ------
    ProblemError
        If the texts state no problem, a file or problem that they name is missing, or one that is given is not named.
    """
    yaml = parse_source(source.text, "problem")
    data, faults, place = yaml.data, list(yaml.faults), FilePlace("problem", yaml.marks)
    if not isinstance(data, dict):
        raise ProblemError("problem: the text is not a mapping of keys")
    named = list(_named_files(data))
    for path, name in named:
        _section(data, path)[path[-1]] = {"file": name, "text": _content(source.files, name)}
    references = [(section, key) for section, key in reference_keys(data) if section[key] is not None]
    wanted = {str(section[key]) for section, key in references}
    unused = sorted(({*source.files} - {name for _, name in named}) | ({*source.problems} - wanted))
    if unused:
        raise ProblemError(f"problem: its text does not name {shown(unused[0])}")
    known = {name: read_problem(_content(source.problems, name), walkers=walkers, controls=controls) for name in wanted}
    classes = passed_classes(walkers, controls)
    problem = build_problem(data, place, faults, classes, None, text=source.text, known=known)
    if source.changes:
        changed, faults = problem_data(problem), list[Fault]()
        raise_faults(faults, override(changed, source.changes, faults))
        if [path for path, _ in _named_files(changed)] or {str(s[key]) for s, key in reference_keys(changed)} != wanted:
            raise ProblemError("problem: its changes name another file: give a text that names it")
        tracked, problem = problem.reference, problem.replace(source.changes)
        if problem.reference is not tracked:
            raise ProblemError("problem: its changes name another gait: give a text that names it")
    return problem


def _content(contents: Mapping[str, Any], name: str) -> Any:
    if name not in contents:
        raise ProblemError(f"problem: {shown(name)}, which its text names, is missing")
    return contents[name]


def _section(data: Any, path: Key) -> Any:
    for key in path[:-1]:
        data = data[key]
    return data


def _named_files(data: Mapping[str, Any]) -> Iterator[tuple[Key, str]]:
    """Paths in the data of a problem under which a robot's file or a table is named, each with the name."""
    return ((path, entry) for path, entry in file_entries(data) if isinstance(entry, str))


def write_problem(problem: Problem) -> ProblemText:
    """The texts of a problem: its file with the changed values if these suffice, otherwise a text of its own.

    Guesses do not count: the problem that is read may have others.

    Raises
    ------
    ProblemError
        If no text gives the problem.
    """
    walkers, controls = passed_types(problem)
    for write in (_with_changes, _as_data):
        try:
            source = write(problem)
            if source is not None and _equal(read_problem(source, walkers=walkers, controls=controls), problem):
                return source
        except ProblemError:  # a text that no longer belongs to the problem
            continue
    raise ProblemError(f"{problem.name}: no text gives this problem")


def problem_yaml(problem: Problem) -> tuple[str, dict[str, str]]:
    """The text of a problem file with all data of a problem in SI units, and the files that it names, by name.

    Raises
    ------
    ProblemError
        If the control law follows a gait: its problem has a file of its own.
    """
    if problem.reference is not None:
        raise ProblemError(f"{problem.name}: its control law follows {problem.reference.name}, which has its own file")
    source = _as_data(problem)
    data, stream, yaml = json.loads(source.text), StringIO(), YAML()
    yaml.default_flow_style = None  # one line for each innermost mapping or list
    yaml.width = YAML_WIDTH
    yaml.dump(data, stream)
    return stream.getvalue(), dict(source.files)


def passed_types(problem: Problem) -> tuple[list[Any], list[Any]]:
    """The classes of walkers and control laws of a problem and of its reference, which need not be registered.

    Robots from files are not among them: their text gives the class.
    """
    problems = [problem]
    while problems[-1].reference is not None:
        problems.append(problems[-1].reference)
    walkers = dict.fromkeys(type(each.walker) for each in problems if "urdf" not in each.walker.statement())
    return list(walkers), list(dict.fromkeys(type(each.control) for each in problems))


def _equal(one: Problem, other: Problem) -> bool:
    """Whether two problems are equal, apart from their guesses and descriptions."""
    if one.reference is not None and other.reference is not None and not _equal(one.reference, other.reference):
        return False
    same = type(one.walker) is type(other.walker) and type(one.control) is type(other.control)
    return same and (one.reference is None) == (other.reference is None) and _compared(one) == _compared(other)


def _compared(problem: Problem) -> dict[str, Any]:
    data = problem_data(problem)
    data["gait"].pop("guess", None)
    return {key: value for key, value in data.items() if key != "about"}


def _with_changes(problem: Problem) -> ProblemText | None:
    """The text of the problem's file, and the values that differ from it; None if there is no such text."""
    if not problem.text:
        return None
    data, after = parse_source(problem.text, problem.name).data, problem_data(problem)
    files = {name: _section(after, path)[path[-1]]["text"] for path, name in _named_files(data)}
    reference = problem.reference
    names = {str(section[key]) for section, key in reference_keys(data)} if reference is not None else ()
    problems = {name: write_problem(reference) for name in names if reference is not None}
    walkers, controls = passed_types(problem)
    source = ProblemText(text=problem.text, files=files, problems=problems)
    before = _compared(read_problem(source, walkers=walkers, controls=controls))
    changes: dict[str, Any] = {}
    for key, value in _compared(problem).items():
        if before.get(key) == value:
            continue
        leaves = changed_values({key: before.get(key)}, {key: value})
        values = {leaf: _at(after, leaf) for leaf in leaves}
        changes |= {key: after[key]} if key == "gait" or None in values.values() or not values else values
    return ProblemText(text=problem.text, changes=deepcopy(changes), files=files, problems=problems)


def _at(data: Any, key: str) -> Any:
    """The value of a dotted key; None if there is none."""
    for form in (key, point_key(key)):
        value = data
        for name in form.split("."):
            if isinstance(value, list) and name.isdecimal() and int(name) < len(value):
                value = value[int(name)]
            else:
                value = value.get(name) if isinstance(value, Mapping) else None
        if value is not None:
            return value
    return None


def _as_data(problem: Problem) -> ProblemText:
    """The data of the problem as JSON, with robots and tables as files."""
    data, files = problem_data(problem), dict[str, str]()
    walker, control = data["walker"], data["control"]
    for section, key in ((walker, "urdf"), *((entry, "table") for entry in control.values())):
        content = section.get(key) if isinstance(section, dict) else None
        if isinstance(content, Mapping):
            name = next(
                n for n in (content["file"], f"other-{content['file']}") if files.get(n) in (None, content["text"])
            )
            files[name], section[key] = content["text"], name
    problems = {}
    if problem.reference is not None:
        problems = {problem.control.source[0]: write_problem(problem.reference)}
    return ProblemText(text=json.dumps(data, indent=1, ensure_ascii=False) + "\n", files=files, problems=problems)


class ExactValues:
    """The decimals that the texts of a problem give for its numbers, by dotted key; entries of lists count from 0."""

    def __init__(self, source: ProblemText) -> None:
        written = {
            ".".join(map(str, path)): text for path, text in parse_source(source.text, "problem").scalars.items()
        }
        for key, value in source.changes.items():
            written = {k: text for k, text in written.items() if k != key and not k.startswith(f"{key}.")}
            written |= dict(_leaves(key, value))
        spaced = {key: re.sub(r"\s*(deg|rad)$", r" \1", text.strip()) for key, text in written.items()}
        self._written = {parameter_key(key): text for key, text in spaced.items()}

    def __call__(self, key: str, value: float) -> str:
        """The text of the number with this key, ``0.14`` or ``1 deg``, if it stands for the double ``value``.

        If the text does not state the number, or not as a decimal, the result is the shortest decimal of the double.
        """
        text = self._written.get(key, "")
        if re.fullmatch(EXACT_VALUE, text):
            number, _, unit = text.partition(" ")
            if float(number) * ANGLE_UNITS[unit or "rad"] == value:
                return text
        return repr(value)


def _leaves(key: str, value: Any) -> Iterator[tuple[str, str]]:
    if isinstance(value, Mapping | list | tuple):
        for k, entry in value.items() if isinstance(value, Mapping) else enumerate(value):
            yield from _leaves(f"{key}.{k}", entry)
    else:
        yield key, value if isinstance(value, str) else repr(value)
