"""Certificates and private keys of OPC UA, in PEM or DER."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bayesftc.cosim.base.extras import extra
from bayesftc.cosim.errors import ModelError


def encoding(file: str) -> str:
    """Return the encoding of a file by its content: ``"pem"`` or ``"der"``."""
    return "pem" if b"-----BEGIN" in Path(file).read_bytes() else "der"


def check_pair(certificate: str, key: str) -> None:
    """Check that two files have a certificate and its private key.

    Raises
    ------
    ModelError
        If they have not.
    """
    serialization = extra("cryptography.hazmat.primitives.serialization", "OPC UA", of="live")
    load = getattr(serialization, f"load_{encoding(key)}_private_key")
    try:
        fit = load(Path(key).read_bytes(), None).public_key() == _certificate(certificate).public_key()
    except (TypeError, ValueError):
        fit = False
    if not fit:
        raise ModelError(
            f"OPC UA cannot use certificate={certificate!r} with key={key!r}. They must be a certificate and its private key, "
            "without a password, as PEM or DER."
        )


def application_uri(certificate: str) -> str | None:
    """Return the name of the application in a certificate; servers compare it with that of the client."""
    x509 = extra("cryptography.x509", "OPC UA", of="live")
    try:
        names = _certificate(certificate).extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except x509.ExtensionNotFound:
        return None
    return next(iter(names.get_values_for_type(x509.UniformResourceIdentifier)), None)


def _certificate(file: str) -> Any:
    x509 = extra("cryptography.x509", "OPC UA", of="live")
    return getattr(x509, f"load_{encoding(file)}_x509_certificate")(Path(file).read_bytes())


__all__ = ["application_uri", "check_pair", "encoding"]
