"""The public names, their signatures and the options of the commands are those of ``public_api.txt``.

A change of them is a decision: run ``python tests/test_public_api.py`` and commit the difference.
"""

import enum
import inspect
import re
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from difflib import unified_diff
from pathlib import Path
from typing import Any, get_args

import typer
from pydantic import BaseModel

import gaitopt
from gaitopt.cli.main import app
from gaitopt.threads import cached_property

STATED = Path(__file__).with_name("public_api.txt")


def public_api() -> Iterator[str]:
    """One line for every public name, member, command and option."""
    yield from ("# library", "")
    for name in gaitopt.__all__:
        yield from _lines(name, getattr(gaitopt, name))
    yield from ("", "# command line", "")
    for name, command in typer.main.get_command(app).commands.items():
        yield f"gaitopt {name}"
        yield from (f"    {_option(option)}" for option in command.params)


def _lines(name: str, value: Any) -> Iterator[str]:
    if not inspect.isclass(value):
        yield f"{name}("
        yield from (f"    {line}" for line in _parameters(value))
        yield f") -> {_type(inspect.signature(value).return_annotation)}"
        return
    yield f"class {name}({', '.join(base.__name__ for base in value.__bases__)})"
    if issubclass(value, enum.Enum):
        yield from (f"    {member.name} = {str(member)!r}" for member in value)
    if is_dataclass(value):
        yield from (f"    {field.name}: {_type(field.type)}" for field in fields(value) if field.name[0] != "_")
    elif not issubclass(value, BaseModel):
        notes = {key: note for base in value.__mro__ for key, note in inspect.get_annotations(base).items()}
        yield from (
            f"    {key}: {_type(note)}"
            for key, note in sorted(notes.items())
            if key[0] != "_" and "ClassVar" not in str(note)
        )
    stated = {field.name for field in fields(value)} if is_dataclass(value) else set()
    for key, member in _members(value):
        is_value = isinstance(member, property | cached_property)
        function = next((getattr(member, way) for way in ("fget", "func", "__func__") if hasattr(member, way)), member)
        if key[0] != "_" and key not in stated and inspect.isfunction(function):
            words = "" if is_value else f"({', '.join(_parameters(function))})"
            yield f"    {key}{words} -> {_type(inspect.signature(function).return_annotation)}"


def _members(value: type) -> Iterator[tuple[str, Any]]:
    """Members by name, also those that are inherited from a class of gaitopt."""
    homes = [base for base in value.__mro__ if base.__module__.startswith("gaitopt")]
    yield from sorted({key: member for base in reversed(homes) for key, member in vars(base).items()}.items())


def _parameters(function: Any) -> Iterator[str]:
    """Names, kinds, types and defaults of the parameters."""
    keyword_only = False
    for parameter in inspect.signature(function).parameters.values():
        if parameter.name in ("self", "cls"):
            continue
        if parameter.kind is parameter.KEYWORD_ONLY and not keyword_only:
            keyword_only = True
            yield "*"
        star = "*" if parameter.kind is parameter.VAR_POSITIONAL else ""
        default = "" if parameter.default is parameter.empty else f" = {_default(parameter.default)}"
        yield f"{star}{parameter.name}: {_type(parameter.annotation)}{default}"


def _default(value: Any) -> str:
    return value.__name__ if callable(value) else repr(str(value) if isinstance(value, enum.Enum) else value)


def _type(annotation: Any) -> str:
    """An annotation without the modules of its names, which may move, and without the shapes of arrays."""
    words = annotation.__name__ if isinstance(annotation, type) and not get_args(annotation) else str(annotation)
    words = re.sub(r"(?:\w+\.)+(\w+)", r"\1", words.replace("'", ""))
    return re.sub(r"ndarray\[(?:tuple\[[^]]*\]|Any), dtype\[([^]]*)\]\]", r"ndarray[\1]", words)


def _option(option: Any) -> str:
    """A line with the names of an option, its value, and whether it may be left out or repeated."""
    words = [", ".join(option.opts), option.metavar or ""]
    default = option.default() if callable(option.default) else option.default
    is_switch = getattr(option, "is_flag", False)
    if not option.required and not is_switch:
        words.append("(optional)" if default is None else f"= {default}")
    return " ".join(filter(None, (*words, "..." if option.multiple or option.nargs == -1 else "")))


def test_the_public_api_is_as_stated() -> None:
    stated, present = STATED.read_text().splitlines(), list(public_api())
    difference = "\n".join(unified_diff(stated, present, "stated", "present", lineterm="", n=1))
    assert not difference, f"the public API has changed; run python tests/{Path(__file__).name}\n{difference}"


def test_the_table_of_commands_and_calls_has_every_command_and_only_public_names() -> None:
    page = (Path(__file__).parents[1] / "docs" / "api.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (`.*`) \| (.*) \|$", page, re.MULTILINE)
    words = [re.findall(r"`([a-z]+)`", commands) for commands, _ in rows]
    assert {word for row in words for word in row} == set(typer.main.get_command(app).commands)
    for _, calls in rows:
        for call in re.findall(r"`(\w+(?:\.\w+)?)`", calls):
            name, _, method = call.partition(".")
            assert name in gaitopt.__all__, call
            assert not method or hasattr(getattr(gaitopt, name), method), call


if __name__ == "__main__":
    STATED.write_text("\n".join(public_api()) + "\n")
