"""The table of a campaign's runs, in parquet: a part for each piece that is done, and one file for all in the end.

A part is what makes a piece done. It is written last, whole, and says how long the files of the piece's signals are.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayesftc.cosim.base.extras import extra
from bayesftc.cosim.campaign.designs.plan import Outcome, Piece
from bayesftc.cosim.campaign.runs.columns import OWN, factor_columns, run_columns
from bayesftc.cosim.campaign.store.chunks import PURPOSE
from bayesftc.cosim.campaign.store.metadata import Metadata
from bayesftc.cosim.errors import StoreError

FOLDER, WHOLE = "runs", "runs.parquet"
_KEY = b"bayesftc"


@dataclass(frozen=True)
class Part:
    """Rows of some runs.

    Attributes
    ----------
    rows : pyarrow.Table
        A row a run.
    seconds : mapping of str to float
        Of computing, by the number of the piece.
    sizes : mapping of str to list of int
        Bytes of each file of the signals, by the number of the piece; in the order of `Chunks.keys`.
    """

    rows: Any
    seconds: Mapping[str, float]
    sizes: Mapping[str, list[int]]


class Parts:
    """How rows are made, written and read.

    Parameters
    ----------
    metadata : Metadata
        Of the campaign.
    """

    def __init__(self, metadata: Metadata):
        self._arrow, self._parquet = extra("pyarrow", PURPOSE), extra("pyarrow.parquet", PURPOSE)
        plan = metadata.plan
        self.factors = factor_columns(plan.points, (*metadata.metrics, *metadata.signals))
        self.runs = run_columns(plan, self.factors)
        pa = self._arrow
        types = {"i": pa.int64(), "f": pa.float64(), "b": pa.bool_(), "O": pa.string()}
        fields = {name: types[column.dtype.kind] for name, column in self.runs.items()}
        fields |= {"status": pa.string(), "reason": pa.string(), "steps": pa.int64()}
        self._schema = pa.schema(fields | dict.fromkeys(metadata.metrics, pa.float64()))

    def name(self, piece: int) -> str:
        """Return the name of the file of a part, in the campaign's folder."""
        return f"{FOLDER}/part-{piece:06d}.parquet"

    def piece(self, name: str) -> int | None:
        """Return which piece a file of this name, in the folder of the parts, is of; None if it is no part."""
        number = name.removeprefix("part-").removesuffix(".parquet")
        return int(number) if name == f"part-{number}.parquet" and number.isdigit() else None

    def rows(self, outcome: Outcome) -> Any:
        """Return the rows of an outcome."""
        piece = outcome.piece
        columns: dict[str, Any] = {name: column[piece.begin : piece.end] for name, column in self.runs.items()}
        columns |= {
            "status": list(outcome.status),
            "reason": [
                reason.encode(errors="replace").decode() for reason in outcome.reasons
            ],  # an FMU may say anything
            "steps": np.asarray(outcome.steps, dtype=np.int64),
            **{name: np.asarray(values, dtype=np.float64) for name, values in outcome.metrics.items()},
        }
        return self._arrow.table([self._array(n, columns[n]) for n in self._schema.names], schema=self._schema)

    def _array(self, name: str, values: Any) -> Any:
        # from_pandas=False: a metric that is NaN is a number, not a missing one
        return self._arrow.array(values, type=self._schema.field(name).type, from_pandas=False)

    def encode(self, part: Part) -> Any:
        """Return the bytes of a file."""
        said = {_KEY: json.dumps({"seconds": dict(part.seconds), "sizes": dict(part.sizes)}).encode()}
        sink = self._arrow.BufferOutputStream()
        self._parquet.write_table(part.rows.replace_schema_metadata(said), sink, write_page_checksum=True)
        return sink.getvalue()

    def decode(self, data: bytes, name: str, piece: Piece | None = None) -> Part:
        """Return what is in a file.

        Parameters
        ----------
        data : bytes
            Its bytes.
        name : str
            Its name, for messages.
        piece : Piece, optional
            Whose rows it must have; those of all runs by default.

        Raises
        ------
        StoreError
            If it is damaged.
        """
        source = self._arrow.BufferReader(data)
        begin, end = (piece.begin, piece.end) if piece else (0, len(self.runs["run"]))
        try:
            rows = self._parquet.ParquetFile(source, page_checksum_verification=True).read(use_threads=False)
            said = json.loads(rows.schema.metadata[_KEY])
            rows = rows.select(self._schema.names).cast(self._schema)
            if not np.array_equal(rows["run"].to_numpy(), np.arange(begin, end)):
                raise ValueError(rows.num_rows)
            return Part(rows, dict(said["seconds"]), dict(said["sizes"]))
        except (OSError, ValueError, LookupError, TypeError, self._arrow.ArrowException):
            raise StoreError(
                f"The file {name} of the campaign is damaged; resume the campaign, which makes its runs again."
            ) from None

    def joined(self, parts: Iterable[Any]) -> Any:
        """Return all rows, in the order of the runs."""
        rows = self._arrow.concat_tables([self._schema.empty_table(), *parts])
        runs = rows["run"].to_numpy()
        return rows if (np.diff(runs) > 0).all() else rows.sort_by("run")

    def without(self, rows: Any, pieces: Iterable[Piece]) -> Any:
        """Return rows without those of some pieces."""
        keep = np.ones(rows.num_rows, dtype=bool)
        for piece in pieces:
            keep[piece.begin : piece.end] = False  # of all runs, so that the number of a row is that of its run
        return rows.filter(self._arrow.array(keep))

    def of_piece(self, whole: Part, piece: Piece) -> Part:
        """Return the part of a piece, of the part of all."""
        own = str(piece.index)
        return Part(whole.rows.slice(piece.begin, len(piece)), {own: whole.seconds[own]}, {own: whole.sizes[own]})

    def put(self, rows: Any, others: Any) -> Any:
        """Return rows in which those of the same runs are others."""
        mine = ~np.isin(rows["run"].to_numpy(), others["run"].to_numpy())
        return self.joined([rows.filter(self._arrow.array(mine)), others])


__all__ = ["FOLDER", "OWN", "WHOLE", "Part", "Parts"]
