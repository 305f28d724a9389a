"""Faults of one model of a registry, in a folder and in a bucket, and the ways in which its content is lost."""

import os
import shutil
import socket
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

import obstore
from obstore.store import S3Store

from service.registry.registry import Registry
from service.storage.base import MAX_HISTORY_BYTES
from service.storage.folder_storage import FolderStorage
from tests.s3_server import BUCKET

Harm = Callable[[Registry, str], object]
CHAMPION: Final = ("aliases", "champion")


def path_of(registry: Registry, *parts: str) -> Path:
    """Return a path in a registry that lies in a folder."""
    assert isinstance(registry.storage, FolderStorage)
    return registry.storage.root.joinpath(*parts)


def replaced(registry: Registry, *parts: str) -> Path:
    """Delete a file or a folder, and return its path for another entry."""
    path = path_of(registry, *parts)
    shutil.rmtree(path) if path.is_dir() else path.unlink()
    os.utime(path_of(registry, parts[0])) if len(parts) > 1 else None
    return path


def enlarge(path: Path) -> Path:
    """Make a history larger than is read. The bytes are a hole, which takes no space."""
    os.truncate(path, MAX_HISTORY_BYTES + 1)
    return path


def bind_socket(path: Path) -> None:
    """Create a socket. Its path may be longer than a socket's address."""
    with socket.socket(socket.AF_UNIX) as opened:
        back = Path.cwd()
        os.chdir(path.parent)
        try:
            opened.bind(path.name)
        finally:
            os.chdir(back)


def store_of(registry: Registry) -> S3Store:
    """Open the bucket of a registry of ``test_base`` without the registry."""
    return S3Store(BUCKET, prefix="models", endpoint=os.environ["AWS_ENDPOINT_URL"], allow_http=True)


def put(registry: Registry, key: str, content: bytes) -> None:
    """Replace an object."""
    obstore.put(store_of(registry), key, content)


def delete_below(registry: Registry, prefix: str) -> Registry:
    """Delete an object, or every object below a prefix."""
    store = store_of(registry)
    keys = [entry["path"] for page in obstore.list(store) for entry in page]
    obstore.delete(store, [key for key in keys if not prefix or key == prefix or key.startswith(f"{prefix}/")])
    return registry


