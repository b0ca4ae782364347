"""Binaries for all platforms: where they lie, what they export, the same bytes each time; and the bits where they can be run."""

import os
import re
import shutil
import struct
import subprocess
import zipfile
from dataclasses import replace
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy import supported_platforms
from fmpy.validation import validate_fmu

from bayesftc import controllers, cosim, fmus
from bayesftc.cosim import ops
from bayesftc.cosim.export.exporting import export_fmu
from bayesftc.cosim.export.platforms import platforms_of
from bayesftc.fmus import _binaries, _compiler
from bayesftc.fmus._platforms import PLATFORMS, host
from bayesftc.fmus.build import build_fmu
from bayesftc.fmus.plants import PLANTS

BUILT_WITH = "0.17.1"
NAMED = {platform.name: platform for platform in PLATFORMS}
needs_zig = pytest.mark.skipif(find_spec("ziglang") is None, reason="ziglang is not installed")


def names(given):
    return [platform.name for platform in platforms_of(given)]


def test_platforms_are_named_as_people_and_as_fmi_name_them():
    assert platforms_of(None) is None
    assert names("linux-aarch64") == ["linux-aarch64"]
    assert names(["aarch64-darwin", "linux-x86_64", "x86_64-linux"]) == ["linux-x86_64", "macos-aarch64"]
    assert names(["linux64", "win64", "darwin64"]) == ["linux-x86_64", "windows-x86_64", "macos-x86_64"]
    assert names("all") == names(["linux-x86_64", "all"]) == list(NAMED)
    assert host() in PLATFORMS


WRONG = {
    "linux-x86-64": r"platform 'linux-x86-64' are not supported; did you mean .*'linux-x86_64'",
    "Windows-x86_64": r"did you mean 'windows-x86_64'\?",
    "macos-arm64": r"did you mean .*'macos-aarch64'",
    "amiga": "known names: all, linux-aarch64, linux-x86_64, macos-aarch64, macos-x86_64, windows-x86_64",
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_name_is_answered_with_the_near_ones(tmp_path, name):
    with pytest.raises(cosim.UnknownNameError, match=WRONG[name]):
        export_fmu(cosim.Gain(2.0), tmp_path / "gain.fmu", dt=0.1, platforms=[name])
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("given", "sentence"), [([], "is empty"), ([64], "contains 64"), (7, "contains 7")])
def test_what_names_no_platform_is_said(given, sentence):
    with pytest.raises(cosim.ModelError, match=sentence):
        platforms_of(given)


def test_without_ziglang_a_sentence_says_what_to_install(tmp_path, monkeypatch):
    kept = tmp_path / "gain.fmu"
    kept.write_bytes(b"what was there")
    monkeypatch.setattr(
        _compiler.importlib.util, "find_spec", lambda name, package=None: None if name == "ziglang" else find_spec(name)
    )
    with pytest.raises(cosim.FMUError, match=r"Binaries for linux-aarch64 .*with: pip install 'bayesftc\[export\]'\."):
        export_fmu(cosim.Gain(2.0), kept, dt=0.1, platforms="linux-aarch64")
    assert [path.read_bytes() for path in tmp_path.iterdir()] == [b"what was there"]


def thin(processor):
    """Return the beginning of a Mach-O file for one processor."""
    return struct.pack("<3I", 0xFEEDFACF, processor, 3) + b"of the library"


FAKE = {
    "linux-x86_64": b"linux x86",
    "linux-aarch64": b"linux arm",
    "windows-x86_64": b"windows",
    "macos-x86_64": thin(0x01000007),
    "macos-aarch64": thin(0x0100000C),
}


def placed(fmi, *of):
    built = {NAMED[name]: FAKE[name] for name in of}
    return {folder: content for (folder, _), content in _binaries._placed(built, fmi).items()}


def test_each_library_lies_where_importers_of_its_platform_look():
    """By FMI 2.0.4, 2.3, and FMI 3.0; fmpy, and the fmi4c of OMSimulator, look on ARM into the folder of x86."""
    assert placed("3.0", *FAKE) == {NAMED[name].fmi3: content for name, content in FAKE.items()}
    both = placed("2.0", *FAKE)
    assert slices(both.pop("darwin64")) == [FAKE["macos-x86_64"], FAKE["macos-aarch64"]]
    assert both == {
        "linux64": FAKE["linux-x86_64"],
        "aarch64-linux": FAKE["linux-aarch64"],
        "win64": FAKE["windows-x86_64"],
        "aarch64-darwin": FAKE["macos-aarch64"],
    }
    for name, folders in {
        "linux-aarch64": ("aarch64-linux", "linux64"),
        "macos-aarch64": ("aarch64-darwin", "darwin64"),
    }.items():
        assert placed("2.0", name) == dict.fromkeys(folders, FAKE[name])


