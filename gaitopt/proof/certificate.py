"""The format of certificates.

A certificate contains four kinds of data, and nothing else:

    texts        the problem, the files that it names, changed values and intervals: ``problem``, ``intervals``
    choices      values of the parameters that the problem leaves free, within their bounds: ``designed``
    law data     what no text can hold, as exact doubles: the angles of a tracked gait, or a duration: ``law``
    where        search data that only say where to look: ``varied``, ``special``, ``order``, ``arcs``, ``boxes``

Everything else follows from the texts; see ``statement``. If the law's data come from another gait, ``reference`` holds
choices, law data and search data of its proof; its problem is among the texts.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from gaitopt.errors import StorageError
from gaitopt.problem.faults import shown
from gaitopt.problem.writing import DECIMAL, EXACT_VALUE, ProblemText

SCHEMA = "gaitopt-proof-6"
LARGEST_FILE = 64 * 2**20
"""Bytes of a certificate; the longest known family has some 10^6."""
DEEPEST_NESTING = 40
"""Levels of nested lists and objects in a certificate."""
MOST_BOXES, MOST_ARCS, MOST_UNKNOWNS = 2000, 1000, 3600
"""The largest known certificates have some 30 boxes, 11 arcs and 3400 unknowns."""
SMALLEST_ORDER, LARGEST_ORDER = 2, 60
"""Bounds of the order of the Taylor series; the prover uses 16 and 20."""

Number = Annotated[str, Field(pattern=rf"^{DECIMAL}$", max_length=140)]
Radius = Annotated[str, Field(pattern=r"^[0-9]{1,60}(\.[0-9]{1,60})?([eE][+-]?[0-9]{1,3})?$", max_length=140)]
Value = Annotated[str, Field(pattern=rf"^{EXACT_VALUE}$", max_length=140)]
ValueInterval = Annotated[str, Field(pattern=rf"^{EXACT_VALUE} *\.\. *{EXACT_VALUE}$", max_length=300)]
Name = Annotated[str, Field(max_length=1000)]
Real = Annotated[float, Field(ge=-1e9, le=1e9, allow_inf_nan=False)]
Row = Annotated[list[Real], Field(min_length=1, max_length=200)]
Entries = Annotated[list[Number], Field(max_length=MOST_UNKNOWNS)]


class _Record(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)


class FileRecord(_Record):
    """A text with its SHA-256."""

    text: Annotated[str, Field(max_length=2**21)]
    sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]


class ProblemRecord(FileRecord):
    """A problem as texts; see ``gaitopt.problem.writing.ProblemText``. The key ``set`` holds its ``changes``."""

    set: Annotated[dict[Name, Any], Field(max_length=1000)]
    files: Annotated[dict[Name, FileRecord], Field(max_length=10)]
    problems: Annotated[dict[Name, "ProblemRecord"], Field(max_length=1)]

    @classmethod
    def of(cls, source: ProblemText) -> "ProblemRecord":
        """The record of the texts of a problem."""
        return cls(
            **_hashed(source.text),
            set=json.loads(json.dumps(dict(source.changes))),
            files={name: FileRecord(**_hashed(text)) for name, text in source.files.items()},
            problems={name: cls.of(problem) for name, problem in source.problems.items()},
        )

    @property
    def source(self) -> ProblemText:
        """The texts of the problem.

        Raises
        ------
        ValueError
            If a text does not have the SHA-256 that the record states.
        """
        for name, file in (("the problem", self), *self.files.items()):
            if sha256(file.text) != file.sha256:
                raise ValueError(f"the text of {name} does not have the SHA-256 that stands beside it")
        return ProblemText(
            text=self.text,
            changes=self.set,
            files={name: file.text for name, file in self.files.items()},
            problems={name: problem.source for name, problem in self.problems.items()},
        )


def _hashed(text: str) -> dict[str, str]:
    return {"text": text, "sha256": sha256(text)}


def sha256(text: str) -> str:
    """Digest of a text in UTF-8."""
    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()


class PieceRecord(_Record):
    """A piece of a tracked motion; see ``gaitopt.model.curve.Piece``."""

    start: Real
    end: Real
    angles: Annotated[list[Row], Field(min_length=1, max_length=20)]


class MotionRecord(_Record):
    """The pieces of a tracked motion. If the rule beyond its end is ``flow``, the law ends with the last piece."""

    pieces: Annotated[list[PieceRecord], Field(min_length=1, max_length=500)]


class DurationRecord(_Record):
    """The duration of a designed curve, or of open-loop torques [s]."""

    duration: Annotated[Real, Field(gt=0)]


class ArcRecord(_Record):
    """An arc: the number of its phase, counted from 0, its ``OrbitArc.fractions``, and whether its phase is timed.

    A timed phase ends at a breakpoint of the control law. This only says where to look, like the fractions: the modes
    have to change as they can at a breakpoint, and the claims about the margins of the next phase fail if its contacts
    would go on as before.
    """

    phase: Annotated[int, Field(ge=0, lt=MOST_ARCS)]
    fractions: Annotated[
        list[Annotated[float, Field(gt=0, lt=1, allow_inf_nan=False)]], Field(max_length=MOST_UNKNOWNS)
    ]
    timed: bool = False


class BoxRecord(_Record):
    """A box of unknowns; see ``gaitopt.proof.orbit.TiltedBox``. ``interval`` is that of the varying parameter."""

    interval: Annotated[list[Value], Field(max_length=2)]
    centre: Entries
    tilt: Entries
    radii: Annotated[list[Radius], Field(max_length=MOST_UNKNOWNS)]


class OrbitRecord(_Record):
    """Choices, law data and search data about the gaits of one problem."""

    designed: Annotated[dict[Name, Number], Field(max_length=1000)]
    law: MotionRecord | DurationRecord | None
    reference: "OrbitRecord | None"
    order: Annotated[int, Field(ge=SMALLEST_ORDER, le=LARGEST_ORDER)]
    arcs: Annotated[list[ArcRecord], Field(max_length=MOST_ARCS)]
    boxes: Annotated[list[BoxRecord], Field(max_length=MOST_BOXES)]


class CertificateRecord(OrbitRecord):
    """All fields of a certificate."""

    schema_: Annotated[Literal["gaitopt-proof-6"], Field(alias="schema")]
    problem: ProblemRecord
    intervals: Annotated[dict[Name, ValueInterval], Field(max_length=100)]
    varied: Name | None
    special: Literal["neimark_sacker", "period_doubling", "mode_change", "impact_change", "lift_off", "painleve"] | None


def parse_certificate(content: bytes) -> dict[str, Any]:
    """The JSON object in a file.

    Raises
    ------
    StorageError
        If the file is too large, is not JSON, contains no object, or gives a key of an object twice.
    """
    if len(content) > LARGEST_FILE:
        raise StorageError(f"a certificate has at most {LARGEST_FILE} bytes")

    def refuse(constant: str) -> float:
        raise ValueError(f"{constant} is not a number")

    def unique(pairs: Sequence[tuple[str, Any]]) -> dict[str, Any]:
        if len(dict(pairs)) < len(pairs):
            raise ValueError("an object gives a key twice")
        return dict(pairs)

    try:
        data = json.loads(content.decode("utf-8"), parse_constant=refuse, object_pairs_hook=unique)
    except RecursionError as error:
        raise StorageError("its lists and objects are nested too deeply") from error
    except ValueError as error:  # also of text that is not UTF-8, and of integers with thousands of digits
        raise StorageError(f"it is not JSON: {error}") from error
    if not isinstance(data, dict):
        raise StorageError("it contains no JSON object")
    return data


def read_certificate(certificate: Mapping[str, Any]) -> CertificateRecord:
    """A certificate with fields of the right type and size.

    Raises
    ------
    ValueError
        If the certificate has another format; the message names it.
    StorageError
        If a field is missing, unknown, or has a wrong value; the message names the field.
    """
    schema = certificate.get("schema")
    if isinstance(schema, str) and schema != SCHEMA:
        raise ValueError(
            f"a certificate of the format {shown(schema)}, not {SCHEMA}: check it with the version that wrote it"
        )
    level: list[Any] = [certificate]
    for _ in range(DEEPEST_NESTING):
        containers = [item for item in level if isinstance(item, Mapping | list)]
        level = [entry for item in containers for entry in (item.values() if isinstance(item, Mapping) else item)]
    if any(isinstance(item, Mapping | list) for item in level):
        raise StorageError(f"its lists and objects are nested in more than {DEEPEST_NESTING} levels")
    try:
        return CertificateRecord.model_validate(dict(certificate))
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False, include_input=False)[0]
        field = ".".join(str(key)[:60] for key in first["loc"])
        raise StorageError(f"{field}: {first['msg']}") from error
