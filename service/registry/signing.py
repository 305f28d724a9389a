"""Who signed a version: key-based signatures of OpenSSF model-signing, made and checked without a network.

A signature lies beside its version and covers every file of it, the manifest among them. What is checked are the very
bytes that are about to be handed over: they are laid out in a private temporary folder for the library to look at, so
that nobody can exchange a file between the check and the use. Needs the extra ``signing`` and a writable TMPDIR.
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
    """PEM files of the public keys of which one must have signed; see ``service.registry.verification.Signatures``."""

    keys: tuple[Path, ...]

    def check(self, files: Mapping[str, bytes], signature: bytes | None) -> None:
        """Accept the bytes of a version.

        Raises:
            BrokenModelError: nobody who is trusted signed them.
        """
        if signature is None:
            raise BrokenModelError("signature: there is none, and this service demands one")
        with _laid_out(files) as folder:
            path = folder / SIGNATURE_FILE
            path.write_bytes(signature)
            if not any(_signed(key, folder, path) for key in self.keys):
                raise BrokenModelError(f"signature: by none of the {len(self.keys)} trusted keys, or of other files")


def sign(files: Mapping[str, bytes], private_key: Path) -> bytes:
    """The signature of these files with an elliptic-curve key in PEM; a password comes from CAZSL_KEY_PASSWORD.

    Raises:
        RegistryError: the key cannot be used.
    """
    with _laid_out(files) as folder:
        path = folder / SIGNATURE_FILE
        password = os.environ.get("CAZSL_KEY_PASSWORD")
        try:
            config = signing.Config().use_elliptic_key_signer(private_key=private_key, password=password)
            config.sign(folder / FOLDER, path)
        except Exception as error:  # the library's errors, and those of the one below it, share no root
            raise RegistryError(
                "the key cannot sign: expected an unlocked elliptic-curve private key in PEM"
            ) from error
        return path.read_bytes()


def _signed(key: Path, folder: Path, signature: Path) -> bool:
    try:
        verifying.Config().use_elliptic_key_verifier(public_key=key).verify(folder / FOLDER, signature)
    except Exception as error:  # see above: whatever it is, the signature does not hold
        logging.getLogger(__name__).debug("signature refused", extra={"reason": type(error).__name__})
        return False
    return True


@contextlib.contextmanager
def _laid_out(files: Mapping[str, bytes]) -> Iterator[Path]:
    """The files in a private folder, gone afterwards."""
    try:
        with tempfile.TemporaryDirectory(prefix="cazsl-") as name:
            folder = Path(name)
            (folder / FOLDER).mkdir()
            for file, content in files.items():
                (folder / FOLDER / file).write_bytes(content)
            yield folder
    except OSError as error:
        raise RegistryError(f"signature: no temporary folder to check it in ({error.strerror}); set TMPDIR") from error