def test_on_arm_an_fmu_of_fmi_2_is_taken_from_the_folder_for_arm(tmp_path, monkeypatch):
    """Here with a binary of this machine in it, and in that for x86 with one that does not load."""
    path = tmp_path / "car.fmu"
    with zipfile.ZipFile(fmus.path("CruiseControl")) as shipped, zipfile.ZipFile(path, "w") as archive:
        here = shipped.read("binaries/linux64/CruiseControl.so")
        for name in shipped.namelist():
            if name.startswith("binaries/"):
                archive.writestr(name, here if "aarch64-linux" in name else "for another processor")
            else:
                archive.writestr(name, shipped.read(name))
    for name, value in {"architecture": "aarch64", "platform_tuple": "aarch64-linux", "platform": "linux64"}.items():
        monkeypatch.setattr(fmpy, name, value)
    diagram = cosim.Diagram("1/50")
    diagram.add(cosim.FMU(path, parameters={"v0": 5.0}), "car")
    assert 4.0 < diagram.simulate(0.1)["car.v"][-1] < 5.0


def slices(universal):
    """Return the libraries within a Mach-O file for several processors."""
    magic, count = struct.unpack_from(">2I", universal)
    assert magic == 0xCAFEBABE
    found = []
    for i in range(count):
        *processor, begin, size, bits = struct.unpack_from(">5I", universal, 8 + 20 * i)
        assert begin % (1 << bits) == 0
        found.append(universal[begin : begin + size])
        assert struct.unpack_from("<2I", found[-1], 4) == tuple(processor)
    return found


# Readers of the three formats: what a library is for, what it exports and what it needs.


def text(data, at):
    return data[at : data.index(b"\0", at)].decode()


def elf(data):
    assert data[:6] == b"\x7fELF\x02\x01"  # 64 bits, little-endian
    (machine,) = struct.unpack_from("<H", data, 18)
    table, size, count = struct.unpack_from("<Q", data, 40)[0], *struct.unpack_from("<2H", data, 58)
    sections = [struct.unpack_from("<2I4Q2I2Q", data, table + size * i) for i in range(count)]
    symbols = next(section for section in sections if section[1] == 11)  # SHT_DYNSYM
    strings = sections[symbols[6]][4]
    exported = set()
    for at in range(symbols[4], symbols[4] + symbols[5], 24):
        name, _, _, section = struct.unpack_from("<IBBH", data, at)
        if section:
            exported.add(text(data, strings + name))
    whole = data[strings : strings + sections[symbols[6]][5]]
    return {
        "machine": {62: "x86_64", 183: "aarch64"}[machine],
        "exported": exported,
        "glibc": max(tuple(map(int, version.split(b"."))) for version in re.findall(rb"GLIBC_([\d.]+)", whole)),
    }


def pe(data):
    (at,) = struct.unpack_from("<I", data, 60)
    assert data[at : at + 4] == b"PE\0\0"
    machine, count, stamp, _, _, optional, _ = struct.unpack_from("<2H3I2H", data, at + 4)
    sections = [struct.unpack_from("<4I", data, at + 24 + optional + 40 * i + 8) for i in range(count)]

    def place(address):
        return next(raw + address - begin for size, begin, _, raw in sections if begin <= address < begin + size)

    exports, _, imports, _ = struct.unpack_from("<4I", data, at + 24 + 112)
    (named,), (list_at,) = (struct.unpack_from("<I", data, place(exports) + offset) for offset in (24, 32))
    entries = struct.unpack_from(f"<{named}I", data, place(list_at))
    needed, row = set(), place(imports)
    while any(entry := struct.unpack_from("<5I", data, row)):
        needed.add(text(data, place(entry[3])).lower())
        row += 20
    return {
        "machine": {0x8664: "x86_64"}[machine],
        "exported": {text(data, place(entry)) for entry in entries},
        "needed": needed,
        "stamp": stamp,
    }


