"""Zip files from anywhere: their table of contents is checked before anything of them is believed, and reading has limits.

Refused is whatever could be unpacked outside of its folder, over another entry, or to more than it says: names that are
absolute or lead upwards, links and devices, names that occur twice with other contents (capital letters and the ways to write an
accent make no difference to some systems), entries that lie over each other in the file (a bomb that needs no nesting), more
bytes than an honest file has, and packings other than the two that FMI and SSP allow (zipfile unpacks the others in one piece,
whatever their size).
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
"""Bytes that a file may unpack to; bytes from which on it may not be `RATIO` times its packed size."""

MOST, LONGEST_NAME, LONGEST_PATH = 100_000, 255, 2000
"""Entries of a file; bytes of a name, which is what file systems allow, and of a whole path."""

MOST_VARIABLES = 300_000
"""Variables of a model, or other elements beside each other: reading more takes minutes and gigabytes."""

LARGEST_XML, LONGEST_TAG, MOST_ELEMENTS, MOST_ATTRIBUTES, DEEPEST = 500_000_000, 10_000_000, 5_000_000, 1000, 200
"""Of XML: bytes, bytes of one tag or comment, elements, attributes of one, elements inside each other."""

ENCODINGS = frozenset({"utf-8", "us-ascii", "ascii", "iso-8859-1", "iso-8859-15", "windows-1252"})
"""Encodings of XML in which all parsers see the same text; FMI and SSP ask for the first."""

_PACKINGS = {zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED}
_PIECE = 1 << 18
_VARIABLE = 3  # how deep variables are: in the list of them, in the description
_XML_PIECE = 1 << 20
_DAMAGE = (zipfile.BadZipFile, zlib.error, EOFError, RuntimeError, ValueError, KeyError, OverflowError)
"""What zipfile raises for files that are damaged or packed in a way it does not know."""


@dataclass(frozen=True)
class Kind:
    """What a zip file is meant to be.

    Attributes
    ----------
    noun, suffix : str
        For messages, and the end of its name.
    main : str
        The entry that it must have.
    error : type
        What is raised where it is not in order.
    xml : tuple of str
        Entries that programs read as XML, checked when the file is opened; its documentation may hold other XML, for people.
    folder : str
        Where it is unpacked in the user's cache.
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
    """Read the table of contents of a zip file and return the names of its entries; nothing is unpacked.

    Raises
    ------
    FMUError
        If it is no zip file, or one that no honest tool makes.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            entries = archive.infolist()
            twice = _check_table(path, kind, entries, path.stat().st_size)
            _check_places(path, kind, archive)
            _check_twins(path, kind, archive, twice)
    except (OSError, *_DAMAGE) as error:
        if isinstance(error, OSError) and error.errno != errno.EINVAL:  # as of a place before the file's beginning
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
        If it is damaged, larger than `largest` bytes, or not as large as the table of contents says.
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
        What it is meant to be.
    folder : pathlib.Path
        The new folder.
    shown : pathlib.Path, optional
        What messages call the file, where `path` is a copy of it.

    Raises
    ------
    FMUError
        If an entry is damaged, or not as large as the table of contents says.
    OSError
        If there is no room.
    """
    folder.mkdir()
    shown = shown or path
    with _reading(shown, kind), zipfile.ZipFile(path) as archive:
        for entry in {entry.filename: entry for entry in archive.infolist()}.values():  # twins are alike
            target = folder.joinpath(*_parts(entry.filename))
            if entry.is_dir():
                target.mkdir(parents=True, exist_ok=True)
                continue
            target.parent.mkdir(parents=True, exist_ok=True)
            with target.open("xb") as file:
                for piece in _pieces(shown, kind, archive, entry):
                    file.write(piece)


