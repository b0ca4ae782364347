"""The file of an FMU (or of an SSP): checked before anything of it is used, and unpacked once per machine."""

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
        Path of the file.
    digest : str
        SHA-256 of its content: two copies of a file are the same FMU, an edited file is another.
    names : tuple of str
        Names of its entries.
    kind : Kind
        Kind of the file: FMU or SSP.
    """

    path: Path
    digest: str
    names: tuple[str, ...]
    kind: Kind = FMU_FILE

    def platforms(self) -> tuple[str, ...]:
        """Return the platforms with binaries in this file, in FMI's spelling."""
        paths = (PurePosixPath(name).parts for name in self.names)
        return tuple(sorted({parts[1] for parts in paths if len(parts) > 2 and parts[0] == "binaries"}))


def absolute(path: object, who: str, what: str, error: type[BayesFTCError]) -> Path:
    """Return a path of the user as an absolute path.

    Parameters
    ----------
    path : object
        The user's argument.
    who, what : str
        The function that it was given to, and the expected file, for the error message.
    error : type
        The error to raise if it is no path.
    """
    if not isinstance(path, str | PathLike):
        raise error(f"{who} has path={path!r}; it must be the path of {what}.")
    result = expanded(path).absolute()
    return _stand_ins.get(result, result)


def stand_in(path: Path, other: Path) -> None:
    """Use the file `other` in place of a file of another machine, wherever that is opened by its path there."""
    _stand_ins[path] = other


_stand_ins: dict[Path, Path] = {}


def open_archive(path: Path, kind: Kind = FMU_FILE) -> Archive:
    """Read the table of contents of an FMU (or SSP) without unpacking it.

    Raises
    ------
    FMUError
        If there is no such file, or it is no FMU, or unpacking it or reading its XML could do harm (see `_zip`).
    """
    try:
        status = path.stat()
    except OSError as error:
        raise kind.error(f"The {kind.noun} {path} cannot be read ({error.strerror}); check the path.") from None
    except ValueError:
        raise kind.error(
            f"The path {str(path)!r} contains a NUL character, which no file name can; check the path."
        ) from None
    if S_ISDIR(status.st_mode):
        raise kind.error(
            f"{path} is a folder; give the {kind.suffix} file itself, or zip the folder's content into one."
        )
    if not S_ISREG(status.st_mode):
        raise kind.error(f"{path} is a device or a pipe and no regular file; give the {kind.suffix} file itself.")
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
            read_entry(archive, name)  # refuses harmful XML before any parser sees it
    return archive


def read_entry(archive: Archive, name: str) -> bytes:
    """Return the content of one XML entry of any name; it has no document type, and so no entities.

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


def extract(archive: Archive, entry: str) -> Path:
    """Unpack an FMU (or SSP) into the user's cache, unless it is there already.

    Parameters
    ----------
    archive : Archive
        The file.
    entry : str
        An entry that must be there in the end. A folder that was emptied is unpacked again.

    Returns
    -------
    pathlib.Path
        The folder with its content. All processes of this user share it, and it is not deleted.

    Raises
    ------
    FMUError
        If the file is damaged, or there is no room for it.
    """
    from filelock import FileLock

    root = cache_directory(archive.kind.folder)
    folder = root / archive.digest
    if _is_there(folder, entry):
        return folder
    try:
        with FileLock(root / f"{archive.digest}.lock"):
            if not _is_there(folder, entry):  # else another process was faster
                for left in (
                    folder,
                    *root.glob(f".{archive.digest[:16]}-*"),
                ):  # also leftovers of a process that was killed
                    shutil.rmtree(left, ignore_errors=True)
                _unpack(archive, folder)
    except OSError as error:
        raise archive.kind.error(
            f"The {archive.kind.noun} {archive.path} cannot be unpacked into {root} ({error.strerror or error}); make room "
            "there, or set BAYESFTC_CACHE to another folder."
        ) from None
    return folder


def _is_there(folder: Path, name: str) -> bool:
    """Return whether this user has unpacked an FMU: files of other users in the cache are not trusted."""
    entry = folder / name
    return entry.exists() and is_own(folder) and is_own(entry)


def _unpack(archive: Archive, folder: Path) -> None:
    # Unpack in the same parent folder, so that one atomic move puts the complete content in place. Unpack from a copy, so that
    # the content matches the digest in the folder's name, even if the file is exported again meanwhile.
    temporary = Path(tempfile.mkdtemp(dir=folder.parent, prefix=f".{archive.digest[:16]}-"))
    copy = temporary / "copy.fmu"
    try:
        shutil.copyfile(archive.path, copy)
        with copy.open("rb") as file:
            if hashlib.file_digest(file, "sha256").hexdigest() != archive.digest:
                _read.cache_clear()
                raise archive.kind.error(f"{archive.path} changed while it was being read; read it again.")
        _zip.check(copy, archive.kind)  # again: the file may have changed since the first check
        _zip.unpack(copy, archive.kind, temporary / "content", archive.path)
        os.replace(temporary / "content", folder)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
