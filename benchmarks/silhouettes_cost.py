"""Cost of finding an outline in the hardest pictures that the service accepts: processor time and memory."""

import io
import json
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt
from PIL import Image

from benchmarks.photographs import photograph

LARGEST: Final = (4096, 3072)  # 12 megapixels
SIDE: Final = 2048  # pixels in which masks are traced
_CHILD: Final = """
import json, sys, time
from pathlib import Path
from service.errors import CazslError
from service.pushing.images import decode_colour
from service.silhouettes.search import find_outline
def peak_mib():
    status = Path("/proc/self/status").read_text()
    return next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmHWM")) / 1024
content, before, started = Path(sys.argv[1]).read_bytes(), peak_mib(), time.process_time()
picture = decode_colour(content)
decoded = time.process_time()
try:
    answer = f"{len(find_outline(picture, 0.0002).outline.corners)} corners"
except CazslError as error:
    answer = str(error).partition(";")[0].partition(" (")[0].partition("received ")[2]
print(json.dumps([decoded - started, time.process_time() - decoded, peak_mib() - before, answer]))
"""


@dataclass(frozen=True)
class Cost:
    """Cost of one picture: processor time in s of decoding and of the search, memory of both in MiB, and the answer."""

    picture: str
    decode_s: float
    search_s: float
    memory_mib: float
    answer: str


def costs() -> list[Cost]:
    """Measure the hardest pictures, each in a process of its own."""
    return [_cost(name, draw()) for name, draw in PICTURES.items()]


def _cost(name: str, content: bytes) -> Cost:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "picture"
        path.write_bytes(content)
        command = [sys.executable, "-c", _CHILD, str(path)]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
    return Cost(name, *json.loads(done.stdout))


def _file(levels: npt.NDArray[np.uint8], form: str = "PNG") -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(levels).save(buffer, form, quality=70)
    return buffer.getvalue()


def _large_photograph() -> bytes:
    shown = photograph(np.random.default_rng([24, 0, 0]))
    return _file(np.asarray(Image.fromarray(shown.levels).resize(LARGEST)), "JPEG")


def _noise() -> bytes:
    levels = np.random.default_rng(0).integers(0, 256, (LARGEST[1] // 4, LARGEST[0] // 4, 3), dtype=np.uint8)
    return _file(np.asarray(Image.fromarray(levels).resize(LARGEST)), "JPEG")


def _checks() -> bytes:
    """Draw dots of a pixel, a quarter of a million: each is a region."""
    mask = np.zeros((SIDE, SIDE), dtype=np.uint8)
    mask[2:-2:4, 2:-2:4] = 255
    return _file(mask)


def _comb() -> bytes:
    """Draw a comb whose teeth and gaps are 2 pixels wide: an outline of two million steps."""
    mask = np.zeros((SIDE, SIDE), dtype=np.uint8)
    mask[4:-4, 4:-4] = 255
    mask[12:-4, 6:-6:4] = 0
    mask[12:-4, 7:-6:4] = 0
    return _file(mask)


def _spiral() -> bytes:
    """Draw a spiral of 4 pixels, whose corners all matter."""
    y, x = np.mgrid[:SIDE, :SIDE].astype(np.float32) - np.float32(SIDE / 2)
    radius = np.hypot(x, y)
    arm = (radius / 8.0 - np.arctan2(y, x) / (2.0 * np.pi)) % 1.0 < 0.5
    return _file(np.where(arm & (radius < SIDE / 2 - 8), 255, 0).astype(np.uint8))


PICTURES: Final[dict[str, Callable[[], bytes]]] = {
    "a photograph of 4096 x 3072": _large_photograph,
    "noise of 4096 x 3072": _noise,
    "a mask of 261,121 dots": _checks,
    "a mask of a comb with 510 teeth": _comb,
    "a mask of a spiral with 127 turns": _spiral,
}