def check_xml(content: bytes, what: str, kind: Kind) -> bytes:
    """Return XML as it is, if it has no document type: without one there are no entities, neither external nor nested.

    Parameters
    ----------
    content : bytes
        The XML text.
    what : str
        How a message begins, as ``"The modelDescription.xml of car.fmu"``.
    kind : Kind
        What kind of file it belongs to.

    Raises
    ------
    FMUError
        If it has one, is no XML, is nested too deeply, has more of something than an honest file, or is in an encoding that
        parsers may read differently.
    """
    parser = ParserCreate(namespace_separator=" ")
    depth = count = spaces = beside = 0

    def refuse(reason: str) -> None:
        raise kind.error(
            f"{what} {reason}; nothing was unpacked or loaded. Do not use this file; ask its maker for one without."
        )

    def declared(version: str, encoding: str | None, standalone: int) -> None:
        if encoding is not None and encoding.lower() not in ENCODINGS:
            refuse(f"is in the encoding {encoding!r}, where the standard asks for UTF-8")

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
            refuse(f"has elements more than {DEEPEST} deep inside each other")
        if count > MOST_ELEMENTS:
            refuse(f"has more than {MOST_ELEMENTS:,} elements")
        if len(attributes) + spaces > MOST_ATTRIBUTES:
            refuse(f"has an element with more than {MOST_ATTRIBUTES} attributes")
        spaces = 0

    def space(prefix: str | None, uri: str) -> None:
        nonlocal spaces  # of the element that begins next
        spaces += 1

    def end(name: str) -> None:
        nonlocal depth
        depth -= 1

    parser.XmlDeclHandler = declared
    parser.StartDoctypeDeclHandler = lambda *_: refuse(
        "has a document type declaration (DOCTYPE), through which it could read other files or grow without bound"
    )
    parser.StartElementHandler, parser.EndElementHandler, parser.StartNamespaceDeclHandler = begin, end, space
    try:
        if content[:2] in {b"\xff\xfe", b"\xfe\xff"}:
            refuse("is in the encoding UTF-16, where the standard asks for UTF-8")
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
    """Refuse what no honest tool writes; return entries that are there twice, of the same length and sum."""
    end = "nothing was unpacked. Do not use this file; ask its maker for one"
    seen: dict[tuple[str, ...], bool] = {}
    written: dict[tuple[str, ...], str] = {}
    first: dict[str, zipfile.ZipInfo] = {}
    twice = []
    for entry in entries:
        name, parts, folder = entry.filename, _parts(entry.filename), entry.filename.endswith("/")
        whole = entry.orig_filename  # zipfile ends the other name at a NUL
        whose = f"The {kind.noun} {path} has an entry called {whole!r}"
        odd = "\\" in whole or ":" in whole or not whole.isprintable()
        if odd or name.startswith("/") or ".." in parts or not parts:
            raise kind.error(
                f"{whose}, which could be unpacked outside of its folder; {end} with plain relative names."
            )
        mode = S_IFMT(entry.external_attr >> 16)
        if mode not in {0, S_IFREG, S_IFDIR}:
            raise kind.error(f"{whose}, which is a link or a device and no file; {end} with plain files alone.")
        other = first.setdefault(name, entry)
        if other is not entry and not folder and (other.file_size, other.CRC) == (entry.file_size, entry.CRC):
            twice.append((other, entry))
        elif parts in seen and not (folder and seen[parts]):
            raise _doubtful(path, kind, name)
        if len(name.encode()) > LONGEST_PATH or any(len(part.encode()) > LONGEST_NAME for part in parts):
            raise kind.error(
                f"The {kind.noun} {path} has an entry called {name[:40]!r} and so on, which is too long for the name of a file; "
                f"{end} with shorter names."
            )
        twin = name if folder else written.setdefault(tuple(normalize("NFC", p).casefold() for p in parts), name)
        if twin != name:
            raise kind.error(
                f"{whose} and one called {twin!r}, which are one file to some systems; {end} in which names are unique."
            )
        seen[parts] = folder
        if entry.flag_bits & 1:
            raise kind.error(f"{whose}, which is encrypted; {end} without a password.")
        if entry.compress_type not in _PACKINGS:
            raise kind.error(
                f"{whose}, which is packed in a way that the standard does not allow (method {entry.compress_type}); {end} "
                "that is stored or deflated."
            )
    for parts in seen:
        above = next((parts[:n] for n in range(1, len(parts)) if seen.get(parts[:n]) is False), None)
        if above:
            raise kind.error(
                f"The {kind.noun} {path} has an entry called {'/'.join(above)!r} that is a file and a folder at once; {end} in "
                "which names are unique."
            )
    unpacked = sum(entry.file_size for entry in entries)
    if unpacked > LARGEST or (unpacked > SUSPICIOUS and unpacked > RATIO * packed):
        raise kind.error(
            f"The {kind.noun} {path} of {packed / 1e6:.3g} MB would unpack to {unpacked / 1e6:.3g} MB, which no honest "
            f"{kind.noun} does; nothing was unpacked. Ask its maker for one without such filling."
        )
    if len(entries) > MOST:
        raise kind.error(
            f"The {kind.noun} {path} has {len(entries)} entries, which no honest {kind.noun} has; nothing was unpacked. Ask its "
            "maker for one without such filling."
        )
    return twice


