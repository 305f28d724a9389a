"""A pickle that shows that it was loaded."""

import os
from collections.abc import Callable
from pathlib import Path


class PickleTrap:
    """Object that makes a folder at ``path`` when a pickle of it is loaded."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Callable[[str], None], tuple[str]]:
        return os.mkdir, (str(self.path),)
