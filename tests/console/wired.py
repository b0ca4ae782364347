"""``bayesftc live --serve`` in a process of its own, with the car of the example behind a cable, for the tests."""

import os
import signal
import socket
import subprocess
import sys
import threading
from contextlib import contextmanager, suppress

from served import read_address

from bayesftc.scenario import find_scenario


def free_port():
    """Return the first of six UDP ports that are free."""
    for port in range(20_000 + os.getpid() % 10_000, 60_000, 7):
        with suppress(OSError):
            for each in range(port, port + 6):
                with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
                    probe.bind(("127.0.0.1", each))
            return port
    raise AssertionError("no port is free")


@contextmanager
def car(port, freeze):
    """Run the car of the example in another process; end it without a farewell."""
    command = [sys.executable, "-m", "bayesftc.examples.live_car.car", "--port", str(port), "--freeze", str(freeze)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout.readline() == "The car drives.\n"
        yield
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


class Cable:
    """Forwards the samples of the two sensors, unless it is cut."""

    def __init__(self, port):
        self.is_cut, self.over = False, threading.Event()
        self.threads = [threading.Thread(target=self.forward, args=(port + i, port + 4 + i)) for i in range(2)]

    def forward(self, source, target):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as cable:
            cable.bind(("127.0.0.1", source))
            cable.settimeout(0.1)
            while not self.over.is_set():
                with suppress(TimeoutError, ConnectionError):
                    packet = cable.recv(100)
                    if not self.is_cut:
                        cable.sendto(packet, ("127.0.0.1", target))

    def __enter__(self):
        for thread in self.threads:
            thread.start()
        return self

    def __exit__(self, *error):
        self.over.set()
        for thread in self.threads:
            thread.join()


def wires_file(folder, port):
    """Write the wires of the example with other ports: the samples come through the cable."""
    text = find_scenario("car_by_udp", "wires").read_text()
    for i, other in enumerate((port + 4, port + 5, port + 2, port + 3)):
        text = text.replace(f"port = {47000 + i}\n", f"port = {other}\n")
    file = folder / "wires.toml"
    file.write_text(f"{text}\n[recording]\nseconds = 0.5\n")
    return file


class LiveProcess:
    """``bayesftc live --serve`` in a group of processes of its own."""

    def __init__(self, folder, port, *options):
        command = [sys.executable, "-m", "bayesftc", "live", "live_car", "--bridge", str(wires_file(folder, port))]
        command += [*(options or ("--record", str(folder / "recording"))), "--serve", "--port", "0", "-q"]
        self.process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True)
        self.address = read_address(self.process)

    def end(self, how):
        """Send a signal; return the exit status, all that was printed, and whether a process is left."""
        self.process.send_signal(how)
        printed = self.process.communicate(timeout=10)[1]
        try:
            os.killpg(self.process.pid, 0)
        except ProcessLookupError:
            return self.process.returncode, printed, False
        return self.process.returncode, printed, True

    def close(self):
        with suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()
        self.process.stderr.close()
