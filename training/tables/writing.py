"""Writing of a table of pushes as CSV or Parquet. Each file appears whole or not at all."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
import pyarrow as pa
import pyarrow.csv as pc
import pyarrow.parquet as pq

from service.errors import DataError
from training.omnipush.declaration import DATASET_FILE
from training.omnipush.npy_files import write_whole, writing
from training.tables.files import OBJECTS, PUSHES
from training.tables.objects import PROPERTIES
from training.tables.push_table import PushTable, TableObject, TextColumn
from training.tables.reading import OUTCOME, POSE_SUFFIXES, PUSHER, RADIUS

ROW_GROUP: Final = 1 << 17  # rows
Format = Literal["csv", "parquet"]


def write_table(
    folder: Path, table: PushTable, file_format: Format = "parquet", declaration: Mapping[str, Any] | None = None
) -> tuple[Path, Path]:
    """Write the files of pushes and of objects of a table into a folder. Equal tables give equal files.

    Args:
        folder: the folder. It is made if it is missing.
        table: the table.
        file_format: ``parquet``, or ``csv``.
        declaration: content of ``dataset.json``, with a key ``source``. By default the source of the table alone.

    Returns:
        The files of pushes and of objects.

    Raises:
        DataError: the folder holds a table in the other format, or cannot be written.
    """
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    stems = (PUSHES, OBJECTS[0])
    other = "csv" if file_format == "parquet" else "parquet"
    for stem in stems:
        if (folder / f"{stem}.{other}").exists():
            raise DataError(f"{folder} holds {stem}.{other} already; remove it, or name another folder")
    pushes, objects = (folder / f"{stem}.{file_format}" for stem in stems)
    content = dict(declaration or {"source": table.source})
    write_whole(folder / DATASET_FILE, (json.dumps(content, indent=2, sort_keys=True) + "\n").encode())
    write_whole(objects, _encoded(_objects(table.objects), file_format))
    write_whole(pushes, _encoded(_pushes(table), file_format))
    return pushes, objects


def _pushes(table: PushTable) -> pa.Table:
    columns: dict[str, Any] = {}
    for name, texts in table.text_columns.items():
        columns[name] = _text(texts)
    for names, values in ((PUSHER, table.pushers), (OUTCOME, table.outcomes)):
        columns.update(zip(names, values.T, strict=True))
    columns[RADIUS] = table.pusher_radius_m
    for peer, values in table.peers.items():
        columns.update(zip((peer + suffix for suffix in POSE_SUFFIXES), values.T, strict=True))
    return pa.table({name: pa.array(column) for name, column in columns.items()})


def _text(column: TextColumn) -> pa.DictionaryArray:
    return pa.DictionaryArray.from_arrays(column.index.astype(np.int32), pa.array(column.values, pa.string()))


def _objects(objects: tuple[TableObject, ...]) -> pa.Table:
    counts = [len(item.outline.corners) for item in objects]
    properties = [(*(item.centre_of_mass_m or (None, None)), item.mass_kg, item.friction) for item in objects]
    index = np.repeat(np.arange(len(objects)), counts)
    corners = np.concatenate([item.outline.corners for item in objects])
    names = TextColumn(tuple(item.name for item in objects), index)
    columns = {
        "object": _text(names),
        "corner": pa.array(np.concatenate([np.arange(count) for count in counts])),
        "x_m": pa.array(corners[:, 0]),
        "y_m": pa.array(corners[:, 1]),
    }
    for key, values in zip(PROPERTIES, zip(*properties, strict=True), strict=True):
        if any(value is not None for value in values):
            columns[key] = pa.array(values, pa.float64()).take(pa.array(index))
    return pa.table(columns)


def _encoded(table: pa.Table, file_format: Format) -> bytes:
    sink = pa.BufferOutputStream()
    if file_format == "csv":
        plain = [
            column.cast(pa.string()) if pa.types.is_dictionary(column.type) else column for column in table.columns
        ]
        pc.write_csv(pa.table(plain, table.column_names), sink, pc.WriteOptions(quoting_style="needed"))
    else:
        pq.write_table(table, sink, row_group_size=ROW_GROUP, compression="zstd", data_page_version="1.0")
    return bytes(sink.getvalue())