# Each makes one alias, or a whole model, unreadable. The name of the model is the second argument.
FOLDER_FAULTS: Final[Mapping[str, Harm]] = {
    "aliases is a file": lambda registry, name: replaced(registry, name, "aliases").write_text("1\n"),
    "aliases is a link": lambda registry, name: replaced(registry, name, "aliases").symlink_to(registry.root),
    "aliases is a pipe": lambda registry, name: os.mkfifo(replaced(registry, name, "aliases")),
    "alias is a folder": lambda registry, name: replaced(registry, name, *CHAMPION).mkdir(),
    "alias is a pipe": lambda registry, name: os.mkfifo(replaced(registry, name, *CHAMPION)),
    "alias is a socket": lambda registry, name: bind_socket(replaced(registry, name, *CHAMPION)),
    "alias is a dangling link": lambda registry, name: replaced(registry, name, *CHAMPION).symlink_to("nowhere"),
    "alias is a looping link": lambda registry, name: replaced(registry, name, *CHAMPION).symlink_to("champion"),
    "alias is a device": lambda registry, name: replaced(registry, name, *CHAMPION).symlink_to("/dev/zero"),
    "alias is empty": lambda registry, name: replaced(registry, name, *CHAMPION).write_bytes(b""),
    "alias is no text": lambda registry, name: replaced(registry, name, *CHAMPION).write_bytes(b"\xff1\n"),
    "alias is large": lambda registry, name: replaced(registry, name, *CHAMPION).write_bytes(bytes(99_999)),
    "alias has a hard link": lambda registry, name: path_of(registry, name, "backup").hardlink_to(
        path_of(registry, name, *CHAMPION)
    ),
    "history is a folder": lambda registry, name: replaced(registry, name, "history.jsonl").mkdir(),
    "history is a pipe": lambda registry, name: os.mkfifo(replaced(registry, name, "history.jsonl")),
    "history is a link": lambda registry, name: replaced(registry, name, "history.jsonl").symlink_to("nowhere"),
    "end of the history is a folder": lambda registry, name: replaced(registry, name, "history.head").mkdir(),
    "removed is a file": lambda registry, name: path_of(registry, name, "removed").write_text("1\n"),
    "model is a file": lambda registry, name: replaced(registry, name).write_text("1\n"),
    "model is a link": lambda registry, name: replaced(registry, name).symlink_to("push-indicator"),
    "model is a looping link": lambda registry, name: replaced(registry, name).symlink_to(name),
    "model is a pipe": lambda registry, name: os.mkfifo(replaced(registry, name)),
}
BUCKET_FAULTS: Final[Mapping[str, Harm]] = {
    f"state is {label}": lambda registry, name, content=content: put(registry, f"{name}/state.json", content)
    for label, content in {
        "empty": b"",
        "torn": b'{"versions": [1], "aliases": {"champ',
        "not an object": b"[]",
        "without keys": b"{}",
        "not UTF-8": b"\xff",
        "of wrong types": b'{"versions": ["1"], "aliases": {}, "removed": [], "generation": 1, "event": ""}',
        "of fractions": b'{"versions": [1.5], "aliases": {}, "removed": [], "generation": 1, "event": ""}',
        "of a list of aliases": b'{"versions": [1], "aliases": ["x"], "removed": [], "generation": 1, "event": ""}',
        "of a wrong alias": b'{"versions": [1], "aliases": {"../x": 1}, "removed": [], "generation": 1, "event": ""}',
        "infinite": b'{"versions": [1], "aliases": {}, "removed": [], "generation": 1e999, "event": ""}',
        "deep": b"[" * 100_000,
        "large": b" " * (5 << 20),
    }.items()
} | {"state is missing": lambda registry, name: delete_below(registry, f"{name}/state.json")}
# Each makes content disappear, without a removal.
FOLDER_LOSSES: Final[Mapping[str, Harm]] = {
    "alias": lambda registry, name: replaced(registry, name, "aliases", "champion"),
    "aliases": lambda registry, name: replaced(registry, name, "aliases"),
    "alias, beside a history that is too large": lambda registry, name: [
        replaced(registry, name, *CHAMPION),
        enlarge(path_of(registry, name, "history.jsonl")),
    ],
    "aliases and history": lambda registry, name: [
        replaced(registry, name, part) for part in ("aliases", "history.jsonl", "history.head")
    ],
    "versions": lambda registry, name: [replaced(registry, name, part) for part in ("1", "2")],
    "content of the model": lambda registry, name: replaced(registry, name).mkdir(),
    "model": replaced,
    "all models": lambda registry, name: replaced(registry, ".").mkdir(),
    "registry": lambda registry, name: replaced(registry, "."),
}
BUCKET_LOSSES: Final[Mapping[str, Harm]] = {
    "state": lambda registry, name: delete_below(registry, f"{name}/state.json"),
    "state and history": lambda registry, name: [
        delete_below(registry, f"{name}/{part}") for part in ("state.json", "history")
    ],
    "versions": lambda registry, name: [delete_below(registry, f"{name}/{part}") for part in ("1", "2")],
    "model": delete_below,
    "all models": lambda registry, name: delete_below(registry, ""),
}
# Each adds an entry that is no model, in a model's place. The name that messages show for it follows.
FOLDER_STRANGERS: Final[Mapping[str, Callable[[Registry], object]]] = {
    "Push": lambda registry: path_of(registry, "Push", "1").mkdir(parents=True),
    "a b": lambda registry: path_of(registry, "a b").mkdir(),
    "\\udcff": lambda registry: path_of(registry, os.fsdecode(b"\xff")).mkdir(),
    "x\\x1b[31m": lambda registry: path_of(registry, "x\x1b[31m").mkdir(),
    "pipe": lambda registry: os.mkfifo(path_of(registry, "pipe")),
    "file": lambda registry: path_of(registry, "file").write_text("1\n"),
    "link": lambda registry: path_of(registry, "link").symlink_to("nowhere"),
    "socket": lambda registry: bind_socket(path_of(registry, "socket")),
}
BUCKET_STRANGERS: Final[Mapping[str, Callable[[Registry], object]]] = {
    "Push": lambda registry: put(registry, "Push/state.json", b"{}"),
    "a b": lambda registry: put(registry, "a b/1/model.onnx", b""),
}
