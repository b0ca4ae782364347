"""Programs that run side by side, each in a thread of its own, and can be ended together."""

import subprocess
import threading
from collections.abc import Sequence
from pathlib import Path

__all__ = ["Processes"]


class Processes:
    """Programs that were started together.

    A Ctrl-C that is meant for this process alone, as an editor or a notebook sends it, is not heard by the programs that it
    started, and a thread that waits for one of them would go on waiting.
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
                said, errors = process.communicate(timeout=limit)
            except BaseException:
                process.kill()
                raise
            finally:
                with self._lock:
                    self._running.discard(process)
        return subprocess.CompletedProcess(process.args, process.returncode, said, errors)

    def end(self) -> None:
        """End all that run, and all that are started later."""
        with self._lock:
            self._ended = True
            for process in self._running:
                process.kill()
