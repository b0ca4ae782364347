"""MQTT brokers for tests: mosquitto, and a small one of sockets that needs no installation. Certificates for both."""

import datetime
import ipaddress
import shutil
import socket
import ssl
import struct
import subprocess
import threading
import time
from contextlib import suppress

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

NO_MOSQUITTO = None if shutil.which("mosquitto") else "mosquitto is not installed (apt-get install mosquitto)"


def until(condition, seconds=30.0):
    """Wait for a condition; it may take long on a busy machine."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "nothing has come"
        time.sleep(0.005)


def free_port():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]


class Mosquitto:
    """The broker of the Debian package, in a process of its own."""

    def __init__(self, folder, tls=None, users=None, denied=()):
        self.port = free_port()
        self._folder, self._process = folder, None
        lines = [
            "user root",
            f"listener {self.port} 127.0.0.1",
            "persistence false",
            f"allow_anonymous {str(not users).lower()}",
        ]
        if tls:
            lines += [
                f"cafile {tls.authority}",
                f"certfile {tls.server[0]}",
                f"keyfile {tls.server[1]}",
                "require_certificate true",
            ]
        if users:
            passwords = folder / "passwords"
            passwords.touch(0o600)
            for user, password in users.items():
                subprocess.run(["mosquitto_passwd", "-b", passwords, user, password], check=True, capture_output=True)
            lines.append(f"password_file {passwords}")
        if denied:
            rules = folder / "rules"
            rules.write_text("".join(f"topic deny {topic}\n" for topic in denied) + "topic readwrite #\n")
            rules.chmod(0o600)
            lines.append(f"acl_file {rules}")
        (folder / "mosquitto.conf").write_text("\n".join(lines) + "\n")

    def start(self):
        self._process = subprocess.Popen(
            ["mosquitto", "-c", self._folder / "mosquitto.conf"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        until(self._answers)
        return self

    def _answers(self):
        assert self._process.poll() is None, "mosquitto has ended"
        with suppress(OSError), socket.create_connection(("127.0.0.1", self.port), 1.0):
            return True
        return False

    def stop(self):
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None


class SmallBroker:
    """A broker of MQTT 3.1.1 with a thread for each client. It has no persistent sessions and no wildcards."""

    def __init__(self, folder=None, tls=None, users=None, denied=()):
        self.port = free_port()
        self._users, self._denied, self._context = users, denied, None
        if tls:
            self._context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH, cafile=tls.authority)
            self._context.load_cert_chain(*tls.server)
            self._context.verify_mode = ssl.CERT_REQUIRED
        self._listener, self._clients, self._retained = None, {}, {}
        self._lock = threading.RLock()
        self.clients = 0
        """Number of logins so far."""
        self.acknowledges = True

    def start(self):
        self._listener = socket.create_server(("127.0.0.1", self.port))
        threading.Thread(target=self._accept, args=(self._listener,), daemon=True).start()
        return self

    def stop(self):
        if self._listener is not None:
            self._listener.shutdown(socket.SHUT_RDWR)
            self._listener.close()
        with self._lock:
            for client in self._clients:
                with suppress(OSError):
                    client.shutdown(socket.SHUT_RDWR)
            self._listener, self._clients, self._retained = None, {}, {}

    def _accept(self, listener):
        with suppress(OSError):
            while True:
                opened, _ = listener.accept()
                threading.Thread(target=self._serve, args=(opened,), daemon=True).start()

    def _serve(self, opened):
        will, client = None, opened
        try:
            client = self._context.wrap_socket(opened, server_side=True) if self._context else opened
            will = self._log_in(client)
            while self._one(client):
                pass
            will = None
        except (OSError, EOFError, struct.error):
            pass
        finally:
            with self._lock:
                here = self._clients.pop(client, None) is not None
            client.close()
            if here and will:
                self._publish(*will)

    def _log_in(self, client):
        _, body = packet(client)
        flags, body = body[7], body[10:]
        texts = []
        for present in (
            True,
            flags & 4,
            flags & 4,
            flags & 128,
            flags & 64,
        ):  # client id, will topic and payload, user, password
            text, body = take(body) if present else (None, body)
            texts.append(text)
        _, topic, payload, user, password = texts
        if self._users is not None and self._users.get((user or b"").decode()) != (password or b"").decode():
            client.sendall(b"\x20\x02\x00\x05")
            raise EOFError
        with self._lock:
            self._clients[client] = {}
            self.clients += 1
        client.sendall(b"\x20\x02\x00\x00")
        return (topic.decode(), payload, bool(flags & 32)) if topic else None

    def _one(self, client):
        head, body = packet(client)
        kind, qos = head >> 4, head >> 1 & 3
        if kind == 3:
            topic, body = take(body)
            number, body = (body[:2], body[2:]) if qos else (b"", body)
            if qos and self.acknowledges:
                client.sendall((b"\x40\x02" if qos == 1 else b"\x50\x02") + number)
            self._publish(topic.decode(), body, bool(head & 1))
        elif kind == 6:
            client.sendall(b"\x70\x02" + body[:2])
        elif kind == 8:
            topic, _ = take(body[2:])
            refused = topic.decode() in self._denied
            client.sendall(b"\x90\x03" + body[:2] + (b"\x80" if refused else b"\x00"))
            if not refused:
                with self._lock:
                    self._clients[client][topic.decode()] = True
                if topic.decode() in self._retained:
                    client.sendall(message(topic.decode(), self._retained[topic.decode()], 1))
        elif kind == 12:
            client.sendall(b"\xd0\x00")
        return kind != 14

    def _publish(self, topic, payload, retained):
        with self._lock:
            if retained:
                self._retained[topic] = payload
            for client, topics in self._clients.items():
                if topic in topics:
                    with suppress(OSError):
                        client.sendall(message(topic, payload, 0))


def packet(client):
    """Return the first byte and the body of the next packet."""
    head, length, shift = exactly(client, 1)[0], 0, 0
    while True:
        byte = exactly(client, 1)[0]
        length |= (byte & 127) << shift
        shift += 7
        if byte < 128:
            return head, exactly(client, length)


def exactly(client, size):
    got = b""
    while len(got) < size:
        more = client.recv(size - len(got))
        if not more:
            raise EOFError
        got += more
    return got


def take(body):
    size = 2 + int.from_bytes(body[:2], "big")
    return body[2:size], body[size:]


def message(topic, payload, retained):
    body = len(topic.encode()).to_bytes(2, "big") + topic.encode() + payload
    length = bytes([len(body)]) if len(body) < 128 else bytes([len(body) & 127 | 128, len(body) >> 7])
    return bytes([0x30 | retained]) + length + body


class Certificates:
    """Files of an authority, and of a server and a client with certificates of it; and of a stranger."""

    def __init__(self, folder):
        self.folder = folder
        key, self._name = rsa.generate_private_key(65537, 2048), name_of("authority")
        self.authority = str(self._write("authority", key, self._certificate(self._name, key, key, authority=True))[0])
        self.server, self.client = (self._signed(who, key) for who in ("server", "client"))
        stranger, self._name = rsa.generate_private_key(65537, 2048), name_of("stranger")
        self.stranger = self._write(
            "stranger", stranger, self._certificate(self._name, stranger, stranger, authority=True)
        )[0]

    def _signed(self, who, authority_key):
        key = rsa.generate_private_key(65537, 2048)
        return self._write(who, key, self._certificate(name_of(who), key, authority_key))

    def _certificate(self, name, key, signing_key, authority=False):
        now = datetime.datetime.now(datetime.UTC)
        names = [
            x509.DNSName("localhost"),
            x509.IPAddress(ipaddress.ip_address("127.0.0.1")),
            x509.UniformResourceIdentifier("urn:bayesftc:test"),
        ]
        uses = [ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]
        usage = dict.fromkeys(
            ("digital_signature", "content_commitment", "key_encipherment", "data_encipherment"), True
        )
        builder = (
            x509.CertificateBuilder()
            .subject_name(name)
            .issuer_name(self._name)
            .public_key(key.public_key())
            .serial_number(x509.random_serial_number())
            .not_valid_before(now - datetime.timedelta(days=1))
            .not_valid_after(now + datetime.timedelta(days=1))
            .add_extension(x509.BasicConstraints(authority, None), critical=True)
            .add_extension(x509.SubjectAlternativeName(names), critical=False)
            .add_extension(x509.ExtendedKeyUsage(uses), critical=False)
            .add_extension(
                x509.KeyUsage(
                    **usage,
                    key_cert_sign=True,
                    key_agreement=False,
                    crl_sign=False,
                    encipher_only=False,
                    decipher_only=False,
                ),
                critical=True,
            )
            .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
            .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(signing_key.public_key()), critical=False)
        )
        return builder.sign(signing_key, hashes.SHA256())

    def _write(self, who, key, certificate):
        paths = str(self.folder / f"{who}.pem"), str(self.folder / f"{who}.key")
        plain = serialization.NoEncryption()
        for path, content in zip(
            paths,
            (
                certificate.public_bytes(serialization.Encoding.PEM),
                key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, plain),
            ),
            strict=True,
        ):
            with open(path, "wb") as file:
                file.write(content)
        return paths


def name_of(who):
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, who)])
