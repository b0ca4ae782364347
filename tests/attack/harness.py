"""What comes of a command line: a sentence and an exit code, or done, and nothing else.

Many cases are called in one process, through the entry point of ``bayesftc``; another process watches how long each takes, how
much memory, and what it leaves behind.
"""

from __future__ import annotations

import json
import os
import re
import resource
import select
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

GIGABYTE = 2**30
MOST_MEMORY = 2 * GIGABYTE
ADDRESSES = 12 * GIGABYTE
"""Beyond this a process gets no memory, so that nothing that is wrong with a case harms the machine."""
SECONDS = 120.0
"""That a case may take: all end in a few, alone on a machine."""
MARK = "ATTACK_CASE"
"""Variable of the environment that says for which case a process was started."""
SENTENCES = {1, *range(3, 19), 20}
"""Exit codes of `BayesFTCError`."""
FOREIGN = re.compile(
    r"Traceback|numpy|np\.|ufunc|dtype|broadcast|LAPACK|SVD|xmlns|\bat 0x|array\(|<class|pydantic|Errno|nan\b.*\bnan\b.*\bnan\b"
)
"""What stands in errors of other libraries, and in none of ours."""


@dataclass(frozen=True)
class Case:
    """A command line with the files that it works on.

    Attributes
    ----------
    arguments : sequence of str
        Of ``bayesftc``.
    files : mapping of str to bytes or str
        What lies in its folder.
    environment : mapping of str to str
        What is added to the environment.
    leaves : sequence of str
        What it may leave in its folder.
    """

    arguments: tuple[str, ...]
    files: Mapping[str, bytes | str] = field(default_factory=dict)
    environment: Mapping[str, str] = field(default_factory=dict)
    leaves: tuple[str, ...] = ()


@dataclass(frozen=True)
class Outcome:
    """What came of a case: its exit code and texts, or in ``trouble`` what went wrong with its process."""

    code: int | None = None
    out: str = ""
    err: str = ""
    memory: int = 0
    seconds: float = 0.0
    left: tuple[str, ...] = ()
    trouble: str = ""

    @property
    def wrong(self) -> str:
        """What is wrong with it; empty if nothing is."""
        if self.trouble:
            return self.trouble
        if self.memory > MOST_MEMORY:
            return f"it took {self.memory / GIGABYTE:.1f} GB"
        if self.left:
            return f"it left {', '.join(self.left)}"
        if self.code == 0:
            return "a traceback" if "Traceback" in self.err else ""
        if self.code == 2 and "Usage:" in self.err:
            return ""
        if self.code not in SENTENCES:
            return f"exit code {self.code}"
        last = [line for line in self.err.splitlines() if line.startswith("Error: ")]
        if len(last) != 1 or self.err.rstrip()[-1:] not in {".", "?"}:
            return "no sentence"
        foreign = FOREIGN.search(last[0])
        return f"words of another library: {foreign[0]!r}" if foreign else ""


