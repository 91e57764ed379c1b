"""Reading YAML 1.2 from untrusted sources: plain data, and the line and column of every key.

Aliases, anchors, tags and further documents are errors, found in the stream of events before any data are built. Size,
depth and number of values are bounded, which bounds the time of parsing. Data are mappings, lists and plain scalars.
Named problems are files shipped with the package, or those of the folder ``problems`` of a checkout.
"""

import difflib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError, YAMLError
from ruamel.yaml.events import (
    AliasEvent,
    CollectionEndEvent,
    CollectionStartEvent,
    DocumentStartEvent,
    Event,
    MappingStartEvent,
    NodeEvent,
    ScalarEvent,
    SequenceStartEvent,
)
from ruamel.yaml.nodes import ScalarNode
from ruamel.yaml.reader import ReaderError

from gaitopt.errors import ProblemError, UnknownNameError
from gaitopt.problem.faults import Fault, Key, plain, shown

SUFFIXES = (".yaml", ".yml")
MAX_BYTES = 256 * 1024
MAX_DEPTH = 20
MAX_VALUES = 2000
"""The bounds are ten times those of the largest sensible file; they bound the time of a parser in pure Python."""
MAX_SCALAR = 4000
"""Length of the longest value [characters]; it is below the number of digits that int() accepts."""

