"""Writes the table of a catalog as Parquet and CSV, row by row from the journal."""

from __future__ import annotations

import json
import secrets
import shutil
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from .. import __version__
from ..files import cannot_write, write_table
from .columns import Column

PARTITION = 10_000  # rows per file
GROUP = 1000  # rows in memory at a time

Rows = Callable[[], Iterator[dict[str, Any]]]  # each call yields all rows, from the first

_LIGHT = [f"to_light_{axis}" for axis in "xyz"] + [f"flux_{channel}" for channel in ("red", "green", "blue")]
_TYPES = {
    str: pa.string(),
    int: pa.int64(),
    float: pa.float64(),
    bool: pa.bool_(),
    list: pa.list_(pa.struct([(name, pa.float64()) for name in _LIGHT])),
}


def schema(columns: list[Column]) -> pa.Schema:
    """Names and types of the columns; ``units`` in the metadata is a JSON object of units by column."""
    units = {column.name: column.unit for column in columns if column.unit}
    metadata = {"units": json.dumps(units), "generator": f"lightdome {__version__}"}
    return pa.schema([(column.name, _TYPES[column.kind]) for column in columns], metadata)


def write_parquet(path: Path, columns: list[Column], rows: Rows, count: int) -> None:
    """Write a file or, for more than :data:`PARTITION` rows, a folder of files under the same name."""
    name = f".{path.stem}.{secrets.token_hex(4)}"
    new, old = path.with_name(f"{name}.new"), path.with_name(f"{name}.old")
    try:
        left = rows()
        if count <= PARTITION:
            _write(new, columns, left)
        else:
            new.mkdir()
            for part in range(-(-count // PARTITION)):
                _write(new / f"part-{part:05}.parquet", columns, islice(left, PARTITION))
        if path.exists() and (path.is_dir() or new.is_dir()):  # only a file can be replaced by a file
            path.rename(old)
        new.replace(path)
        remove(old)
    except OSError as error:
        raise cannot_write(path, error.strerror or str(error)) from error
    finally:
        remove(new)


def remove(path: Path) -> None:
    """Remove a file or a folder, if it is there."""
    shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)


def _write(path: Path, columns: list[Column], rows: Iterator[dict[str, Any]]) -> None:
    with pq.ParquetWriter(path, schema(columns), compression="zstd") as writer:
        while group := list(islice(rows, GROUP)):
            writer.write_table(pa.Table.from_pylist(group, schema(columns)))


def write_csv(path: Path, columns: list[Column], rows: Rows) -> None:
    """Write the same values as CSV; lights are a JSON list in one field."""

    def texts(row: dict[str, Any]) -> Iterator[object]:
        for column in columns:
            value = row.get(column.name)
            yield json.dumps(value) if column.kind is list and value is not None else value

    write_table(path, [column.name for column in columns], (list(texts(row)) for row in rows()))