class CommandLine:
    """A process in which cases are called one after the other; a new one where one has ended it.

    Parameters
    ----------
    folder : path
        Where the cases have their folders.
    temporary : path
        The folder of temporary files (TMPDIR), which each case has to leave empty.
    """

    def __init__(self, folder: Path, temporary: Path):
        self._folder, self._temporary = folder, temporary
        self._process: subprocess.Popen[bytes] | None = None
        self._count = 0

    def __enter__(self) -> CommandLine:
        return self

    def __exit__(self, *_: object) -> None:
        self._end()

    def run(self, case: Case, seconds: float = SECONDS) -> Outcome:
        """Return what comes of a case."""
        self._count += 1
        folder = self._folder / str(self._count)
        folder.mkdir()
        for name, content in case.files.items():
            (folder / name).write_bytes(content.encode() if isinstance(content, str) else content)
        before = set(os.listdir(folder))
        mark = f"{folder}"
        said = self._call(
            {"arguments": case.arguments, "folder": str(folder), "environment": {**case.environment, MARK: mark}},
            seconds,
        )
        if isinstance(said, str):
            for path in self._temporary.iterdir():  # what a process leaves that was killed is no fault of its
                shutil.rmtree(path, ignore_errors=True) if path.is_dir() else path.unlink()
            outcome = Outcome(trouble=said)
        else:
            left = [name for name in os.listdir(folder) if name not in before and name not in case.leaves]
            left += [f"the temporary {name}" for name in os.listdir(self._temporary)]
            left += [f"the half file {path.name}" for path in folder.rglob("*") if is_half(path)]
            left += [f"the process {name}" for name in self._processes(mark)]
            outcome = Outcome(**said, left=tuple(left))
        for pid, _ in marked(mark):
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        if outcome.left:
            self._end()
        shutil.rmtree(folder, ignore_errors=True)
        return outcome

    def failures(self, cases: Iterable[tuple[str, Case]]) -> list[str]:
        """Run cases with what they are called; return what is wrong with those that do not end well."""
        found = []
        for name, case in cases:
            outcome = self.run(case)
            if outcome.wrong:
                found.append(f"{name}: {outcome.wrong}\n    {' '.join(case.arguments)}\n    {outcome.err[-1500:]}")
        return found

    def _call(self, what: object, seconds: float) -> dict[str, object] | str:
        if self._process is None:
            self._process = subprocess.Popen(
                [sys.executable, __file__],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                start_new_session=True,
            )
        process = self._process
        try:
            process.stdin.write(json.dumps(what).encode() + b"\n")
            process.stdin.flush()
        except OSError:
            pass
        ready, _, _ = select.select([process.stdout], [], [], seconds)
        answer = process.stdout.readline() if ready else b""
        if answer:
            return json.loads(answer)
        self._end()
        if not ready:
            return f"it took more than {seconds:g} s"
        return f"its process ended ({process.returncode})"

    def _processes(self, mark: str) -> list[str]:
        """Return the processes that a case has left running: those that the process has started, and those they have."""
        found = dict(children(self._process.pid)) | dict(marked(mark))
        return [f"{name[:80]} ({pid})" for pid, name in found.items() if "resource_tracker" not in name]

    def _end(self) -> None:
        process, self._process = self._process, None
        if process is None:
            return
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.stdin.close()
        process.stdout.close()
        process.wait()


def is_half(path: Path) -> bool:
    """Return whether a path is that of something that is being written."""
    from bayesftc.cosim.campaign.store.durable import TEMPORARY

    return path.name.startswith(".writing-") or path.name.endswith(TEMPORARY)


def children(pid: int) -> list[tuple[int, str]]:
    """Return the processes that a process has started and that run, and what they are called."""
    found = []
    for task in Path(f"/proc/{pid}/task").glob("*/children"):
        for child in task.read_text().split():
            try:
                state = Path(f"/proc/{child}/stat").read_text().rpartition(")")[2].split()[0]
                name = Path(f"/proc/{child}/cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
            except OSError:
                continue
            if state != "Z":
                found.append((int(child), name))
    return found


def marked(mark: str) -> list[tuple[int, str]]:
    """Return the processes that were started for a case, whoever their parents are now, and what they are called."""
    found = []
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            if f"{MARK}={mark}\0".encode() in (entry / "environ").read_bytes():
                found.append((int(entry.name), (entry / "comm").read_text().strip()))
        except OSError:
            continue
    return found


def serve() -> None:
    """Call the cases that come on stdin; say on stdout what came of each."""
    import tempfile
    import time

    from bayesftc.__main__ import main

    resource.setrlimit(resource.RLIMIT_AS, (ADDRESSES, ADDRESSES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    answers = os.fdopen(os.dup(1), "wb", buffering=0)
    texts = [tempfile.TemporaryFile(), tempfile.TemporaryFile()]  # noqa: SIM115 - as long as the process
    for number, text in enumerate(texts, start=1):
        os.dup2(text.fileno(), number)
    os.environ["COLUMNS"] = "200"
    usual = dict(os.environ)
    for request in sys.stdin:
        case = json.loads(request)
        os.chdir(case["folder"])
        os.environ.update(case["environment"])
        sys.argv = ["bayesftc", *case["arguments"]]
        Path("/proc/self/clear_refs").write_text("5")  # the peak of the memory begins anew
        begin, code = time.monotonic(), 0
        try:
            main()
        except SystemExit as end:
            code = end.code or 0
        seconds = time.monotonic() - begin
        sys.stdout.flush()
        sys.stderr.flush()
        said = []
        for number, text in enumerate(texts, start=1):
            text.seek(0)
            said.append(text.read().decode(errors="replace"))
            os.ftruncate(number, 0)
            os.lseek(number, 0, os.SEEK_SET)
        peak = re.search(r"VmHWM:\s+(\d+)", Path("/proc/self/status").read_text())
        for name in os.environ.keys() - usual.keys():
            del os.environ[name]
        os.environ.update(usual)
        answer = {"code": code, "out": said[0], "err": said[1], "memory": 1024 * int(peak[1]), "seconds": seconds}
        answers.write(json.dumps(answer).encode() + b"\n")


if __name__ == "__main__":
    serve()