def mach_o(data):
    magic, processor, _, _, count, _, flags, _ = struct.unpack_from("<8I", data)
    assert magic == 0xFEEDFACF
    found, at = (
        {"machine": {0x01000007: "x86_64", 0x0100000C: "aarch64"}[processor], "needed": set(), "signed": False},
        32,
    )
    for _ in range(count):
        command, size = struct.unpack_from("<2I", data, at)
        if command == 0x2:  # LC_SYMTAB
            symbols, number, strings = struct.unpack_from("<3I", data, at + 8)
            entries = [struct.unpack_from("<IBBHQ", data, symbols + 16 * i) for i in range(number)]
            external = [entry for entry in entries if entry[1] & 0x01 and entry[2]]
            found["exported"] = {text(data, strings + entry[0]).removeprefix("_") for entry in external}
        elif command in (0xC, 0xD):  # LC_LOAD_DYLIB, LC_ID_DYLIB
            name = text(data, at + struct.unpack_from("<I", data, at + 8)[0])
            if command == 0xC:
                found["needed"].add(name)
            else:
                found["name"] = name
        elif command == 0x32:  # LC_BUILD_VERSION
            system, oldest = struct.unpack_from("<2I", data, at + 8)
            found["oldest"] = (system, oldest >> 16)
        elif command == 0x1D:
            found["signed"] = True
        at += size
    assert flags & 0x85 == 0x85  # nothing undefined, for the dynamic linker, names in two levels
    return found


def standard(archive, fmi):
    """Return the functions of the standard, as its header lists them."""
    header = archive.read(f"sources/fmi{fmi[0]}Functions.h").decode()
    found = set(re.findall(rf"#define (fmi{fmi[0]}\w+) +fmi{fmi[0]}FullName", header))
    assert len(found) > 40
    return found


