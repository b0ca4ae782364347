"""Make the folder of a new campaign: beside its final place, and move it there when it is complete."""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bayesftc.cosim.base.temporary import BESIDE, temporary_folder
from bayesftc.cosim.campaign.designs.plan import Plan
from bayesftc.cosim.campaign.store import chunks, parts
from bayesftc.cosim.campaign.store.durable import sync_all, sync_folder
from bayesftc.cosim.campaign.store.metadata import NAME, Metadata, Signal, hash_of
from bayesftc.cosim.errors import StoreError
from bayesftc.cosim.types import Floats

FMUS = "fmus"


def metadata_of(
    description: Mapping[str, Any],
    plan: Plan,
    signals: Mapping[str, Signal],
    time: Floats,
    metrics: Iterable[str],
    fmus: Mapping[str, str | os.PathLike[str]] | None,
    labels: Iterable[Mapping[str, Any]] | None,
    units: Mapping[str, str] | None,
) -> Metadata:
    """Return the metadata of a campaign; the parameters are those of `CampaignStore.create`."""
    shown = Plan(tuple(plan.points if labels is None else labels), plan.seeds, plan.size)
    rows = len(time) if signals else 0
    names = {digest: Path(path).name for digest, path in (fmus or {}).items()}
    times = hash_of(time) if signals else ""
    metrics = tuple(metrics)
    for what, names_of in (("metric", metrics), ("signal", signals)):
        reserved = next((name for name in names_of if name in parts.OWN), None)
        if reserved is not None:
            raise StoreError(
                f"A {what} cannot be called {reserved!r}, because each campaign has a column of that name; use another name."
            )
    return Metadata(description, shown, dict(signals), rows, times, metrics, names, units=units or {})


def make(path: Path, metadata: Metadata, time: Floats, fmus: Mapping[str, str | os.PathLike[str]]) -> None:
    """Make the folder of a campaign without any runs.

    Parameters
    ----------
    path : pathlib.Path
        The folder.
    metadata : Metadata
        Its metadata.
    time : ndarray of shape (rows,)
        Time of each row of the signals, in seconds.
    fmus : mapping of str to path
        The FMUs, by their SHA-256.

    Raises
    ------
    StoreError
        If the folder cannot be written, is not empty, or an FMU has another hash.
    """
    runs = parts.Parts(metadata).runs
    if (path / NAME).exists():
        raise StoreError(f"There is already a campaign in {path}; resume it, or choose another folder.")
    try:
        if path.exists() and (not path.is_dir() or any(path.iterdir())):
            what = "is not empty" if path.is_dir() else "is a file"
            raise StoreError(f"A campaign cannot be stored in {path}: it {what}; choose another folder.")
        path.parent.mkdir(parents=True, exist_ok=True)
        with temporary_folder(BESIDE, path.parent) as made:
            made.chmod(0o777 & ~_umask())
            _copy_fmus(made / FMUS, fmus)
            (made / parts.FOLDER).mkdir()
            if metadata.signals:
                chunks.create(made, metadata, np.asarray(time, dtype=np.float64), runs)
            metadata.write(made)
            sync_all(made)
            os.replace(made, path)  # also over an empty folder; so the folder is complete as soon as it is visible
        sync_folder(path.parent)
    except OSError as error:
        raise StoreError(
            f"A campaign cannot be stored in {path} ({error.strerror or error}); choose another folder."
        ) from None


def _copy_fmus(folder: Path, fmus: Mapping[str, str | os.PathLike[str]]) -> None:
    folder.mkdir()
    for digest, source in fmus.items():
        copy = folder / f"{digest}.fmu"
        shutil.copyfile(source, copy)
        if digest_of(copy) != digest:
            raise StoreError(f"The FMU {source} has changed since the campaign was made: its SHA-256 is not {digest}.")


def digest_of(path: Path) -> str:
    """Return the SHA-256 of a file."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


__all__ = ["FMUS", "digest_of", "make", "metadata_of"]