def _doubtful(path: Path, kind: Kind, name: str) -> FMUError:
    return kind.error(
        f"The {kind.noun} {path} has an entry called {name!r} twice, so that nobody knows which of the two counts; nothing was "
        "unpacked. Do not use this file; ask its maker for one in which names are unique."
    )


def _check_twins(
    path: Path, kind: Kind, archive: zipfile.ZipFile, twice: list[tuple[zipfile.ZipInfo, zipfile.ZipInfo]]
) -> None:
    """Refuse entries of one name that differ, although their lengths and sums do not."""
    for one, other in twice:
        contents = (_pieces(path, kind, archive, entry) for entry in (one, other))
        if any(a != b for a, b in zip(*contents, strict=True)):
            raise _doubtful(path, kind, one.filename)


def _check_places(path: Path, kind: Kind, archive: zipfile.ZipFile) -> None:
    """Refuse entries that share bytes of the file: a small file can so unpack to any size."""
    file = archive.fp
    assert file is not None
    spans = []
    for entry in archive.infolist():
        file.seek(entry.header_offset)
        header = file.read(30)
        if len(header) < 30 or header[:4] != b"PK\3\4":
            raise zipfile.BadZipFile
        # The table of contents and the entry's own header may name different lengths; the data begin where the latter says.
        name, extra = unpack_from("<HH", header, 26)
        if file.read(name).decode("utf-8" if entry.flag_bits & 0x800 else "cp437") != entry.orig_filename:
            raise zipfile.BadZipFile
        spans.append(
            (entry.header_offset, entry.header_offset + 30 + name + extra + entry.compress_size, entry.filename)
        )
    for (_, end, name), (begin, _, other) in pairwise([*sorted(spans), (archive.start_dir, 0, "table of contents")]):
        if begin < end:
            raise kind.error(
                f"The {kind.noun} {path} has entries that lie over each other ({name!r} and {other!r}), as zip bombs have; "
                "nothing was unpacked. Do not use this file; ask its maker for another one."
            )


def _pieces(path: Path, kind: Kind, archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> Iterator[bytes]:
    """Yield an entry's content piece by piece, and stop where there is more than it says."""
    promised, count = entry.file_size, 0
    asked = copy.copy(entry)
    asked.file_size += 2 * _PIECE  # more is asked for than should be there, so that a lie shows
    with archive.open(asked) as file:
        while piece := file.read(_PIECE):
            count += len(piece)
            if count > promised:
                break
            yield piece
    if count != promised:
        raise kind.error(
            f"{entry.filename} of the {kind.noun} {path} unpacks to {'more' if count > promised else 'less'} than the "
            f"{promised} bytes that its table of contents says. Do not use this file; ask its maker for another one."
        )


__all__ = ["FMU_FILE", "Kind", "check", "check_xml", "read", "read_xml", "unpack"]