def brain(precision):
    model = controllers.LinearModel(
        [[0.99]], [[0.002]], [[1.0], [1.0]], process_covariance=[[1e-3]], sensor_covariance=[1.0, 1.0], dt=0.02
    )
    return controllers.BayesianController(model, precision=precision, control_covariance=1e4)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Export the controller of two sensors for all platforms."""
    made = tmp_path_factory.mktemp("all")
    for fmi in ("2.0", "3.0"):
        export_fmu(brain(controllers.GammaPrecision()), made / f"gamma{fmi[0]}.fmu", fmi=fmi, platforms="all")
    return made


FOLDERS = {
    "2.0": {"linux64", "aarch64-linux", "win64", "darwin64", "aarch64-darwin"},
    "3.0": {"x86_64-linux", "aarch64-linux", "x86_64-windows", "x86_64-darwin", "aarch64-darwin"},
}


def check_binaries(path, fmi):
    """Insist on a library for each platform: where it lies, its format, what it exports and needs."""
    assert validate_fmu(str(path)) == []
    assert set(supported_platforms(path)) == {"c-code", "darwin64", "linux64", "win64"}
    with zipfile.ZipFile(path) as archive:
        binaries = [name for name in archive.namelist() if name.startswith("binaries/")]
        assert {name.split("/")[1] for name in binaries} == FOLDERS[fmi]
        assert len(binaries) == 5  # and nothing else: no import libraries, no symbol files
        functions = standard(archive, fmi)
        for name in binaries:
            data, machine = archive.read(name), "aarch64" if "aarch64" in name else "x86_64"
            assert str(Path.home()).encode() not in data
            if name.endswith(".so"):
                library = elf(data)
                assert library["exported"] == functions
                assert library["glibc"] <= (2, 17)
            elif name.endswith(".dll"):
                library = pe(data)
                assert library["exported"] == functions
                assert all(dll == "kernel32.dll" or dll.startswith("api-ms-win-crt-") for dll in library["needed"])
            else:
                libraries = [mach_o(part) for part in (slices(data) if "darwin64" in name else [data])]
                for library in libraries:
                    assert (
                        library["exported"] - {"__dso_handle", "_mh_dylib_header"} == functions
                    )  # those two are the linker's
                    assert library["needed"] == {"/usr/lib/libSystem.B.dylib"}
                    assert library["name"] == Path(name).name  # no path of the machine that built it
                    assert library["oldest"] == (1, 11)  # macOS 11
                assert [part["machine"] for part in libraries][-1:] == ["aarch64" if "darwin64" in name else machine]
                assert libraries[-1]["signed"] == (
                    libraries[-1]["machine"] == "aarch64"
                )  # macOS runs no unsigned code on ARM
                continue
            assert library["machine"] == machine


@pytest.mark.slow
@needs_zig
@pytest.mark.parametrize("fmi", FOLDERS)
def test_formats_symbols_and_sizes(folder, fmi):
    path = folder / f"gamma{fmi[0]}.fmu"
    assert path.stat().st_size < 200_000
    check_binaries(path, fmi)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("fmi", FOLDERS)
@pytest.mark.parametrize("plant", fmus.names())
def test_shipped_fmus_have_binaries_for_all_platforms(plant, fmi):
    check_binaries(fmus.path(plant, fmi=fmi), fmi)


@pytest.mark.slow
@needs_zig
@pytest.mark.parametrize("fmi", FOLDERS)
@pytest.mark.parametrize("plant", PLANTS, ids=lambda plant: plant.name)
def test_shipped_fmus_are_what_the_sources_give(plant, fmi, tmp_path):
    """The same bytes, with the version of ziglang that has built them."""
    if version("ziglang") != BUILT_WITH:
        pytest.skip(f"shipped FMUs are built with ziglang {BUILT_WITH}")
    built = build_fmu(plant, tmp_path, fmi=fmi, platforms=PLATFORMS)
    assert built.read_bytes() == fmus.path(plant.name, fmi=fmi).read_bytes()


@pytest.mark.slow
@needs_zig
def test_the_same_bytes_again_in_another_folder(folder, tmp_path, monkeypatch):
    """Nor on another day: no file in it has a time, and where Windows has one there is a hash of the contents."""
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    for fmi in ("2.0", "3.0"):
        name = f"gamma{fmi[0]}.fmu"
        export_fmu(brain(controllers.GammaPrecision()), name, fmi=fmi, platforms=list(NAMED)[::-1])
        assert (folder / name).read_bytes() == Path(name).read_bytes()
        with zipfile.ZipFile(name) as archive:
            assert {entry.date_time for entry in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}
    assert [path.name for path in sorted(tmp_path.iterdir())] == ["gamma2.fmu", "gamma3.fmu"]


def run(command):
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def emulator(name, folder):
    """Return the command that runs a platform's programs here, with its environment; skip where there is none."""
    if name == host().name or (name == MUSL.name and host().name == "linux-x86_64"):
        return [], {}
    if name == "linux-aarch64":
        libraries = Path("/usr/aarch64-linux-gnu")
        if not shutil.which("qemu-aarch64") or not (libraries / "lib").is_dir():
            pytest.skip("no emulator of aarch64; on Debian: apt install qemu-user libc6-arm64-cross")
        return ["qemu-aarch64", "-L", str(libraries)], {}
    found = [wine for wine in ("wine64", "/usr/lib/wine/wine64") if shutil.which(wine)]
    if name != "windows-x86_64" or not found:
        pytest.skip("no emulator of Windows; on Debian: apt install wine64")
    return [found[0]], {"WINEPREFIX": str(folder / "wine"), "WINEDEBUG": "-all", "HOME": str(folder)}


MUSL = replace(NAMED["linux-x86_64"], name="linux-musl", zig_target="x86_64-linux-musl")
"""Linux with another C library; a program for it contains the library and the FMU."""

ELSEWHERE = {platform.name: platform for platform in (NAMED["linux-aarch64"], NAMED["windows-x86_64"], MUSL)}
STEPS = 1000
DRIVEN = {
    "gamma": controllers.GammaPrecision,  # only the square root
    "switching": controllers.SwitchingPrecision,  # exp and log
}


def recorded(block):
    """Return inputs of a loop with a sensor that freezes and samples that are missing, and what plain Python makes of them."""
    rng, plain = np.random.default_rng(5), block.online(compiled=False)
    speed, inputs, outputs = 15.0, [], []
    for k in range(STEPS):
        goal = 20.0 + 10.0 * np.sin(0.02 * k)
        y = speed + rng.normal(size=2)
        y[0] = inputs[299][0] if 300 <= k < 700 else y[0]
        y[rng.uniform(size=2) < 0.02] = np.nan
        out = plain(y=y, goal=[goal])
        inputs.append([*y, goal])
        outputs.append(np.concatenate([np.ravel(value) for value in dict(out).values()]))
        speed = 0.99 * speed + 0.002 * float(np.ravel(out["u"])[0]) + 0.03 * rng.normal()
    return np.array(inputs), np.array(outputs)


