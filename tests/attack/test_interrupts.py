"""Ctrl-C at any moment of a run or a campaign: one sentence, exit code 130, and nothing left behind."""

import os
import re
import signal
import subprocess
import sys
import time

import pytest
from documents import LOOP
from harness import children, is_half
from test_files import CAMPAIGN

from bayesftc._interrupt import EXIT_CODE, SENTENCE

pytestmark = [pytest.mark.skipif(sys.platform == "win32", reason="signals"), pytest.mark.slow]

TOLD = "from bayesftc.__main__ import main\nprint(flush=True)\nmain()"
LONG = LOOP.replace("duration = 0.2", "duration = 20.0")
COMMANDS = {
    "run": ("run", "loop.toml", "--out", "out", "--quiet"),
    "campaign": ("campaign", "case.toml", "--out", "out", "--quiet", "--executor", "threads"),
    "campaign of processes": (
        "campaign",
        "case.toml",
        "--out",
        "out",
        "--quiet",
        "--executor",
        "processes",
        "--jobs",
        "2",
    ),
}


def interrupted(folder, command, seconds):
    """Stop a command some time after it has begun; return what is wrong with how it ends."""
    folder.mkdir()
    (folder / "tmp").mkdir()
    (folder / "loop.toml").write_text(LONG)
    (folder / "case.toml").write_text(
        CAMPAIGN.replace("duration = 0.1", "duration = 5.0").replace("seeds = 2", "seeds = 200")
    )
    process = subprocess.Popen(
        [sys.executable, "-c", TOLD, *command],
        cwd=folder,
        env={**os.environ, "TMPDIR": str(folder / "tmp")},
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        # A test runner in the background hands down an ignored SIGINT; the process is to have the usual one.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    try:
        process.stdout.readline()
        time.sleep(seconds)
        workers = [pid for pid, _ in children(process.pid)]
        process.send_signal(signal.SIGINT)
        out, errors = process.communicate(timeout=60)
    except subprocess.TimeoutExpired:
        return "it did not end"
    finally:
        process.kill()
        process.wait()
    if process.returncode == 0:  # it was faster
        return ""
    if process.returncode == -signal.SIGINT and errors.count("File ") == errors.count('File "<string>"') == 1:
        return ""  # on a busy machine: between the print and the command, which had not begun
    kept = re.fullmatch(
        r"Stopped by Ctrl-C\. \d+ of \d+ runs are kept in out\. To go on: bayesftc campaign .* -o out\n", errors
    )
    said = errors == SENTENCE + "\n" or (command[0] == "campaign" and kept is not None)
    if (process.returncode, out, said) != (EXIT_CODE, "", True):
        return f"exit code {process.returncode}: {out}{errors[-800:]}"
    left = [str(path) for path in folder.rglob("*") if is_half(path)] + [
        str(path) for path in (folder / "tmp").iterdir()
    ]
    if command[0] == "run":
        left += [name for name in os.listdir(folder) if name == "out"]
    end = time.monotonic() + 10
    while (alive := [pid for pid in workers if os.path.exists(f"/proc/{pid}/cwd")]) and time.monotonic() < end:
        time.sleep(0.05)
    return f"it left {left + alive}" if left or alive else ""


@pytest.mark.sampled(1)
@pytest.mark.parametrize("count", [1, pytest.param(25, marks=pytest.mark.slow)])
@pytest.mark.parametrize("command", list(COMMANDS))
def test_ctrl_c_at_random_moments(tmp_path, chance, command, count):
    pytest.importorskip("zarr", reason="stores need the extra 'campaign'")
    found = []
    for i in range(count):
        seconds = float(chance.uniform(0.05, 6.0))
        wrong = interrupted(tmp_path / f"{i}", COMMANDS[command], seconds)
        if wrong:
            found.append(f"after {seconds:.2f} s: {wrong}")
    assert not found, "\n".join(found)
