"""The table of a campaign's runs, in parquet: a part for each finished piece, and one file for all in the end.

A piece is finished when its part exists. The part is written last, completely, and contains the sizes of the signal files.
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
        A row for each run.
    seconds : mapping of str to float
        Computing time in seconds, by the number of the piece.
    sizes : mapping of str to list of int
        Bytes of each file of the signals, by the number of the piece; in the order of `Chunks.keys`.
    """

    rows: Any
    seconds: Mapping[str, float]
    sizes: Mapping[str, list[int]]


class Parts:
    """Makes, writes and reads rows of the table.

    Parameters
    ----------
    metadata : Metadata
        Metadata of the campaign.
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
        """Return the number of the piece of a file in the folder of the parts; None if the file is not a part."""
        number = name.removeprefix("part-").removesuffix(".parquet")
        return int(number) if name == f"part-{number}.parquet" and number.isdigit() else None

    def rows(self, outcome: Outcome) -> Any:
        """Return the rows of an outcome."""
        piece = outcome.piece
        columns: dict[str, Any] = {name: column[piece.begin : piece.end] for name, column in self.runs.items()}
        columns |= {
            "status": list(outcome.status),
            # The messages of an FMU may contain invalid text.
            "reason": [reason.encode(errors="replace").decode() for reason in outcome.reasons],
            "steps": np.asarray(outcome.steps, dtype=np.int64),
            **{name: np.asarray(values, dtype=np.float64) for name, values in outcome.metrics.items()},
        }
        return self._arrow.table([self._array(n, columns[n]) for n in self._schema.names], schema=self._schema)

    def _array(self, name: str, values: Any) -> Any:
        # from_pandas=False: a metric that is NaN is a number, not a missing one
        return self._arrow.array(values, type=self._schema.field(name).type, from_pandas=False)

    def encode(self, part: Part) -> Any:
        """Return the bytes of a file."""
        extra_data = {_KEY: json.dumps({"seconds": dict(part.seconds), "sizes": dict(part.sizes)}).encode()}
        sink = self._arrow.BufferOutputStream()
        self._parquet.write_table(part.rows.replace_schema_metadata(extra_data), sink, write_page_checksum=True)
        return sink.getvalue()

    def decode(self, data: bytes, name: str, piece: Piece | None = None) -> Part:
        """Return the content of a file.

        Parameters
        ----------
        data : bytes
            Its bytes.
        name : str
            Its name, for messages.
        piece : Piece, optional
            The piece whose rows it must contain; by default the rows of all runs.

        Raises
        ------
        StoreError
            If it is damaged.
        """
        source = self._arrow.BufferReader(data)
        begin, end = (piece.begin, piece.end) if piece else (0, len(self.runs["run"]))
        try:
            rows = self._parquet.ParquetFile(source, page_checksum_verification=True).read(use_threads=False)
            extra_data = json.loads(rows.schema.metadata[_KEY])
            rows = rows.select(self._schema.names).cast(self._schema)
            if not np.array_equal(rows["run"].to_numpy(), np.arange(begin, end)):
                raise ValueError(rows.num_rows)
            return Part(rows, dict(extra_data["seconds"]), dict(extra_data["sizes"]))
        except (OSError, ValueError, LookupError, TypeError, self._arrow.ArrowException):
            raise StoreError(
                f"The file {name} of the campaign is damaged; resume the campaign to repeat its runs."
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
            keep[piece.begin : piece.end] = False  # the rows are those of all runs, so that row numbers are run numbers
        return rows.filter(self._arrow.array(keep))

    def of_piece(self, whole: Part, piece: Piece) -> Part:
        """Return the part of a piece, taken from the part of all pieces."""
        key = str(piece.index)
        return Part(whole.rows.slice(piece.begin, len(piece)), {key: whole.seconds[key]}, {key: whole.sizes[key]})

    def put(self, rows: Any, others: Any) -> Any:
        """Return rows in which the rows of `others` replace those of the same runs."""
        keep = ~np.isin(rows["run"].to_numpy(), others["run"].to_numpy())
        return self.joined([rows.filter(self._arrow.array(keep)), others])


__all__ = ["FOLDER", "OWN", "WHOLE", "Part", "Parts"]
