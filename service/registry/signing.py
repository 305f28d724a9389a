"""Signatures of versions: key-based signatures of OpenSSF model-signing, made and checked without a network.

A signature lies beside its version and covers every file of it, including the manifest. The checked bytes are those
that are loaded: they are written to a private temporary folder for the library, so no file can be exchanged between
the check and the use. Needs the extra ``signing`` and a writable TMPDIR.
"""

import contextlib
import logging
import os
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from model_signing import signing, verifying

from service.errors import BrokenModelError, RegistryError

SIGNATURE_FILE = "signature.json"
FOLDER = "version"


@dataclass(frozen=True)
class TrustedKeys:
    """Public keys (PEM files), one of which must have signed. See ``service.registry.verification.Signatures``."""

    keys: tuple[Path, ...]

    def check(self, files: Mapping[str, bytes], signature: bytes | None) -> None:
        """See ``Signatures.check``."""
        if signature is None:
            raise BrokenModelError("signature: there is none, but one is required; sign the version")
        with _in_folder(files) as folder:
            path = folder / SIGNATURE_FILE
            path.write_bytes(signature)
            if not any(_signed(key, folder, path) for key in self.keys):
                raise BrokenModelError(
                    f"signature: not made by one of the {len(self.keys)} trusted keys, or made for other files"
                )


def sign(files: Mapping[str, bytes], private_key: Path) -> bytes:
    """Sign files with an elliptic-curve key in PEM format. Its password comes from CAZSL_KEY_PASSWORD.

    Raises:
        RegistryError: the key cannot be read, has another type, or has another password.
    """
    with _in_folder(files) as folder:
        path = folder / SIGNATURE_FILE
        password = (
            os.environ.get("CAZSL_KEY_PASSWORD", "").rstrip("\r\n") or None
        )  # files of secrets end in a line feed
        try:
            config = signing.Config().use_elliptic_key_signer(private_key=private_key, password=password)
            config.sign(folder / FOLDER, path)
        except Exception as error:  # errors of the library and of its dependency share no base class
            raise RegistryError(
                "the key cannot sign: expected an elliptic-curve private key in PEM format, and its password in "
                "CAZSL_KEY_PASSWORD if it has one"
            ) from error
        return path.read_bytes()


def _signed(key: Path, folder: Path, signature: Path) -> bool:
    try:
        verifying.Config().use_elliptic_key_verifier(public_key=key).verify(folder / FOLDER, signature)
    except Exception as error:  # see above. In all cases the signature is not valid
        logging.getLogger(__name__).debug("signature refused", extra={"reason": type(error).__name__})
        return False
    return True


@contextlib.contextmanager
def _in_folder(files: Mapping[str, bytes]) -> Iterator[Path]:
    """Write files to a private temporary folder, and delete it afterwards."""
    try:
        with tempfile.TemporaryDirectory(prefix="cazsl-") as name:
            folder = Path(name)
            (folder / FOLDER).mkdir()
            for file, content in files.items():
                (folder / FOLDER / file).write_bytes(content)
            yield folder
    except OSError as error:
        raise RegistryError(
            f"signature: no temporary folder can be made ({error.strerror}); set TMPDIR to a writable one"
        ) from error
