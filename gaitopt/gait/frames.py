"""Tables of results as pandas data frames and xarray datasets, with units and origin as attributes.

Both packages are optional and imported when a table is made: ``pip install 'gaitopt[frames]'``.
"""

from collections.abc import Iterable, Mapping, Sequence
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from pandas import DataFrame
    from xarray import Dataset

Units = Mapping[str, str]
"""Units of columns by name; columns without a unit are missing."""


def data_frame(header: Sequence[str], rows: Iterable[Sequence[Any]], units: Units, **attributes: Any) -> "DataFrame":
    """Rows under a header; None becomes NaN, and ``attrs["units"]`` has the units of the columns that have one.

    Raises
    ------
    ModuleNotFoundError
        If pandas is not installed.
    """
    frame = _package("pandas").DataFrame.from_records([tuple(row) for row in rows], columns=list(header))
    frame.attrs = {"units": {name: unit for name, unit in units.items() if unit and name in header}, **attributes}
    return frame.infer_objects()


def data_set(
    variables: Mapping[str, tuple[Sequence[str], Any]],
    coordinates: Mapping[str, tuple[Sequence[str], Any]],
    units: Units,
    **attributes: Any,
) -> "Dataset":
    """A dataset of arrays, given by name with the names of their dimensions; their units become attributes.

    Raises
    ------
    ModuleNotFoundError
        If xarray is not installed.
    """

    def with_unit(name: str, dims: Sequence[str], values: Any) -> tuple[Sequence[str], Any, dict[str, str]]:
        return dims, np.asarray(values), {"units": units[name]} if units.get(name) else {}

    arrays = {name: with_unit(name, *value) for name, value in variables.items()}
    axes = {name: with_unit(name, *value) for name, value in coordinates.items()}
    return _package("xarray").Dataset(arrays, axes, attributes)


def sample_set(header: Sequence[str], rows: Iterable[Sequence[Any]], units: Units, **attributes: Any) -> "Dataset":
    """A table as a dataset over ``sample``, with its column ``t`` as a coordinate."""
    variables = {name: (("sample",), values) for name, values in columns_of(header, rows).items()}
    return data_set(variables, {"t": variables.pop("t")}, units, **attributes)


def columns_of(header: Sequence[str], rows: Iterable[Sequence[Any]]) -> dict[str, Any]:
    """The columns of a table by name: floats with NaN for None, or texts."""
    columns = dict[str, Any]()
    for name, column in zip(header, zip(*rows, strict=True), strict=True):
        missing = "" if any(isinstance(value, str) for value in column) else np.nan
        columns[name] = np.array([missing if value is None else value for value in column])
    return columns


def _package(name: str) -> Any:
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(f"{name} is not installed; pip install 'gaitopt[frames]'") from error
