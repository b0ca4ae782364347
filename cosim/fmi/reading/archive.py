"""The file of an FMU (or of an SSP): checked before anything of it is believed, and unpacked once per machine."""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
from dataclasses import dataclass
from functools import lru_cache
from os import PathLike
from pathlib import Path, PurePosixPath
from stat import S_ISDIR, S_ISREG

from bayesftc.cosim.base import archives as _zip
from bayesftc.cosim.base.archives import FMU_FILE, Kind
from bayesftc.cosim.base.cache import cache_directory, is_own
from bayesftc.cosim.base.paths import expanded
from bayesftc.cosim.errors import BayesFTCError

DESCRIPTION = FMU_FILE.main


@dataclass(frozen=True)
class Archive:
    """An FMU (or SSP) file whose table of contents is in order.

    Attributes
    ----------
    path : pathlib.Path
        Where it lies.
    digest : str
        SHA-256 of its content: two copies of a file are the same FMU, an edited file is another.
    names : tuple of str
        Names of its entries.
    kind : Kind
        What it is.
    """

    path: Path
    digest: str
    names: tuple[str, ...]
    kind: Kind = FMU_FILE

    def platforms(self) -> tuple[str, ...]:
        """Return the names of the platforms that it has binaries for, as FMI spells them."""
        found = (PurePosixPath(name).parts for name in self.names)
        return tuple(sorted({parts[1] for parts in found if len(parts) > 2 and parts[0] == "binaries"}))


def absolute(path: object, who: str, what: str, error: type[BayesFTCError]) -> Path:
    """Return a path that somebody has given as an absolute one.

    Parameters
    ----------
    path : object
        What was given.
    who, what : str
        Whom it was given to, and what it is to be the path of, as the error says.
    error : type
        What is raised if it is no path.
    """
    if not isinstance(path, str | PathLike):
        raise error(f"{who} has path={path!r}; it must be the path of {what}.")
    found = expanded(path).absolute()
    return _stand_ins.get(found, found)


def stand_in(path: Path, other: Path) -> None:
    """Have `other` taken for a file of another machine wherever that is asked for by its path there."""
    _stand_ins[path] = other


_stand_ins: dict[Path, Path] = {}


def open_archive(path: Path, kind: Kind = FMU_FILE) -> Archive:
    """Read the table of contents of an FMU (or SSP); nothing is unpacked.

    Raises
    ------
    FMUError
        If there is no such file, it is no FMU, or one that could do harm when it is unpacked or its XML is read (see `_zip`).
    """
    try:
        status = path.stat()
    except OSError as error:
        raise kind.error(f"The {kind.noun} {path} cannot be read ({error.strerror}); check the path.") from None
    except ValueError:
        raise kind.error(f"The path {str(path)!r} has a NUL in it, as no file's has; check the path.") from None
    if S_ISDIR(status.st_mode):
        raise kind.error(
            f"{path} is a folder; give the {kind.suffix} file itself, or zip the folder's content into one."
        )
    if not S_ISREG(status.st_mode):
        raise kind.error(
            f"{path} is no file but a device, or a connection between programs; give the {kind.suffix} file itself."
        )
    return _read(path, kind, (status.st_mtime_ns, status.st_ctime_ns, status.st_size, status.st_ino))


@lru_cache(maxsize=256)
def _read(path: Path, kind: Kind, stamp: tuple[int, ...]) -> Archive:
    try:
        with path.open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise _unreadable(path, kind, error) from None
    names = _zip.check(path, kind)
    if kind.main not in names:
        raise kind.error(
            f"{path} is no {kind.noun}: it is a zip file without {kind.main} at its top; export the model again."
        )
    archive = Archive(path, digest, names, kind)
    for name in kind.xml:
        if name in names:
            read_entry(archive, name)  # what XML can do to its reader is found out here, before anyone reads it
    return archive


def read_entry(archive: Archive, name: str) -> bytes:
    """Return the content of one entry of XML, whatever it is called; it has no document type, and so no entities.

    Raises
    ------
    FMUError
        If it is damaged, or hostile.
    """
    try:
        return _zip.read_xml(archive.path, archive.kind, name)
    except OSError as error:
        raise _unreadable(archive.path, archive.kind, error) from None


def _unreadable(path: Path, kind: Kind, error: OSError) -> Exception:
    return kind.error(f"The {kind.noun} {path} cannot be read ({error.strerror}); check its permissions.")


def extract(archive: Archive, wanted: str) -> Path:
    """Unpack an FMU (or SSP) into the user's cache, unless it is there already.

    Parameters
    ----------
    archive : Archive
        The file.
    wanted : str
        An entry that must be there in the end: a folder that someone emptied is unpacked anew.

    Returns
    -------
    pathlib.Path
        The folder with its content; it is shared by all processes of this user, and stays.

    Raises
    ------
    FMUError
        If the file is damaged, or there is no room for it.
    """
    from filelock import FileLock

    root = cache_directory(archive.kind.folder)
    folder = root / archive.digest
    if _is_there(folder, wanted):
        return folder
    try:
        with FileLock(root / f"{archive.digest}.lock"):
            if not _is_there(folder, wanted):  # else another process was faster
                for left in (
                    folder,
                    *root.glob(f".{archive.digest[:16]}-*"),
                ):  # of a process that was killed meanwhile, too
                    shutil.rmtree(left, ignore_errors=True)
                _unpack(archive, folder)
    except OSError as error:
        raise archive.kind.error(
            f"The {archive.kind.noun} {archive.path} cannot be unpacked into {root} ({error.strerror or error}); make room "
            "there, or set BAYESFTC_CACHE to another folder."
        ) from None
    return folder


def _is_there(folder: Path, wanted: str) -> bool:
    """Return whether an FMU was unpacked, by this user: what others have left in the cache is not trusted."""
    entry = folder / wanted
    return entry.exists() and is_own(folder) and is_own(entry)


def _unpack(archive: Archive, folder: Path) -> None:
    # Beside its place, so that the move is one step and no one ever sees half of it; from a copy, so that what is unpacked is
    # what the folder is named after, even if someone exports the file anew just now.
    temporary = Path(tempfile.mkdtemp(dir=folder.parent, prefix=f".{archive.digest[:16]}-"))
    copy = temporary / "copy.fmu"
    try:
        shutil.copyfile(archive.path, copy)
        with copy.open("rb") as file:
            if hashlib.file_digest(file, "sha256").hexdigest() != archive.digest:
                _read.cache_clear()
                raise archive.kind.error(f"{archive.path} was changed while it was being read; read it again.")
        _zip.check(
            copy, archive.kind
        )  # again: what was checked before was a file that others may have changed meanwhile
        _zip.unpack(copy, archive.kind, temporary / "content", archive.path)
        os.replace(temporary / "content", folder)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
