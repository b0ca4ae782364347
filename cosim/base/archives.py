"""Zip files from untrusted sources: the table of contents is checked before use, and reading has limits.

Entries are refused that could be unpacked outside their folder, over another entry, or to more than their stated size:

- absolute names, and names that lead upwards; links and devices;
- equal names with different contents (some systems ignore case and the encoding of accents);
- entries that overlap in the file (a zip bomb without nesting), and more bytes than a normal file has;
- compression methods other than the two of FMI and SSP (zipfile unpacks others in one piece of any size).
"""

from __future__ import annotations

import copy
import errno
import zipfile
import zlib
from collections.abc import Iterator, Sized
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path, PurePosixPath
from stat import S_IFDIR, S_IFMT, S_IFREG
from struct import unpack_from
from unicodedata import normalize
from xml.parsers.expat import ExpatError, ParserCreate

from bayesftc.cosim.errors import FMUError

LARGEST, SUSPICIOUS, RATIO = 4_000_000_000, 100_000_000, 100
"""Most unpacked bytes of a file; and the bytes above which they must be less than `RATIO` times the packed size."""

MOST, LONGEST_NAME, LONGEST_PATH = 100_000, 255, 2000
"""Most entries of a file; most bytes of a name (as in file systems) and of a whole path."""

MOST_VARIABLES = 300_000
"""Most variables of a model, or other elements side by side: reading more takes minutes and gigabytes."""

LARGEST_XML, LONGEST_TAG, MOST_ELEMENTS, MOST_ATTRIBUTES, DEEPEST = 500_000_000, 10_000_000, 5_000_000, 1000, 200
"""Limits of XML: bytes, bytes of a tag or comment, elements, attributes of an element, nesting."""

ENCODINGS = frozenset({"utf-8", "us-ascii", "ascii", "iso-8859-1", "iso-8859-15", "windows-1252"})
"""Encodings of XML that all parsers read alike; FMI and SSP require the first."""

_PACKINGS = {zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED}
_PIECE = 1 << 18
_VARIABLE = 3  # nesting level of variables: description, list, variable
_XML_PIECE = 1 << 20
_DAMAGE = (zipfile.BadZipFile, zlib.error, EOFError, RuntimeError, ValueError, KeyError, OverflowError)
"""Exceptions of zipfile for damaged files and unknown compression methods."""


@dataclass(frozen=True)
class Kind:
    """A kind of zip file.

    Attributes
    ----------
    noun, suffix : str
        Its name for messages, and its file name extension.
    main : str
        The entry that it must have.
    error : type
        The error for invalid files.
    xml : tuple of str
        Entries that programs read as XML; they are checked when the file is opened. Documentation may contain other XML.
    folder : str
        Name of the folder for unpacked files in the user's cache.
    """

    noun: str
    suffix: str
    main: str
    error: type[FMUError]
    xml: tuple[str, ...]
    folder: str


_READ = ("modelDescription.xml", "sources/buildDescription.xml", "terminalsAndIcons/terminalsAndIcons.xml")
FMU_FILE = Kind("FMU", ".fmu", "modelDescription.xml", FMUError, _READ, "fmus")


