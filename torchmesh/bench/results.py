"""The results of a run on disk: a line as soon as a row is there, and tables at the end.

results.jsonl     a line a row, written in one go, by which a run that was stopped goes on
results.csv       the table
results.parquet   the same
"""

import csv
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from ..errors import MeshIOError, MissingDependencyError
from ..files.atomic import replacing

LINES, CSV, PARQUET = "results.jsonl", "results.csv", "results.parquet"

# The columns with their types, in their order.
COLUMNS: dict[str, str] = {
    "method": "text",
    "family": "text",
    "case": "whole",
    "level": "real",
    "unit": "text",
    "outcome": "text",
    "valid": "truth",
    "fault": "text",
    "triangles": "whole",
    "vertices": "whole",
    "inverted_before": "whole",
    "inverted": "whole",
    "mean": "real",
    "max": "real",
    "minimum_angle": "real",
    "seconds": "real",
    "wall_seconds": "real",
    "travel_median": "real",
    "travel_max": "real",
    "fields_kept": "truth",
    "cells_kept": "truth",
    "steps": "whole",
    "steps_valid": "whole",
    "note": "text",
    "seed": "whole",
    "details": "text",
    "digest": "text",
    "versions": "text",
    "processor": "text",
    "system": "text",
    "kernels": "text",
    "commit": "text",
    "time": "text",
}

# What tells one row from another.
Key = tuple[str, str, int]

# A row of these is tried again by the next run: what was missing may be there then.
_AGAIN = ("missing",)

Row = dict[str, Any]


def key(row: Row) -> Key:
    """The method, the family and the number of the case."""
    return row["method"], row["family"], row["case"]


def load(folder: Path) -> dict[Key, Row]:
    """The rows of the folder's `results.jsonl`, the last one for each key; lines that were cut short are ignored.

    Raises MeshIOError.
    """
    rows: dict[Key, Row] = {}
    try:
        with open(folder / LINES, encoding="utf-8", errors="replace") as stream:
            for line in stream:
                try:
                    row = json.loads(line)
                    rows[key(row)] = row
                except (ValueError, TypeError, KeyError):
                    continue
    except FileNotFoundError:
        pass
    except OSError as error:
        raise MeshIOError(f"{folder / LINES}: cannot be read: {error.strerror or error}") from None
    return {k: row for k, row in rows.items() if row.get("outcome") not in _AGAIN}


def append(folder: Path, row: Row) -> None:
    """Add a line in one write, after whatever a run that was killed has left.  Raises MeshIOError."""
    path = folder / LINES
    line = json.dumps({name: row.get(name) for name in COLUMNS}, allow_nan=False)
    try:
        with open(path, "ab", buffering=0) as stream:
            cut = stream.tell() and path.read_bytes()[-1:] != b"\n"
            stream.write(("\n" * bool(cut) + line + "\n").encode())
    except OSError as error:
        raise MeshIOError(f"{path}: cannot be written: {error.strerror or error}") from None


def write_tables(folder: Path, rows: Iterable[Row]) -> None:
    """Write `results.csv` and `results.parquet`, each all or nothing.

    Raises MissingDependencyError, when the CSV file is there, without pyarrow.
    """
    ordered = sorted(rows, key=key)
    with replacing(folder / CSV) as path, open(path, "w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, list(COLUMNS), extrasaction="ignore")
        writer.writeheader()
        writer.writerows(ordered)
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError:
        raise MissingDependencyError(
            f"{folder / PARQUET}: Parquet files need pyarrow; install it (pip install 'torchmesh-untangle[bench]')"
        ) from None
    kinds = {"text": pa.string(), "whole": pa.int64(), "real": pa.float64(), "truth": pa.bool_()}
    schema = pa.schema([(name, kinds[kind]) for name, kind in COLUMNS.items()])
    table = pa.Table.from_pylist([{name: row.get(name) for name in COLUMNS} for row in ordered], schema=schema)
    with replacing(folder / PARQUET) as path:
        pq.write_table(table, path)
