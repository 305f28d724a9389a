"""Draft of a version, checked before a byte of it is written: all that is published can be read back."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

from service.errors import BrokenModelError
from service.model.manifest import (
    CARD_FILE,
    FORMAT,
    MANIFEST_FILE,
    MAX_MANIFEST_BYTES,
    MODEL_FILE,
    FileDigest,
    Manifest,
)
from service.registry.verification import MAX_CARD_BYTES, Requirements, parse_manifest


@dataclass(frozen=True)
class Draft:
    """A version that has no number yet: its manifest with the digests of its files, and the files."""

    whole: Manifest
    files: Mapping[str, bytes]
    required: Requirements

    @classmethod
    def of(cls, manifest: Manifest, model: bytes, card: str, required: Requirements) -> "Draft":
        """Create a draft, and check all of it but its number.

        Raises:
            BrokenModelError: a file is too large, or the manifest or the card could not be read back.
        """
        try:
            files = {MODEL_FILE: model, CARD_FILE: card.encode()}
        except UnicodeEncodeError as error:
            raise BrokenModelError(f"{CARD_FILE}: a text with half a character") from error
        for file, limit in ((MODEL_FILE, required.max_model_bytes), (CARD_FILE, MAX_CARD_BYTES)):
            if len(files[file]) > limit:
                raise BrokenModelError(f"{file}: {len(files[file])} bytes; at most {limit} are allowed")
        digests = {file: FileDigest.of(content) for file, content in files.items()}
        draft = cls(replace(manifest, format=FORMAT, files=digests), files, required)
        draft.manifest(1)
        return draft

    def manifest(self, version: int) -> bytes:
        """Render the manifest for a number, and check that it can be read back.

        Raises:
            BrokenModelError: it cannot.
        """
        try:
            content = replace(self.whole, version=version).render()
        except (ValueError, TypeError) as error:  # a number that is not finite, half a character, another type
            raise BrokenModelError(f"{MANIFEST_FILE}: it has no text in JSON") from error
        if len(content) > MAX_MANIFEST_BYTES:
            raise BrokenModelError(f"{MANIFEST_FILE}: {len(content)} bytes; at most {MAX_MANIFEST_BYTES} are allowed")
        parse_manifest(content, self.required.domain)
        return content