def check(path: Path, kind: Kind) -> tuple[str, ...]:
    """Check the table of contents of a zip file and return the names of its entries, without unpacking.

    Raises
    ------
    FMUError
        If it is no zip file, or could do harm.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            entries = archive.infolist()
            twice = _check_table(path, kind, entries, path.stat().st_size)
            _check_places(path, kind, archive)
            _check_twins(path, kind, archive, twice)
    except (OSError, *_DAMAGE) as error:
        if isinstance(error, OSError) and error.errno != errno.EINVAL:  # EINVAL: a position before the file's beginning
            raise kind.error(
                f"The {kind.noun} {path} cannot be read ({error.strerror}); check its permissions."
            ) from None
        raise kind.error(
            f"{path} is no {kind.noun}: it is not a zip file, or it is damaged; get or export the file again."
        ) from None
    return tuple(entry.filename for entry in entries)


def read(path: Path, kind: Kind, name: str, largest: int = LARGEST) -> bytes:
    """Return the content of one entry.

    Raises
    ------
    FMUError
        If it is damaged, larger than `largest` bytes, or not of the size in the table of contents.
    """
    with _reading(path, kind), zipfile.ZipFile(path) as archive:
        entry = archive.getinfo(name)
        if entry.file_size > largest:
            raise kind.error(
                f"{name} of the {kind.noun} {path} is {entry.file_size / 1e6:.3g} MB large, more than the "
                f"{largest / 1e6:.3g} MB that can be read; nothing was unpacked. Ask its maker for a smaller one."
            )
        return b"".join(_pieces(path, kind, archive, entry))


def read_xml(path: Path, kind: Kind, name: str) -> bytes:
    """Return the content of an XML entry that was checked by `check_xml`."""
    return check_xml(read(path, kind, name, LARGEST_XML), f"The {name} of {path}", kind)


def unpack(path: Path, kind: Kind, folder: Path, shown: Path | None = None) -> None:
    """Unpack a file whose table of contents was checked into a folder that does not exist yet.

    Parameters
    ----------
    path : pathlib.Path
        The file.
    kind : Kind
        Its kind.
    folder : pathlib.Path
        The new folder.
    shown : pathlib.Path, optional
        The path for messages, if `path` is a copy.

    Raises
    ------
    FMUError
        If an entry is damaged, or not of the size in the table of contents.
    OSError
        If there is no room.
    """
    folder.mkdir()
    shown = shown or path
    with _reading(shown, kind), zipfile.ZipFile(path) as archive:
        for entry in {entry.filename: entry for entry in archive.infolist()}.values():  # duplicates are equal
            target = folder.joinpath(*_parts(entry.filename))
            if entry.is_dir():
                target.mkdir(parents=True, exist_ok=True)
                continue
            target.parent.mkdir(parents=True, exist_ok=True)
            with target.open("xb") as file:
                for piece in _pieces(shown, kind, archive, entry):
                    file.write(piece)


def check_xml(content: bytes, what: str, kind: Kind) -> bytes:
    """Check XML and return it unchanged. It must have no document type, and so has no external or nested entities.

    Parameters
    ----------
    content : bytes
        The XML text.
    what : str
        Beginning of messages, as ``"The modelDescription.xml of car.fmu"``.
    kind : Kind
        The kind of its file.

    Raises
    ------
    FMUError
        If it has a document type, is no XML, exceeds a limit, or has an encoding that parsers may read differently.
    """
    parser = ParserCreate(namespace_separator=" ")
    depth = count = spaces = beside = 0

    def refuse(reason: str) -> None:
        raise kind.error(
            f"{what} {reason}; nothing was unpacked or loaded. Do not use this file; ask its maker for one without this."
        )

    def declared(version: str, encoding: str | None, standalone: int) -> None:
        if encoding is not None and encoding.lower() not in ENCODINGS:
            refuse(f"is in the encoding {encoding!r}, but the standard requires UTF-8")

    def begin(name: str, attributes: Sized) -> None:
        nonlocal depth, count, spaces, beside
        depth, count = depth + 1, count + 1
        beside = 0 if depth < _VARIABLE else beside + (depth == _VARIABLE)
        if beside > MOST_VARIABLES:
            raise kind.error(
                f"{what} has more than {MOST_VARIABLES:,} variables, which takes too long to read; nothing was unpacked or "
                "loaded. Export the model without its protected and auxiliary variables."
            )
        if depth > DEEPEST:
            refuse(f"has more than {DEEPEST} levels of nested elements")
        if count > MOST_ELEMENTS:
            refuse(f"has more than {MOST_ELEMENTS:,} elements")
        if len(attributes) + spaces > MOST_ATTRIBUTES:
            refuse(f"has an element with more than {MOST_ATTRIBUTES} attributes")
        spaces = 0

    def space(prefix: str | None, uri: str) -> None:
        nonlocal spaces  # counted for the next element
        spaces += 1

    def end(name: str) -> None:
        nonlocal depth
        depth -= 1

    parser.XmlDeclHandler = declared
    parser.StartDoctypeDeclHandler = lambda *_: refuse(
        "has a document type declaration (DOCTYPE), which could read other files or grow without bound"
    )
    parser.StartElementHandler, parser.EndElementHandler, parser.StartNamespaceDeclHandler = begin, end, space
    try:
        if content[:2] in {b"\xff\xfe", b"\xfe\xff"}:
            refuse("is in the encoding UTF-16, but the standard requires UTF-8")
        for fed in range(0, len(content), _XML_PIECE):
            if fed - parser.CurrentByteIndex > LONGEST_TAG:
                refuse(f"has a tag or a comment of more than {LONGEST_TAG / 1e6:g} MB")
            parser.Parse(content[fed : fed + _XML_PIECE], False)
        parser.Parse(b"", True)
    except (ExpatError, LookupError, ValueError) as error:
        raise kind.error(f"{what} is damaged ({error}); get or export the {kind.noun} again.") from None
    return content


@contextmanager
def _reading(path: Path, kind: Kind) -> Iterator[None]:
    try:
        yield
    except _DAMAGE:
        raise kind.error(
            f"The {kind.noun} {path} is damaged: its content cannot be unpacked; get or export the file again."
        ) from None


def _parts(name: str) -> tuple[str, ...]:
    return PurePosixPath(name).parts


def _check_table(
    path: Path, kind: Kind, entries: list[zipfile.ZipInfo], packed: int
) -> list[tuple[zipfile.ZipInfo, zipfile.ZipInfo]]:
    """Refuse invalid entries; return pairs of entries with the same name, length and checksum."""
    end = "nothing was unpacked. Do not use this file; ask its maker for one"
    seen: dict[tuple[str, ...], bool] = {}
    written: dict[tuple[str, ...], str] = {}
    first: dict[str, zipfile.ZipInfo] = {}
    duplicates = []
    for entry in entries:
        name, parts, folder = entry.filename, _parts(entry.filename), entry.filename.endswith("/")
        full_name = entry.orig_filename  # zipfile cuts `filename` at a NUL
        label = f"The {kind.noun} {path} has an entry called {full_name!r}"
        is_odd = "\\" in full_name or ":" in full_name or not full_name.isprintable()
        if is_odd or name.startswith("/") or ".." in parts or not parts:
            raise kind.error(f"{label}, which could be unpacked outside its folder; {end} with plain relative names.")
        mode = S_IFMT(entry.external_attr >> 16)
        if mode not in {0, S_IFREG, S_IFDIR}:
            raise kind.error(f"{label}, which is a link or a device and no file; {end} with plain files only.")
        other = first.setdefault(name, entry)
        if other is not entry and not folder and (other.file_size, other.CRC) == (entry.file_size, entry.CRC):
            duplicates.append((other, entry))
        elif parts in seen and not (folder and seen[parts]):
            raise _doubtful(path, kind, name)
        if len(name.encode()) > LONGEST_PATH or any(len(part.encode()) > LONGEST_NAME for part in parts):
            raise kind.error(
                f"The {kind.noun} {path} has an entry called {name[:40]!r} and so on, which is too long for a file name; "
                f"{end} with shorter names."
            )
        same_name = name if folder else written.setdefault(tuple(normalize("NFC", p).casefold() for p in parts), name)
        if same_name != name:
            raise kind.error(
                f"{label} and one called {same_name!r}, which are the same file on some systems; {end} with unique names."
            )
        seen[parts] = folder
        if entry.flag_bits & 1:
            raise kind.error(f"{label}, which is encrypted; {end} without a password.")
        if entry.compress_type not in _PACKINGS:
            raise kind.error(
                f"{label}, with a compression that the standard does not allow (method {entry.compress_type}); {end} "
                "that is stored or deflated."
            )
    for parts in seen:
        above = next((parts[:n] for n in range(1, len(parts)) if seen.get(parts[:n]) is False), None)
        if above:
            raise kind.error(
                f"The {kind.noun} {path} has an entry called {'/'.join(above)!r} that is a file and a folder at once; {end} with "
                "unique names."
            )
    unpacked = sum(entry.file_size for entry in entries)
    if unpacked > LARGEST or (unpacked > SUSPICIOUS and unpacked > RATIO * packed):
        raise kind.error(
            f"The {kind.noun} {path} of {packed / 1e6:.3g} MB would unpack to {unpacked / 1e6:.3g} MB, which is implausible for "
            f"an {kind.noun}; nothing was unpacked. Ask its maker for a smaller one."
        )
    if len(entries) > MOST:
        raise kind.error(
            f"The {kind.noun} {path} has {len(entries)} entries, which is implausible for an {kind.noun}; nothing was unpacked. "
            "Ask its maker for one with fewer entries."
        )
    return duplicates


def _doubtful(path: Path, kind: Kind, name: str) -> FMUError:
    return kind.error(
        f"The {kind.noun} {path} has an entry called {name!r} twice, with different contents; nothing was unpacked. "
        "Do not use this file; ask its maker for one with unique names."
    )


def _check_twins(
    path: Path, kind: Kind, archive: zipfile.ZipFile, twice: list[tuple[zipfile.ZipInfo, zipfile.ZipInfo]]
) -> None:
    """Refuse entries of the same name, length and checksum that differ in content."""
    for one, other in twice:
        contents = (_pieces(path, kind, archive, entry) for entry in (one, other))
        if any(a != b for a, b in zip(*contents, strict=True)):
            raise _doubtful(path, kind, one.filename)


def _check_places(path: Path, kind: Kind, archive: zipfile.ZipFile) -> None:
    """Refuse entries that share bytes of the file: with these, a small file can unpack to any size."""
    file = archive.fp
    assert file is not None
    spans = []
    for entry in archive.infolist():
        file.seek(entry.header_offset)
        header = file.read(30)
        if len(header) < 30 or header[:4] != b"PK\3\4":
            raise zipfile.BadZipFile
        # The table of contents and the entry's header may give different lengths; the header determines where the data begin.
        name, extra = unpack_from("<HH", header, 26)
        if file.read(name).decode("utf-8" if entry.flag_bits & 0x800 else "cp437") != entry.orig_filename:
            raise zipfile.BadZipFile
        spans.append(
            (entry.header_offset, entry.header_offset + 30 + name + extra + entry.compress_size, entry.filename)
        )
    for (_, end, name), (begin, _, other) in pairwise([*sorted(spans), (archive.start_dir, 0, "table of contents")]):
        if begin < end:
            raise kind.error(
                f"The {kind.noun} {path} has entries that overlap in the file ({name!r} and {other!r}), as in zip bombs; "
                "nothing was unpacked. Do not use this file; ask its maker for another one."
            )


def _pieces(path: Path, kind: Kind, archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> Iterator[bytes]:
    """Yield an entry's content piece by piece; refuse it if its size is not the stated one."""
    stated, count = entry.file_size, 0
    request = copy.copy(entry)
    request.file_size += 2 * _PIECE  # request more than the stated size, to detect a longer content
    with archive.open(request) as file:
        while piece := file.read(_PIECE):
            count += len(piece)
            if count > stated:
                break
            yield piece
    if count != stated:
        raise kind.error(
            f"{entry.filename} of the {kind.noun} {path} unpacks to {'more' if count > stated else 'less'} than the "
            f"{stated} bytes in its table of contents. Do not use this file; ask its maker for another one."
        )


__all__ = ["FMU_FILE", "Kind", "check", "check_xml", "read", "read_xml", "unpack"]
