"""A served scenario in a process of its own, and a viewer that speaks its protocol, for the tests."""

import http.client
import json
import re
import signal
import socket
import struct
import subprocess
import sys
import time
from contextlib import contextmanager

import numpy as np
from websockets.sync.client import connect

PATIENCE = 90


@contextmanager
def served(*arguments, command=("serve",)):
    """Yield the process and the address of ``bayesftc serve``, or of another command that serves; end it by SIGINT."""
    command = [sys.executable, "-m", "bayesftc", *command, *arguments, "--port", "0"]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    try:
        yield process, read_address(process)
        process.send_signal(signal.SIGINT)
        rest = process.communicate(timeout=PATIENCE)[1]
        assert process.returncode == 0, rest
        assert "The console has ended." in rest
        assert "Traceback" not in rest
    finally:
        if process.poll() is None:
            process.kill()
            process.wait()


def read_address(process):
    """Return the address that the process prints."""
    said = ""
    while not (found := re.search(r"http://\S+", said)):
        line = process.stderr.readline()
        assert line, said
        said += line
    return found[0]


def get(address, path, **headers):
    """Return status, headers and body of the answer to a request."""
    host = re.search(r"http://([^/]+)", address)[1]
    connection = http.client.HTTPConnection(host, timeout=60)
    connection.request("GET", path, headers=headers)
    answer = connection.getresponse()
    body = answer.read()
    connection.close()
    return answer.status, dict(answer.getheaders()), body


def until(condition):
    """Wait until a condition holds."""
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


def connect_without_reading(address):
    """Return the socket of a viewer that reads nothing, with a small buffer."""
    host = re.search(r"http://([^/]+)", address)[1]
    stuck = socket.socket()
    stuck.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    name, port = host.split(":")
    stuck.connect((name, int(port)))
    stuck.sendall(
        f"GET /live HTTP/1.1\r\nHost: {host}\r\nOrigin: http://{host}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n".encode()
    )
    return stuck


class Viewer:
    """A viewer without a page."""

    def __init__(self, address, **options):
        self.address = address
        self.host = re.search(r"http://([^/]+)", address)[1]
        options.setdefault("origin", f"http://{self.host}")
        self.socket = connect(f"ws://{self.host}/live", max_size=None, open_timeout=PATIENCE, **options).__enter__()
        self.layout, self.header, self.rows, self.number = None, None, {}, 0
        self.answers = {}

    def __enter__(self):
        return self

    def __exit__(self, *error):
        self.socket.close()

    def receive(self):
        """Take one message."""
        message = self.socket.recv(timeout=PATIENCE)
        if isinstance(message, str):
            content = json.loads(message)
            if content["type"] == "layout":
                self.layout = content
            elif "id" in content:
                self.answers[content["id"]] = content
            return content
        (length,) = struct.unpack_from("<I", message)
        header = json.loads(message[4 : 4 + length])
        rows, columns = header["shape"]
        at = 4 + length
        assert at % 8 == 0
        steps = np.frombuffer(message, "<f8", rows, at)
        values = np.frombuffer(message, "<f4", rows * columns, at + 8 * rows).reshape(columns, rows)
        if header.get("reset"):
            self.columns = [tuple(each) for each in header["columns"]]
            self.steps, self.values = steps, values
        else:
            self.steps, self.values = np.append(self.steps, steps), np.append(self.values, values, axis=1)
        self.header = header
        return header

    def until(self, condition):
        """Take messages until a condition holds."""
        end = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < end
            self.receive()

    def ready(self):
        """Wait for the first frame."""
        self.until(lambda: self.header is not None)
        return self

    def ask(self, **command):
        """Send a command and return the answer."""
        self.number += 1
        self.socket.send(json.dumps({**command, "id": self.number}))
        self.until(lambda: self.number in self.answers)
        return self.answers.pop(self.number)

    def claim(self):
        """Take the controls, as soon as nobody else has them."""
        end = time.monotonic() + PATIENCE
        while self.ask(do="claim")["type"] != "done":
            assert time.monotonic() < end
            time.sleep(0.05)

    def do(self, **command):
        """Send a command that must succeed, and wait for the frame after it."""
        answer = self.ask(**command)
        assert answer["type"] == "done", answer
        return answer

    def column(self, name, lane=0):
        """Return the values of a signal."""
        return self.values[self.columns.index((lane, name))]
