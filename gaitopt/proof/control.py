"""Control laws as data, every double kept exactly, so that a certificate needs no reference gait to be solved again."""

from collections.abc import Callable, Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from gaitopt.mechanics import (
    BeyondEnd,
    BezierTracking,
    ConstantTorque,
    Control,
    NoControl,
    Piece,
    ProportionalDerivative,
    Reference,
)


def control_record(control: Control, scalars: Mapping[str, float]) -> dict[str, Any]:
    """The law as JSON-able data, with ``scalars`` for ``control.parameters``.

    Raises
    ------
    ValueError
        If it is none of the laws that a problem file can name.
    """
    if isinstance(control, NoControl):
        return {"type": "none"}
    if isinstance(control, ConstantTorque):
        return {"type": "constant_torque", "torques": dict(scalars)}
    if isinstance(control, BezierTracking):
        points = {
            name: [scalars[f"reference.{name}.{k}"] for k in range(len(row))] for name, row in control.points.items()
        }
        curve = {"duration": control.duration, "beyond_end": str(control.beyond_end), "within": control.within}
        return {"type": "bezier", "kp": scalars["kp"], "kd": scalars["kd"], "points": points, **curve}
    if isinstance(control, ProportionalDerivative):
        pieces = [
            {**asdict(piece), "angles": piece.angles.tolist(), "rates": piece.rates.tolist()}
            for piece in control.reference.pieces
        ]
        horizon = None if np.isinf(control.reference.horizon) else control.reference.horizon
        return {"type": "pd", "kp": scalars["kp"], "kd": scalars["kd"], "pieces": pieces, "horizon": horizon}
    raise ValueError(f"a certificate cannot hold the control law {type(control).__name__}")


def restore_control(record: Mapping[str, Any]) -> Control:
    """The law that ``control_record`` has written.

    Raises
    ------
    ValueError, KeyError, TypeError
        If the data are wrong.
    """
    return _READERS[record["type"]](record)


def _bezier(record: Mapping[str, Any]) -> Control:
    return BezierTracking(
        kp=record["kp"],
        kd=record["kd"],
        points={name: tuple(row) for name, row in record["points"].items()},
        duration=record["duration"],
        beyond_end=BeyondEnd(record["beyond_end"]),
        within=record["within"],
    )


def _tracking(record: Mapping[str, Any]) -> Control:
    pieces = tuple(
        Piece(**{**piece, "angles": np.array(piece["angles"]), "rates": np.array(piece["rates"])})
        for piece in record["pieces"]
    )
    horizon = np.inf if record["horizon"] is None else record["horizon"]
    reference = Reference(pieces=pieces, horizon=horizon)
    return ProportionalDerivative(kp=record["kp"], kd=record["kd"], reference=reference)


_READERS: Mapping[str, Callable[[Mapping[str, Any]], Control]] = {
    "none": lambda record: NoControl(),
    "constant_torque": lambda record: ConstantTorque(torques=record["torques"]),
    "bezier": _bezier,
    "pd": _tracking,
}
