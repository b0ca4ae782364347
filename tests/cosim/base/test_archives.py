"""Hostile archives: nothing of them is unpacked, loaded, or read by a parser that would expand it."""

import os
import re
import stat
import struct
import tracemalloc
import zipfile
import zlib
from contextlib import suppress
from fractions import Fraction
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from bayesftc import cosim, fmus
from bayesftc.cosim import BayesFTCError, FMUError
from bayesftc.cosim.base import archives as _zip
from bayesftc.cosim.fmi.fmu import FMU, describe
from bayesftc.cosim.fmi.reading import archive as _fmi_archive

SHIPPED = fmus.path("CruiseControl")
DESCRIPTION = "modelDescription.xml"
XML = zipfile.ZipFile(SHIPPED).read(DESCRIPTION)


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    """A cache of this test's own, so that one sees whether anything was unpacked."""
    monkeypatch.setenv("BAYESFTC_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def archive_of(path, entries, *, description=XML, shipped=True, **options):
    """Write a zip file: the shipped FMU's entries, then `entries` (names or ZipInfo objects, and their contents)."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, **options) as new, zipfile.ZipFile(SHIPPED) as old:
        for name in old.namelist() if shipped else ():
            new.writestr(name, description if name == DESCRIPTION else old.read(name))
        for entry, content in entries:
            new.writestr(entry, content)
    return path


def refused(path, *parts, cache):
    for use in (describe, FMU):
        with pytest.raises(FMUError) as caught:
            use(path)
        for part in (path.name, *parts):
            assert part in str(caught.value)
        assert str(caught.value).endswith(".")
        assert caught.value.__suppress_context__ or caught.value.__context__ is None
    assert not cache.exists() or not [p for p in cache.rglob("*") if p.is_file()]


def named(name, mode=0o644 | stat.S_IFREG, **more):
    """Return an entry whose name is written as it is."""
    entry = zipfile.ZipInfo("placeholder")
    entry.filename, entry.external_attr = name, mode << 16
    entry.compress_type = zipfile.ZIP_DEFLATED
    for key, value in more.items():
        setattr(entry, key, value)
    return entry


@pytest.mark.parametrize(
    "name",
    ["../evil", "/etc/evil", "a/../../evil", "C:/evil", "a\\..\\evil", "a\nb", ".", "a/..", f"{DESCRIPTION}\0.txt"],
)
def test_names_that_lead_elsewhere(tmp_path, cache, name):
    path = archive_of(tmp_path / "names.fmu", [(named(name), "evil")])
    refused(path, repr(name), "could be unpacked outside its folder; nothing was unpacked", cache=cache)


@pytest.mark.parametrize("kind", [stat.S_IFLNK, stat.S_IFIFO, stat.S_IFCHR, stat.S_IFSOCK])
def test_links_and_devices(tmp_path, cache, kind):
    link = named("binaries/linux64/lib", mode=0o777 | kind)
    path = archive_of(tmp_path / "link.fmu", [(link, "/etc/passwd"), ("binaries/linux64/lib/x", "evil")])
    refused(path, "'binaries/linux64/lib'", "which is a link or a device and no file", cache=cache)


@pytest.mark.filterwarnings("ignore:Duplicate name")
@pytest.mark.parametrize("name", [DESCRIPTION, f"./{DESCRIPTION}", f".//{DESCRIPTION}"])
def test_names_that_occur_twice(tmp_path, cache, name):
    path = archive_of(tmp_path / "twice.fmu", [(named(name), XML + XML[-1:])])
    refused(path, f"{name!r} twice", "with different contents", cache=cache)


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_a_file_that_is_there_twice_alike_counts_once(tmp_path, cache):
    """Some tools write one so; but what has the same length and sum is compared to the last byte."""
    path = archive_of(tmp_path / "alike.fmu", [("resources/a", b"abc"), ("resources/a", b"abc")])
    diagram = cosim.Diagram(dt=0.02)
    diagram.add(FMU(path), "car")
    assert len(diagram.simulate(0.1, engine="interpreted")["car.v"]) == 6
    assert [p.read_bytes() for p in cache.rglob("resources/a")] == [b"abc"]
    other = b"abcd", b"wxyz"
    path = archive_of(tmp_path / "sums.fmu", [("resources/b", other[0]), ("resources/b", other[1])])
    content = path.read_bytes()
    sums = [zlib.crc32(each).to_bytes(4, "little") for each in other]
    (tmp_path / "lies.fmu").write_bytes(content.replace(sums[0], sums[1]))
    with pytest.raises(FMUError, match=r"twice|damaged"):
        describe(tmp_path / "lies.fmu")


@pytest.mark.parametrize(
    ("name", "other"), [(DESCRIPTION.upper(), DESCRIPTION), ("a/E\u0301.txt", "a/\u00c9.TXT"), ("A/b", "a/B")]
)
def test_names_that_are_one_to_some_systems(tmp_path, cache, name, other):
    path = archive_of(tmp_path / "twins.fmu", [] if other == DESCRIPTION else [(other, "1")])
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr(name, "2")
    refused(path, f"{name!r} and one called {other!r}, which are the same file on some systems", cache=cache)


@pytest.mark.parametrize("name", ["a/" + "b" * 300, "ab/" * 1000 + "c"])
def test_names_that_no_file_can_have(tmp_path, cache, name):
    path = archive_of(tmp_path / "long.fmu", [(name, "1")])
    refused(path, f"{name[:40]!r} and so on, which is too long for a file name; nothing", cache=cache)


def test_an_entry_that_calls_itself_otherwise(tmp_path, cache):
    content = bytearray(archive_of(tmp_path / "names.fmu", [("resources/good", "1")]).read_bytes())
    place = content.index(b"resources/good")
    content[place : place + 14] = b"../../../.evil"
    (tmp_path / "names.fmu").write_bytes(content)
    refused(tmp_path / "names.fmu", "it is not a zip file, or it is damaged", cache=cache)


@pytest.mark.parametrize("place", [2**32, 2**63 - 1, 2**63, 2**64 - 1])
def test_places_beyond_the_file(tmp_path, cache, place):
    name = DESCRIPTION.encode()
    entry = zipfile.ZipInfo(DESCRIPTION)
    entry.file_size = entry.compress_size = len(XML)
    entry.CRC = zlib.crc32(XML)
    more = struct.pack("<HHQ", 1, 8, place)
    sizes = zlib.crc32(XML), len(XML), len(XML), len(name), len(more), 0, 0, 0, 0, 0xFFFF_FFFF
    table = struct.pack("<4s6H3L5H2L", b"PK\1\2", 45, 45, 0, 0, 0, 0, *sizes) + name + more
    body = entry.FileHeader() + XML
    path = tmp_path / "far.fmu"
    path.write_bytes(body + table + struct.pack("<4s4H2LH", b"PK\5\6", 0, 0, 1, 1, len(table), len(body), 0))
    refused(path, "it is not a zip file, or it is damaged", cache=cache)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
def test_what_is_no_file_is_not_waited_for(tmp_path, cache):
    os.mkfifo(tmp_path / "pipe.fmu")
    refused(tmp_path / "pipe.fmu", "is a device or a pipe and no regular file", cache=cache)
    refused(Path("/dev/zero"), "is a device or a pipe", cache=cache)
    with pytest.raises(FMUError, match="contains a NUL character"):
        FMU(tmp_path / "a\0b.fmu")


def test_a_file_that_is_a_folder_too(tmp_path, cache):
    path = archive_of(tmp_path / "both.fmu", [("resources", "file"), ("resources/table.csv", "1")])
    refused(path, "'resources' that is a file and a folder at once", cache=cache)


def test_folders_may_be_listed_more_than_once(tmp_path):
    with pytest.warns(UserWarning, match="Duplicate"):
        path = archive_of(tmp_path / "folders.fmu", [("resources/", ""), ("resources/", ""), ("resources/a", "1")])
    FMU(path).instantiate(Fraction(1, 50), "car").close()


def test_encrypted_and_oddly_packed_entries(tmp_path, cache):
    path = archive_of(tmp_path / "odd.fmu", [(named("table", compress_type=zipfile.ZIP_LZMA), "1")])
    refused(path, "'table', with a compression that the standard does not allow (method 14)", cache=cache)
    locked = bytearray(archive_of(tmp_path / "locked.fmu", [("table", "1")]).read_bytes())
    locked[locked.rindex(b"PK\1\2") + 8] |= 1
    (tmp_path / "locked.fmu").write_bytes(locked)
    refused(tmp_path / "locked.fmu", "'table', which is encrypted", cache=cache)


def test_a_bomb_that_says_so(tmp_path, cache):
    zeros = bytes(50_000_000)
    path = archive_of(tmp_path / "bomb.fmu", [(f"resources/{i}", zeros) for i in range(5)])
    refused(path, "would unpack to 250 MB, which is implausible for an FMU; nothing was unpacked", cache=cache)


def lying(path, name, size):
    """Change the size that the table of contents and the entry itself give for an entry."""
    content = bytearray(path.read_bytes())
    for mark, names, sizes in ((b"PK\3\4", 30, 22), (b"PK\1\2", 46, 24)):
        place = -1
        while (place := content.find(mark, place + 1)) >= 0:
            if content[place + names : place + names + len(name)] == name.encode():
                content[place + sizes : place + sizes + 4] = struct.pack("<I", size)
    path.write_bytes(content)
    return path


def test_a_description_that_lies_about_its_size(tmp_path, cache):
    path = lying(archive_of(tmp_path / "lies.fmu", [], description=XML + b" " * 80_000_000), DESCRIPTION, 1000)
    tracemalloc.start()
    try:
        refused(path, f"{DESCRIPTION} of the FMU", "unpacks to more than the 1000 bytes", cache=cache)
        assert tracemalloc.get_traced_memory()[1] < 5_000_000  # it stopped there
    finally:
        tracemalloc.stop()


def test_an_entry_that_lies_about_its_size(tmp_path, cache):
    path = archive_of(tmp_path / "lies.fmu", [(named("resources/table"), bytes(80_000_000))])
    block = FMU(lying(path, "resources/table", 1000))
    with pytest.raises(FMUError, match=r"resources/table of the FMU .*lies\.fmu unpacks to more than the 1000 bytes"):
        block.instantiate(Fraction(1, 50), "car")
    assert [p.suffix for p in cache.rglob("*") if p.is_file()] == [".lock"]  # nothing half unpacked is left


def test_an_entry_that_is_shorter_than_it_says(tmp_path, cache):
    path = lying(archive_of(tmp_path / "short.fmu", []), DESCRIPTION, len(XML) + 5)
    refused(path, "unpacks to less than the", cache=cache)


def test_entries_that_lie_over_each_other(tmp_path, cache):
    """Two entries share the bytes of the second: stored, the first quotes all of it."""

    def local(name, method, content, size):
        head = struct.pack("<4sHHHHHIIIHH", b"PK\3\4", 20, 0, method, 0, 0, zlib.crc32(content), *size, len(name), 0)
        return head + name

    def central(name, method, content, size, place):
        sizes = (*size, len(name), 0, 0, 0, 0, 0, place)
        return (
            struct.pack("<4sHHHHHHIIIHHHHHII", b"PK\1\2", 20, 20, 0, method, 0, 0, zlib.crc32(content), *sizes) + name
        )

    squeezer = zlib.compressobj(wbits=-15)
    packed = squeezer.compress(XML) + squeezer.flush()
    inner = local(b"modelDescription.xml", 8, XML, (len(packed), len(XML))) + packed
    outer = local(b"resources/a", 0, inner, (len(inner), len(inner)))
    table = central(b"resources/a", 0, inner, (len(inner), len(inner)), 0)
    table += central(b"modelDescription.xml", 8, XML, (len(packed), len(XML)), len(outer))
    end = struct.pack("<4sHHHHIIH", b"PK\5\6", 0, 0, 2, 2, len(table), len(outer + inner), 0)
    path = tmp_path / "overlap.fmu"
    path.write_bytes(outer + inner + table + end)
    with zipfile.ZipFile(path) as archive:
        assert archive.namelist() == ["resources/a", DESCRIPTION]  # to zipfile of Python 3.11 it is in order
    refused(path, "overlap in the file ('resources/a' and 'modelDescription.xml')", cache=cache)


def test_too_many_entries(tmp_path, cache, monkeypatch):
    monkeypatch.setattr(_zip, "MOST", 20)
    path = archive_of(tmp_path / "many.fmu", [(f"resources/{i}", "") for i in range(30)])
    refused(path, "entries, which is implausible for an FMU", cache=cache)


@pytest.mark.parametrize("name", ["../../../evil", "/tmp/evil", "..", "-evil", "a\\b", "a&#10;b"])
def test_a_binary_whose_name_leads_elsewhere(tmp_path, cache, name):
    hostile = XML.replace(b'modelIdentifier="CruiseControl"', f'modelIdentifier="{name}"'.encode())
    assert hostile != XML
    path = archive_of(tmp_path / "name.fmu", [], description=hostile)
    refused(path, "has the modelIdentifier", "which could lead outside of the FMU", cache=cache)


LAUGHS = "".join(f'<!ENTITY a{i} "{f"&a{i - 1};" * 10 if i else "ha"}">' for i in range(10))
DOCTYPES = {
    "empty": "<!DOCTYPE fmiModelDescription>",
    "external": '<!DOCTYPE f [<!ENTITY a9 SYSTEM "file:///etc/passwd">]>',
    "external subset": '<!DOCTYPE f SYSTEM "http://localhost:9/evil.dtd">',
    "parameter entity": '<!DOCTYPE f [<!ENTITY % p SYSTEM "file:///etc/passwd"> %p;]>',
    "billion laughs": f"<!DOCTYPE f [{LAUGHS}]>",
}


def with_doctype(doctype, content=XML):
    head, tail = content.split(b"?>", 1)
    return head + b"?>" + doctype.encode() + tail.replace(b'description="', b'description="&a9;', 1)


@pytest.mark.parametrize("doctype", DOCTYPES.values(), ids=DOCTYPES)
@pytest.mark.parametrize("where", _zip.FMU_FILE.xml)
def test_document_types(tmp_path, cache, doctype, where):
    hostile = with_doctype(doctype)
    others = [] if where == DESCRIPTION else [(where, hostile)]
    path = archive_of(tmp_path / "xml.fmu", others, description=hostile if not others else XML)
    refused(path, f"The {where} of", "has a document type declaration (DOCTYPE)", cache=cache)


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be", "utf-7", "cp037", "utf-32"])
def test_encodings_that_hide_a_document_type(tmp_path, cache, encoding):
    text = with_doctype(DOCTYPES["external"]).decode().replace('encoding="UTF-8"', f'encoding="{encoding}"')
    assert encoding in text
    path = archive_of(tmp_path / "hidden.fmu", [], description=text.encode(encoding))
    refused(path, "The modelDescription.xml of", cache=cache)


def test_nesting_and_size(tmp_path, cache, monkeypatch):
    deep = b"<a>" * 100_000 + b"</a>" * 100_000
    path = archive_of(tmp_path / "deep.fmu", [], description=deep)
    refused(path, "more than 200 levels of nested elements", cache=cache)
    monkeypatch.setattr(_zip, "LARGEST_XML", 1000)
    refused(archive_of(tmp_path / "large.fmu", []), "modelDescription.xml of the FMU", "MB large", cache=cache)


@pytest.mark.slow
def test_xml_with_more_of_something_than_an_honest_file(tmp_path, cache, monkeypatch):
    """Such as fills the memory of those who read it, or takes them hours."""
    monkeypatch.setattr(_zip, "MOST_ELEMENTS", 20_000)
    many = {
        "has a tag or a comment of more than 10 MB": b'<a b="' + b"c" * 12_000_000 + b'"/>',
        "has a tag or a comment of more than 10 M": b"<!--" + b"c" * 12_000_000 + b"-->",
        "has more than 20,000 elements": b"<a/>" * 20_000,
        "has an element with more than 1000 attributes": b"<a " + b" ".join(b'a%d=""' % i for i in range(1001)) + b"/>",
        "an element with more than 1000 attributes": b"<a "
        + b" ".join(b'xmlns:a%d="b"' % i for i in range(1001))
        + b"/>",
    }
    for i, (sentence, filling) in enumerate(many.items()):
        hostile = XML.replace(b"<ModelVariables>", filling + b"<ModelVariables>", 1)
        refused(archive_of(tmp_path / f"{i}.fmu", [], description=hostile), sentence, "nothing was", cache=cache)
    text = XML.replace(b"<ModelVariables>", b"<ModelVariables>" + b"c" * 12_000_000, 1)
    with pytest.raises(FMUError) as caught:
        FMU(archive_of(tmp_path / "text.fmu", [], description=text))
    assert "\n" not in str(caught.value)


def test_a_document_type_may_stand_where_no_program_reads(tmp_path):
    page = "<!DOCTYPE html><html/>"
    comment = XML.replace(b"?>", b"?><!-- <!DOCTYPE f> -->", 1)
    path = archive_of(tmp_path / "page.fmu", [("documentation/index.xml", page)], description=comment)
    FMU(path).instantiate(Fraction(1, 50), "car").close()


def test_what_a_killed_process_has_left_is_cleared_away(cache):
    archive = _fmi_archive.open_archive(SHIPPED)
    left = cache / "fmus" / f".{archive.digest[:16]}-killed" / "content"
    left.mkdir(parents=True)
    folder = _fmi_archive.extract(archive, DESCRIPTION)
    assert {p.name for p in folder.parent.iterdir()} == {archive.digest, f"{archive.digest}.lock"}


@settings(max_examples=75, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.text("ab./\\:\0~\n", min_size=1, max_size=8), max_size=4))
def test_whatever_the_names_all_lands_in_the_folder(tmp_path_factory, names):
    folder = tmp_path_factory.mktemp("names")
    path = folder / "x.zip"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("warnings.warn", lambda *_, **__: None)
        archive_of(path, [(named(name), "content") for name in names], shipped=False)
    try:
        listed = _zip.check(path, _zip.FMU_FILE)
    except FMUError:
        assert names  # an empty archive is in order
        return
    _zip.unpack(path, _zip.FMU_FILE, folder / "content")
    assert {p.name for p in folder.iterdir()} == {"x.zip", "content"}
    found = [p for p in (folder / "content").rglob("*") if p.is_file()]
    assert len(found) == len({n for n in listed if not n.endswith("/")})
    assert all(p.read_text() == "content" and not p.is_symlink() for p in found)


@settings(max_examples=75, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_any_damage_ends_in_a_sentence(tmp_path_factory, data):
    folder = tmp_path_factory.mktemp("damage")
    small = archive_of(folder / "small.fmu", [(DESCRIPTION, XML), ("resources/a", b"abc")], shipped=False)
    content = bytearray(small.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        place = data.draw(st.integers(-400, len(content) - 1))
        content[place] = data.draw(st.integers(0, 255))
    path = Path(folder / "damaged.fmu")
    path.write_bytes(content[: data.draw(st.integers(len(content) // 2, len(content) * 3))])
    with suppress(FMUError):  # a sentence, or what the damage left as it was; nothing else is raised
        assert describe(path).kinds


@settings(max_examples=75, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_any_description_ends_in_a_sentence(tmp_path_factory, data):
    """Values of attributes are put in each other's place, and what is not validated is read all the same."""
    pieces = re.findall(r'"[^"]*"|[^"]+', XML.decode())
    places = [i for i, piece in enumerate(pieces) if piece.startswith('"')]
    strange = ['"NaN"', '""', '"1e999"', '"-1"', '"99999999999999999999"', '"true"', '"../x"', '"1 2 3"']
    for _ in range(data.draw(st.integers(1, 3))):
        pieces[data.draw(st.sampled_from(places))] = data.draw(
            st.sampled_from([*strange, *(pieces[i] for i in places)])
        )
    path = tmp_path_factory.mktemp("strange") / "strange.fmu"
    archive_of(path, [(DESCRIPTION, "".join(pieces))], shipped=False)
    with suppress(BayesFTCError):
        FMU(path, validate=False)
