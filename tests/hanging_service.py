"""A service process with threads that hang, for tests of its end: ``python -m tests.hanging_service PURPOSE ...``.

Each purpose is one of ``HANGS``. The other arguments are those of ``cazsl serve``, in the environment.
"""

import atexit
import sys
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Final

import pytest

from service.cli.main import main
from service.inference import probing
from service.inference.loaded_models import LoadedModels
from service.model.predictor import OnnxPredictor
from service.observability.metrics import RequestMetrics

FOREVER_S: Final = 3600.0
PATCH: Final = pytest.MonkeyPatch()


def hang(*_: Any, **__: Any) -> Any:
    """Sleep for ever."""
    time.sleep(FOREVER_S)


def hang_polls() -> None:
    """Let every poll but the first hang."""
    refresh, polls = LoadedModels.refresh, list[int]()

    def second(models: LoadedModels) -> None:
        """Poll once, then hang."""
        polls.append(1)
        refresh(models) if len(polls) == 1 else hang()

    PATCH.setattr(LoadedModels, "refresh", second)


def hang_probes() -> None:
    """Let every probe hang."""
    PATCH.setattr(probing, "check_itself", hang)


def hang_batches() -> None:
    """Let predictions of many pushes hang."""
    predict = OnnxPredictor.predict

    def slow(predictor: OnnxPredictor, rows: Any, *others: Any) -> Any:
        """Predict few pushes, or hang."""
        return predict(predictor, rows, *others) if len(rows) < 100 else hang()

    PATCH.setattr(OnnxPredictor, "predict", slow)


def hang_scrapes() -> None:
    """Let every scrape of metrics hang."""
    PATCH.setattr(RequestMetrics, "collect", hang)


def hang_library_threads() -> None:
    """Start threads as libraries do, which Python awaits at its end."""
    ThreadPoolExecutor().submit(hang)
    threading.Thread(target=hang).start()


def hang_exit() -> None:
    """Register a handler that hangs when Python ends, as libraries register one."""
    atexit.register(hang)


HANGS: Final[Mapping[str, Callable[[], None]]] = {
    "polls": hang_polls,
    "probes": hang_probes,
    "batches": hang_batches,
    "scrapes": hang_scrapes,
    "library threads": hang_library_threads,
    "exit": hang_exit,
}

if __name__ == "__main__":
    for purpose in sys.argv[1:]:
        HANGS[purpose]()
    sys.argv[1:] = ["serve"]
    main()
