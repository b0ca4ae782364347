"""Programs that run in parallel, each in its own thread, and can be ended together."""

import subprocess
import threading
from collections.abc import Sequence
from pathlib import Path

__all__ = ["Processes"]


class Processes:
    """A group of programs.

    Editors and notebooks send Ctrl-C only to this process. The programs that it started would not stop, and threads would
    continue to wait for them.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._running: set[subprocess.Popen[str]] = set()
        self._ended = False

    def run(self, command: Sequence[str], folder: Path, limit: float) -> subprocess.CompletedProcess[str]:
        """Run a program in a folder for at most `limit` seconds; raises what `subprocess.run` raises."""
        with self._lock:
            process = subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
            self._running.add(process)
            if self._ended:
                process.kill()
        with process:
            try:
                output, errors = process.communicate(timeout=limit)
            except BaseException:
                process.kill()
                raise
            finally:
                with self._lock:
                    self._running.discard(process)
        return subprocess.CompletedProcess(process.args, process.returncode, output, errors)

    def end(self) -> None:
        """End all running programs, and all that are started later."""
        with self._lock:
            self._ended = True
            for process in self._running:
                process.kill()
