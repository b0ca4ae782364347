"""Building that is stopped, cannot begin or fails on the way."""

import os
import signal
import subprocess
import sys
import time
from importlib.util import find_spec

import pytest

from bayesftc import cosim
from bayesftc.fmus import _compiler
from bayesftc.fmus._processes import Processes

SLOW = """#!/bin/sh
echo $$ > "$STARTED"
exec sleep 60
"""


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="signals and a shell are of POSIX")
def test_ctrl_c_for_this_process_alone_ends_the_compiler_too(tmp_path):
    compiler, started, folder = tmp_path / "slow-cc", tmp_path / "started", tmp_path / "here"
    compiler.write_text(SLOW)
    compiler.chmod(0o755)
    folder.mkdir()
    (tmp_path / "temporary").mkdir()
    known = {"CC": str(compiler), "STARTED": str(started), "TMPDIR": str(tmp_path / "temporary")}
    command = [sys.executable, "-m", "bayesftc", "export", "cruise_control", "-b", "controller"]
    export = subprocess.Popen(
        command, cwd=folder, env=os.environ | known, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    try:
        until = time.monotonic() + 60.0
        while not (started.exists() and started.read_text().strip()) and time.monotonic() < until:
            time.sleep(0.05)
        os.kill(export.pid, signal.SIGINT)
        _, said = export.communicate(timeout=30.0)
    finally:
        export.kill()
    assert export.returncode == 130, said
    assert "Stopped by Ctrl-C" in said
    assert not [*folder.iterdir(), *(tmp_path / "temporary").iterdir()]
    with pytest.raises(ProcessLookupError):
        os.kill(int(started.read_text()), 0)


def test_what_is_started_after_the_end_is_ended_at_once(tmp_path):
    processes = Processes()
    processes.end()
    assert processes.run([sys.executable, "-c", "import time; time.sleep(60)"], tmp_path, 30.0).returncode != 0


def test_a_program_that_takes_too_long_is_ended(tmp_path):
    with pytest.raises(subprocess.TimeoutExpired):
        Processes().run([sys.executable, "-c", "import time; time.sleep(60)"], tmp_path, 0.2)


def test_ziglang_without_a_place_to_keep_things_is_a_sentence(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("ZIG_GLOBAL_CACHE_DIR", str(tmp_path / "file" / "zig"))
    monkeypatch.setattr(
        _compiler.importlib.util, "find_spec", lambda name: object() if name == "ziglang" else find_spec(name)
    )
    with pytest.raises(
        cosim.FMUError, match=r"The cache of .* is .*file.zig, where nothing can be written .*ZIG_GLOBAL_CACHE_DIR"
    ):
        cosim.export_fmu(cosim.Gain(2.0), tmp_path / "gain.fmu", dt=0.1, platforms="linux-aarch64")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
