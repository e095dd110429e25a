"""The results of a run over many files: one record for each file, on disk while the run goes on.

`manifest.jsonl` gets a line, in one write, as soon as a file is done.  A run that is killed loses no more than a part
of the last line.  When several lines are about one file, the last one counts.  `manifest.parquet` holds the same table
and is written when a run ends.

Names of files that are not UTF-8, which Linux allows, stand in `manifest.jsonl` as Python has them, a byte 0xFF as the
escape \\udcff, so that the names lead to the files; Parquet has no such text and gets \\xff.
"""

import dataclasses
import json
import math
import os
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any

from ..errors import MeshIOError, MissingDependencyError
from ..files.atomic import replacing
from ..files.messages import printable

LINES, TABLE = "manifest.jsonl", "manifest.parquet"


@dataclass(frozen=True)
class FileResult:
    """The result of one file.

    name        the path of the output below the folder of results, with / between the parts
    file        the input, as it was given
    output      the mesh file that was written; None when none was
    status      a `Status` in lower case, or "error"
    valid       whether no triangle and no quad is inverted
    error       what went wrong, in one line; None when a mesh was written
    message     why `improve` ended
    vertices, triangles                      counts of the input, over all meshes of a time series
    steps                                    the number of steps of a time series; 1 for other files
    inverted_before, inverted_after          counts of inverted triangles
    imr_average_before, imr_average_after    inverse mean ratio; None where it is infinite, because a
    imr_maximum_before, imr_maximum_after    triangle has no area, and where there is no mesh
    seconds     wall time of reading and writing, and the file's share, by triangles, of its batch's improvement
    warnings    what was dropped or repaired
    fields      what became of the fields, in words; empty where nothing had to be done
    bytes, modified, digest    the input's size, time of its last change (ns), and BLAKE2b hash in hex
    output_bytes               the size of the output
    options     the settings that it was made with, as `runs.settings` gives them
    worker      the host and the process that did the work
    resumed     whether the result is one of an earlier run; this is not in the manifest
    """

    name: str
    file: str
    output: str | None = None
    status: str = "error"
    valid: bool = False
    error: str | None = None
    message: str = ""
    vertices: int | None = None
    triangles: int | None = None
    steps: int | None = None
    inverted_before: int | None = None
    inverted_after: int | None = None
    imr_average_before: float | None = None
    imr_average_after: float | None = None
    imr_maximum_before: float | None = None
    imr_maximum_after: float | None = None
    seconds: float = 0.0
    warnings: list[str] = field(default_factory=list)
    bytes: int | None = None
    modified: int | None = None
    digest: str | None = None
    output_bytes: int | None = None
    fields: str = ""
    options: str = ""
    worker: str = ""
    resumed: bool = False

    def record(self) -> dict[str, Any]:
        """A row of the manifest: plain values, without `resumed`."""
        row = dataclasses.asdict(self)
        del row["resumed"]
        return {key: None if isinstance(v, float) and not math.isfinite(v) else v for key, v in row.items()}

    @classmethod
    def of(cls, record: dict[str, Any]) -> "FileResult":
        """The result that a row of the manifest holds, with `resumed` set; unknown columns are ignored."""
        known = {f.name for f in dataclasses.fields(cls)}
        return cls(**({key: value for key, value in record.items() if key in known} | {"resumed": True}))


def load(folder: Path) -> dict[str, FileResult]:
    """The last result for each name in the folder's `manifest.jsonl`; lines that were cut short are ignored.

    Raises MeshIOError.
    """
    results: dict[str, FileResult] = {}
    try:
        with open(folder / LINES, encoding="utf-8", errors="replace") as stream:
            for line in stream:
                try:
                    result = FileResult.of(json.loads(line))
                except (ValueError, TypeError, AttributeError):
                    continue
                results[result.name] = result
    except (FileNotFoundError, NotADirectoryError):
        pass
    except OSError as error:
        raise MeshIOError(f"{folder / LINES}: cannot be read: {error.strerror or error}") from None
    return results


class Journal:
    """`manifest.jsonl` of a folder, open to take lines; its methods raise MeshIOError."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / LINES
        try:
            # Without a buffer a line is one write, and the system has it when `add` returns.
            self._stream = open(self.path, "ab", buffering=0)  # noqa: SIM115
            if self._stream.tell() and not _ends_with_newline(self.path):
                self._stream.write(b"\n")
        except OSError as error:
            raise MeshIOError(f"{self.path}: cannot be written: {error.strerror or error}") from None

    def add(self, result: FileResult) -> None:
        """Appends the record of one result."""
        line = json.dumps(result.record(), allow_nan=False, ensure_ascii=True) + "\n"
        try:
            self._stream.write(line.encode())
        except OSError as error:
            raise MeshIOError(f"{self.path}: cannot be written: {error.strerror or error}") from None

    def __enter__(self) -> "Journal":
        return self

    def __exit__(self, *_: type[BaseException] | BaseException | TracebackType | None) -> None:
        self._stream.close()


def _ends_with_newline(path: Path) -> bool:
    with open(path, "rb") as stream:
        stream.seek(-1, os.SEEK_END)
        return stream.read(1) == b"\n"


def tidy(folder: Path) -> None:
    """Rewrites `manifest.jsonl` with one line for each name, in the order of the names, all or nothing."""
    results = load(folder)
    lines = [json.dumps(results[name].record(), allow_nan=False) + "\n" for name in sorted(results)]
    text = "".join(lines).encode()
    if (folder / LINES).read_bytes() != text:
        with replacing(folder / LINES) as path:
            path.write_bytes(text)


# The columns of the table that are not text.  Their types are given, because none can be inferred from nulls alone.
_WHOLE = ("vertices", "triangles", "steps", "inverted_before", "inverted_after", "bytes", "modified", "output_bytes")


_REAL = ("imr_average_before", "imr_average_after", "imr_maximum_before", "imr_maximum_after", "seconds")


def write_table(folder: Path, results: Iterable[FileResult] | None = None) -> Path:
    """Writes `manifest.parquet` beside `manifest.jsonl`, all or nothing, and returns its path.

    results  the rows; by default those of `manifest.jsonl`

    Raises MissingDependencyError without pyarrow.
    """
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError:
        raise MissingDependencyError(
            f"{folder / TABLE}: Parquet files need pyarrow; install it (pip install 'torchmesh-untangle[parquet]')"
        ) from None
    rows = [result.record() for result in (load(folder).values() if results is None else results)]
    kinds: dict[str, Any] = {"valid": pa.bool_(), "warnings": pa.list_(pa.string())}
    kinds |= dict.fromkeys(_WHOLE, pa.int64()) | dict.fromkeys(_REAL, pa.float64())
    names = [f.name for f in dataclasses.fields(FileResult) if f.name != "resumed"]
    schema = pa.schema([(name, kinds.get(name, pa.string())) for name in names])
    rows = [{key: printable(value) for key, value in row.items()} for row in sorted(rows, key=lambda row: row["name"])]
    table = pa.Table.from_pylist(rows, schema=schema)
    with replacing(folder / TABLE) as path:
        pq.write_table(table, path)
    return folder / TABLE