_STRING = "tag:yaml.org,2002:str"
_FLOAT = "tag:yaml.org,2002:float"
_INT = "tag:yaml.org,2002:int"
_NATIVE = {_FLOAT, _INT, "tag:yaml.org,2002:bool", "tag:yaml.org,2002:null"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Source:
    """A YAML text as plain data.

    Attributes
    ----------
    data : mappings with string keys, lists, and str, int, float, bool or None.
    marks : line and column, both from 1, of every key and list entry by its path; the root has the path ().
    scalars : every value that is neither a mapping nor a list, as it is written, by its path.
    faults : errors in the text itself, such as duplicate keys.
    """

    data: Any
    marks: Mapping[Key, tuple[int, int]]
    scalars: Mapping[Key, str]
    faults: tuple[Fault, ...]


def problem_names() -> tuple[str, ...]:
    """The names of all included problems, in alphabetical order."""
    return tuple(sorted(path.stem for path in _folder().glob("*.yaml")))


def find_problem(name_or_path: str | Path, folder: Path | None = None) -> Path:
    """The file of a named problem, or the path itself, taken relative to ``folder``.

    A path is recognised by its suffix or by a separator.

    Raises
    ------
    UnknownNameError
        If it is neither a name nor looks like a path.
    """
    text = str(name_or_path)
    if isinstance(name_or_path, Path) or text.endswith(SUFFIXES) or "/" in text or "\\" in text:
        return (folder or Path()) / name_or_path
    path = _folder() / f"{text}.yaml"
    with suppress(OSError, ValueError):  # no file can have this name
        if path.is_file():
            return path
    near = difflib.get_close_matches(text, problem_names(), n=2)
    remedy = f"did you mean {' or '.join(near)}?" if near else "`gaitopt list` shows all names"
    raise UnknownNameError(f"no problem is called {shown(text)}; {remedy} (or give the path of a .yaml file)")


def _folder() -> Path:
    shipped = Path(str(files("gaitopt.problem"))) / "catalogue"
    return shipped if shipped.is_dir() else Path(__file__).resolve().parents[2] / "problems"


def read_text(path: Path, limit: int = MAX_BYTES) -> str:
    """The text of a problem file, or of a file that it names, if it is a readable UTF-8 file of sensible size.

    Parameters
    ----------
    limit : largest size [bytes]. Messages give the advice for problem files only if it is theirs.

    Raises
    ------
    ProblemError
        If it is missing, not a file, unreadable, too large or not UTF-8.
    """
    is_problem = limit == MAX_BYTES
    try:
        if not path.exists():
            remedy = "; `gaitopt list` shows the included problems" if is_problem else ""
            raise _refusal(path, f"no such file{remedy}")
        if not path.is_file():  # a device could be read endlessly
            remedy = "; give the path of one problem file (.yaml)" if is_problem else ""
            raise _refusal(path, f"is not a file{remedy}")
        with path.open("rb") as file:
            content = file.read(limit + 1)
    except OSError as error:
        raise _refusal(path, f"cannot be read: {error.strerror}") from error
    if len(content) > limit:
        remedy = ": a problem file usually has about 30 lines" if is_problem else ""
        raise _refusal(path, f"is larger than {limit // 1024} kB{remedy}")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        before = content[: error.start].decode("utf-8-sig", errors="replace")
        line, column = before.count("\n") + 1, error.start - content.rfind(b"\n", 0, error.start)
        raise _refusal(path, f"byte 0x{content[error.start]:02x} is not UTF-8 text", line, column) from error


def parse_source(text: str, name: str) -> Source:
    """The data of a YAML text with their positions; ``name`` is the name of the file in messages.

    Raises
    ------
    ProblemError
        If the text is not YAML 1.2, or uses aliases, anchors, tags, several documents, or exceeds a bound.
    """
    if len(text) > MAX_BYTES:
        raise _refusal(name, f"is larger than {MAX_BYTES // 1024} kB: a problem file usually has about 30 lines")
    source = _parse(text, name)
    return replace(source, data=deepcopy(source.data))


@lru_cache(maxsize=64)
def _parse(text: str, name: str) -> Source:
    """The result of ``parse_source``, cached because parsing takes ten milliseconds; its data must not be changed."""
    yaml = YAML(typ="safe", pure=True)
    reader = _DocumentReader(yaml, name)
    try:
        data = reader.read(yaml.parse(text))
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line, column = (mark.line + 1, mark.column + 1) if mark else (1, 1)
        raise _refusal(name, f"is not YAML: {error.problem or error.context}", line, column) from error
    except ReaderError as error:
        before = text[: error.position]
        line, column = before.count("\n") + 1, error.position - before.rfind("\n")
        message = f"control character U+{error.character:04X} is not allowed: a problem file is plain text"
        raise _refusal(name, message, line, column) from error
    except ProblemError:  # a subclass of ValueError
        raise
    except (YAMLError, ValueError, OverflowError) as error:  # the last two from escapes beyond Unicode
        raise _refusal(name, f"is not YAML: {error}") from error
    return Source(data=data, marks=reader.marks, scalars=reader.scalars, faults=tuple(reader.faults))


def parse_value(text: str) -> object:
    """A value as YAML reads it, for overrides given as text: ``0.2``, ``1 deg``, ``[stick]``.

    Raises
    ------
    ProblemError
        For the reasons of ``parse_source``, or if a key is given twice.
    """
    source = parse_source(text, "value")
    if source.faults:
        raise ProblemError("\n".join(fault.message for fault in source.faults))
    return source.data


class _DocumentReader:
    """Builds data and marks from the event stream of one text."""

    def __init__(self, yaml: YAML, name: str) -> None:
        self.yaml, self.name = yaml, name
        self.marks: dict[Key, tuple[int, int]] = {(): (1, 1)}
        self.scalars: dict[Key, str] = {}
        self.faults: list[Fault] = []

    def read(self, stream: Iterable[Event]) -> Any:
        """The only document of the stream."""
        events = self._checked(stream)
        root = next((event for event in events if isinstance(event, NodeEvent)), None)
        data = None if root is None else self._value(root, events, ())
        for _ in events:  # read to the end: a second document is an error
            pass
        return data

    def _checked(self, stream: Iterable[Event]) -> Iterator[Event]:
        depth = values = documents = 0
        for event in stream:
            if isinstance(event, DocumentStartEvent):
                documents += 1
                if documents > 1:
                    raise self._refuse(event, "a second document starts here: one problem per file")
                if event.tags or event.version not in (None, (1, 2)):
                    raise self._refuse(event, "directives are not allowed, apart from %YAML 1.2")
            if isinstance(event, NodeEvent):
                values += 1
                if isinstance(event, AliasEvent):
                    raise self._refuse(event, f"alias {shown(event.anchor)} is not allowed: write the value out")
                if event.anchor is not None:
                    remedy = "write the value out where it is needed"
                    raise self._refuse(event, f"anchor {shown(event.anchor)} is not allowed: {remedy}")
                tag = getattr(event, "tag", None)
                if tag is not None:
                    raise self._refuse(event, f"tag {shown(str(tag))} is not allowed: write the plain value")
            depth += isinstance(event, CollectionStartEvent) - isinstance(event, CollectionEndEvent)
            if depth > MAX_DEPTH:
                raise self._refuse(event, f"nested deeper than {MAX_DEPTH} levels")
            if values > MAX_VALUES:
                raise self._refuse(event, f"more than {MAX_VALUES} keys and values: a problem file holds one gait")
            yield event

    def _value(self, event: Any, events: Iterator[Event], path: Key) -> Any:
        if path not in self.marks or path == ():
            self.marks[path] = _position(event)
        if isinstance(event, MappingStartEvent):
            return self._mapping(events, path)
        if isinstance(event, SequenceStartEvent):
            items: list[Any] = []
            while not isinstance(item := next(events), CollectionEndEvent):
                items.append(self._value(item, events, (*path, len(items))))
            return items
        return self._scalar(event, path)

    def _mapping(self, events: Iterator[Event], path: Key) -> dict[str, Any]:
        content: dict[str, Any] = {}
        while not isinstance(event := next(events), CollectionEndEvent):
            if not isinstance(event, ScalarEvent) or self._tag(event) != _STRING:
                raise self._refuse(event, "a key must be a plain word, followed by a colon and a space")
            key = event.value
            if key in content:
                line = self.marks[(*path, key)][0]
                self.marks[(*path, key)] = _position(event)
                self.faults.append(Fault((*path, key), f"is given twice, first in line {line}: keep one"))
            self.marks[(*path, key)] = _position(event)
            content[key] = self._value(next(events), events, (*path, key))
        return content

    def _scalar(self, event: ScalarEvent, path: Key) -> Any:
        if len(event.value) > MAX_SCALAR:
            raise self._refuse(event, f"a value of {len(event.value)} characters; at most {MAX_SCALAR}")
        self.scalars[path] = event.value
        tag = self._tag(event)
        if tag not in _NATIVE:
            return event.value  # a timestamp is a text too
        value = self.yaml.constructor.construct_object(ScalarNode(tag, event.value))
        if tag == _INT and abs(value) >= 2**63:
            self.faults.append(Fault(path, f"{shown(event.value)} is too large for an integer"))
            return 0
        return value

    def _tag(self, event: ScalarEvent) -> str:
        tag = str(self.yaml.resolver.resolve(ScalarNode, event.value, event.implicit))
        return _STRING if tag in (_FLOAT, _INT) and "_" in event.value else tag  # 1_0 is a number in YAML 1.1 only

    def _refuse(self, event: Event, message: str) -> ProblemError:
        return _refusal(self.name, message, *_position(event))


def _position(event: Event) -> tuple[int, int]:
    return event.start_mark.line + 1, event.start_mark.column + 1


def _refusal(name: str | Path, message: str, line: int = 1, column: int = 1) -> ProblemError:
    return ProblemError(f"{plain(str(name))}:{line}:{column}: {message}")
