"""The files of a run that a page can download. Signals and figure come from one more run of the same scenario."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayesftc.cosim.base.extras import extra
from bayesftc.scenario._scenario import scenario_of
from bayesftc.scenario._written import toml

if TYPE_CHECKING:
    from bayesftc.cosim.run.result import Result


def _run(content: Mapping[str, Any], file: Path) -> Result:
    return scenario_of(content, file).simulate()


def _toml(content: Mapping[str, Any], file: Path) -> bytes:
    head = (
        f"# The scenario {file.stem} with what was done by hand. The same run once more:\n#\n#   bayesftc run FILE\n\n"
    )
    return (head + toml(content)).encode()


def _csv(content: Mapping[str, Any], file: Path) -> bytes:
    text: str = _run(content, file).to_pandas().to_csv()
    return text.encode()


def _parquet(content: Mapping[str, Any], file: Path) -> bytes:
    extra("pyarrow.parquet", "A Parquet file")
    data = io.BytesIO()
    _run(content, file).to_pandas().to_parquet(data)
    return data.getvalue()


def _figure(content: Mapping[str, Any], file: Path) -> bytes:
    data = io.BytesIO()
    _run(content, file).plot().savefig(data, dpi=150, format="png")
    return data.getvalue()


DOWNLOADS: Mapping[str, tuple[str, Callable[[Mapping[str, Any], Path], bytes]]] = {
    "scenario.toml": ("application/toml", _toml),
    "signals.csv": ("text/csv; charset=utf-8", _csv),
    "signals.parquet": ("application/vnd.apache.parquet", _parquet),
    "figure.png": ("image/png", _figure),
}
"""For each file its type, and the function that returns its content, given the content of the scenario and its file."""

__all__ = ["DOWNLOADS"]
