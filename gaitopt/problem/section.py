"""The base of the sections of a problem file: a model that takes no other keys than its own."""

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, create_model
from pydantic.fields import FieldInfo

from gaitopt.mechanics.ranges import Within
from gaitopt.mechanics.units import SMALLEST, Finite, parse_angle

Name = Annotated[str, Field(min_length=1, max_length=1000)]
"""Of another problem: a name, or a path."""
DURATION = Within(unit="time", possible=(0, 1000), usual=(0, 50))
Duration = Annotated[Finite, Field(ge=SMALLEST)]


class Section(BaseModel):
    """Base of every section: its fields are all the keys there are."""

    model_config = ConfigDict(frozen=True, extra="forbid")


def is_angle(field: FieldInfo) -> bool:
    """Whether a field takes angles with a unit."""
    return any(isinstance(part, BeforeValidator) and part.func is parse_angle for part in field.metadata)


def section_model(name: str, keys: Mapping[str, Any], *, required: bool = True) -> type[Section]:
    """A section whose keys depend on the walker."""
    default = ... if required else None
    fields: dict[str, Any] = {key: (annotation, default) for key, annotation in keys.items()}
    return create_model(name, __base__=Section, **fields)