def of_settings(u, angles, y):
    y[0] = ops.exp(angles[0]) * u[0]
    y[1] = ops.exp(angles[1]) * u[0]
    y[2] = ops.sin(angles[2]) * u[0]
    y[3] = ops.cos(angles[3]) * u[0]


class OfSettings(cosim.Block):
    """Functions of numbers that never change."""

    inputs = (cosim.Port("u", default=1.0),)
    outputs = (cosim.Port("y", (4,)),)

    def define(self, step):
        return cosim.Definition(of_settings, parameters={"angles": [-5.21, 4.22, 0.83, -4.82]})


@needs_zig
def test_what_the_compiler_computes_has_the_same_bits(tmp_path):
    """Clang computes functions of constants by itself; of those of C it has other last digits than libraries."""
    diagram = cosim.Diagram(0.1)
    diagram.add(OfSettings(), "it")
    path = export_fmu(diagram, tmp_path / "it.fmu", platforms=host().name)
    found = cosim.verify_fmu(path, diagram, duration=0.2)
    assert found.agrees(), found


def driven(path, platform, inputs, outputs, folder):
    """Return what an FMU of FMI 2 makes of inputs, a row for each step of 0.02 s, driven by a program of C on its platform."""
    folder.mkdir()
    command, environment = emulator(platform.name, folder)
    with zipfile.ZipFile(path) as archive:
        archive.extractall(folder)
    program = folder / ("driver.exe" if platform.suffix == ".dll" else "driver")
    if platform is MUSL:
        linked = ["-static", "-DLINKED", "-O2", "-ffp-contract=off", *map(str, (folder / "sources").glob("*.c"))]
    else:
        linked = ["-O1", *["-ldl"] * (platform.system == "Linux")]
    driver = [str(Path(__file__).with_name("driver.c")), f"-I{folder / 'sources'}", "-o", str(program)]
    run([*_compiler.cross_command(platform), "-std=c99", *driver, *linked])
    guid = re.search(r'guid="([^"]+)"', (folder / "modelDescription.xml").read_text())[1]
    library = folder / "binaries" / platform.fmi2 / f"{path.stem}{platform.suffix}"
    done = subprocess.run(
        [*command, str(program), str(library), guid, "0.02", str(inputs.shape[1]), str(outputs)],
        input=inputs.tobytes(), capture_output=True, env=os.environ | environment, timeout=600, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr.decode(errors="replace")
    return np.frombuffer(done.stdout).reshape(len(inputs), outputs)


@pytest.mark.slow
@needs_zig
@pytest.mark.parametrize("plant", PLANTS, ids=lambda plant: plant.name)
@pytest.mark.parametrize("name", ELSEWHERE)
def test_shipped_fmus_have_the_same_bits_where_they_run(tmp_path, name, plant, same_bits):
    """Beside the binary of Linux on x86-64, which other tests compare with Python."""
    causality = [variable.causality for variable in plant.variables]
    inputs = np.random.default_rng(1).uniform(0.5, 1.5, size=(50, causality.count("input")))
    path, outputs = fmus.path(plant.name), causality.count("output")
    here = driven(path, NAMED["linux-x86_64"], inputs, outputs, tmp_path / "here")
    there = driven(path, ELSEWHERE[name], inputs, outputs, tmp_path / "there")
    assert np.ptp(here, axis=0).max() > 0.0
    same_bits(there, here, name)


@pytest.mark.slow
@needs_zig
@pytest.mark.parametrize("which", DRIVEN)
@pytest.mark.parametrize("name", ["linux-x86_64", *ELSEWHERE])
def test_the_bits_of_python_where_it_runs(tmp_path, name, which, same_bits):
    """A program of C runs the FMU, by an emulator where need be."""
    block, platform = brain(DRIVEN[which]()), (NAMED | ELSEWHERE)[name]
    inputs, outputs = recorded(block)
    path = export_fmu(block, tmp_path / "driven.fmu", platforms=None if platform is MUSL else name)
    got = driven(path, platform, inputs, outputs.shape[1], tmp_path / "fmu")
    assert np.ptp(outputs[:, 0]) > 100.0
    same_bits(got, outputs, name)
