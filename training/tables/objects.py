"""Objects of a table: a file with one row per corner of each outline."""

from typing import Final

import numpy as np
from tqdm import tqdm

from service.errors import InvalidRequestError
from service.pushing.outlines import Outline
from service.pushing.poses import DoubleArray
from training.tables.columns import Columns, Wanted, read_columns, read_header, require
from training.tables.files import TableFile
from training.tables.push_table import TableObject

CORNER: Final = ("corner", "x_m", "y_m")
CENTRE: Final = ("centre_of_mass_x_m", "centre_of_mass_y_m")
PROPERTIES: Final = (*CENTRE, "mass_kg", "friction")
_LARGEST_M: Final = 2.0  # the extent beyond which metres are no plausible unit
_POSITIVE: Final = frozenset(("mass_kg", "friction"))


def name_column(names: tuple[str, ...]) -> str:
    """Return the column that names the object: ``object``, or ``shape`` in a table without it."""
    return "shape" if "shape" in names and "object" not in names else "object"


def read_objects(file: TableFile) -> tuple[TableObject, ...]:
    """Read the objects of a table, in the order in which they appear.

    Raises:
        DataError: a cell is not as expected, corners are out of order, an object occurs twice, or an outline is no
            simple polygon. The message names the file, the object and the row.
    """
    header = read_header(file)
    key = name_column(header.names)
    require(file, header, (key, *CORNER))
    if set(CENTRE) & set(header.names):
        require(file, header, CENTRE)
    known = tuple(name for name in PROPERTIES if name in header.names)
    columns = read_columns(file, header, Wanted(CORNER, known, (key,)))
    names, index = columns.texts[key].values, columns.texts[key].index
    starts = np.flatnonzero(np.diff(index, prepend=-1))
    ends = [*starts[1:].tolist(), columns.rows]
    objects: dict[int, TableObject] = {}
    spans = tqdm(
        list(zip(starts.tolist(), ends, strict=True)), "reading outlines", disable=None, leave=False, delay=1.0
    )
    for start, end in spans:
        number = int(index[start])
        if number in objects:
            received = f"object {names[number]!r} again, after other objects"
            raise file.fault_at(start, key, received, "the corners of an object in rows that follow each other")
        _check_order(file, columns, names[number], start, end)
        objects[number] = _object(file, columns, names[number], start, end)
    return tuple(objects.values())


def _check_order(file: TableFile, columns: Columns, name: str, start: int, end: int) -> None:
    """Refuse corners that are not numbered one after the other, from 0 or from 1."""
    numbers = columns.numbers["corner"][start:end]
    first = 1 if numbers.min() == 1 else 0
    wrong = numbers != np.arange(len(numbers)) + first
    if wrong.any():
        row = int(wrong.argmax())
        received = f"{numbers[row]:g} in object {name!r}"
        if numbers[row] == first and first in numbers[:row]:
            raise file.fault_at(start + row, "corner", f"{received} again", "each object once: rename the second one")
        due = f"{row + first}: number the corners 0, 1, 2 ... in order around the outline"
        raise file.fault_at(start + row, "corner", received, due)


def _object(file: TableFile, columns: Columns, name: str, start: int, end: int) -> TableObject:
    corners = np.column_stack([columns.numbers["x_m"][start:end], columns.numbers["y_m"][start:end]])
    found = {key: _property(file, columns, key, start, end) for key in PROPERTIES if key in columns.numbers}
    x_m, y_m = (found.get(key) for key in CENTRE)
    if (x_m is None) != (y_m is None):
        raise file.fault_at(start, CENTRE[x_m is not None], "an empty cell", "both coordinates, or neither")
    centre = None if x_m is None or y_m is None else (x_m, y_m)
    return TableObject(name, _outline(file, corners, name), centre, found.get("mass_kg"), found.get("friction"))


def _outline(file: TableFile, corners: DoubleArray, name: str) -> Outline:
    extent = float(np.ptp(corners, axis=0).max())
    if extent > _LARGEST_M:
        unit, factor = ("centimetres", 100) if extent < _LARGEST_M * 20 else ("millimetres", 1000)
        raise file.fault(
            f"object {name!r} is {extent:.4g} m across; accepted are up to {_LARGEST_M:g} m: "
            f"if its corners are in {unit}, divide them by {factor}"
        )
    try:
        return Outline.of(corners, f"object {name!r}, outline")
    except InvalidRequestError as error:
        raise file.fault(str(error)) from error


def _property(file: TableFile, columns: Columns, key: str, start: int, end: int) -> float | None:
    """Return the one value of a property in the rows of an object, of which some may be empty."""
    values = columns.numbers[key][start:end]
    given = np.flatnonzero(~np.isnan(values))
    if not len(given):
        return None
    first = float(values[given[0]])
    for row in given.tolist():
        if values[row] != first:
            raise file.fault_at(
                start + row, key, f"{values[row]:g} after {first:g}", "one value for all rows of an object"
            )
    if key in _POSITIVE and first <= 0.0:
        raise file.fault_at(start + int(given[0]), key, f"{first:g}", "a positive number, or an empty cell if unknown")
    return first
