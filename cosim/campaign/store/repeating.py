"""The job of a stored campaign, kept beside its results so that any run can be repeated from the store alone."""

from __future__ import annotations

import pickle
from contextlib import suppress
from pathlib import Path

from bayesftc.cosim.campaign.runs.job import Job
from bayesftc.cosim.campaign.runs.shipping import Content, Parcel
from bayesftc.cosim.campaign.store.durable import write_whole
from bayesftc.cosim.campaign.store.reading import StoredCampaign
from bayesftc.cosim.errors import ModelError, StoreError

FILE = "job.pickle"


def keep_job(folder: Path, job: Job) -> None:
    """Write a job into the folder of its store if it is not there; a job that cannot be pickled is not kept.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    if (folder / FILE).exists():
        return
    with suppress(ModelError):
        parcel = Parcel(job)
        names = {content.digest: content.name for content in parcel.fmus}
        write_whole(folder / FILE, pickle.dumps((names, parcel.payload)))


def kept_job(store: StoredCampaign) -> Job:
    """Return the job of a stored campaign; its FMUs are the copies in the store.

    The file is a pickle, which can execute any Python code. Read only stores from people whose programs you would run.

    Raises
    ------
    StoreError
        If the store has no job, or the job cannot be read here.
    """
    try:
        names, payload = pickle.loads((store.path / FILE).read_bytes())
        for digest, name in names.items():
            Content(digest, name).place(store.fmu(digest).read_bytes())
        job = pickle.loads(payload)
    except FileNotFoundError:
        raise StoreError(
            f"The campaign in {store.path} cannot be repeated from its store, because its loop could not be pickled; create "
            "the campaign in Python, and call its method replay."
        ) from None
    except StoreError:
        raise
    except ModuleNotFoundError as error:
        raise StoreError(
            f"The campaign in {store.path} cannot be repeated here: it needs the module {error.name!r}, which is not found. "
            "Install it, or name the folder of its file: PYTHONPATH=FOLDER bayesftc replay ..."
        ) from error
    except Exception as error:
        raise StoreError(
            f"The campaign in {store.path} cannot be repeated here ({type(error).__name__}: {error}). Its {FILE} is damaged, or "
            "needs the modules and versions that it was made with; campaign.json names them."
        ) from error
    if not isinstance(job, Job) or job.plan.seeds != store.plan.seeds:
        raise StoreError(f"{store.path / FILE} does not contain the loop of this campaign; use a backup of the store.")
    return job


__all__ = ["keep_job", "kept_job"]
