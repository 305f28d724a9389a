"""Python client of the service: numpy arrays in and out, blocking or asyncio, over HTTP or in this process.

    from service.client import Client

    with Client("http://localhost:8000") as client:
        predictions = client.predict_batch(pushers, "1a2b3c4a")     # pushers (n, 3); .mean and .std (n, 3)

The distribution is called ``cazsl``. torch is never loaded, and onnxruntime only by ``Client.local``.

``blocking`` and ``asynchronous`` are the two clients, and ``base`` is their common part. ``blocking_planning`` has the
methods about several pushes. ``connections`` finds the way to the service, ``calls`` builds requests of ``arguments``
and parses answers, ``planning_calls`` and ``plan_calls`` those about several pushes, ``deadline`` bounds each call in
time, ``retries`` decides on pauses, and ``errors`` are the exceptions. ``local`` answers requests in this process and
is imported only by ``Client.local``. Calls point downward: the package imports ``service.schemas``, ``service.model``
and ``service.errors``, and ``local`` also imports the packages that answer a request.
"""

from service.client.asynchronous import AsyncClient
from service.client.blocking import Client
from service.client.calls import Predictions
from service.client.errors import (
    ClientError,
    ClientSetupError,
    ProblemError,
    TimedOutError,
    UnreachableError,
    UnreadableAnswerError,
)
from service.client.plan_calls import Plan, Refinement
from service.client.planning_calls import PushMap, Region, Rollout, Steps
from service.client.retries import Retries
from service.schemas.contexts import ContextBody
from service.schemas.supports import SupportBody

__all__ = [
    "AsyncClient",
    "Client",
    "ClientError",
    "ClientSetupError",
    "ContextBody",
    "Plan",
    "Predictions",
    "ProblemError",
    "PushMap",
    "Refinement",
    "Region",
    "Retries",
    "Rollout",
    "Steps",
    "SupportBody",
    "TimedOutError",
    "UnreachableError",
    "UnreadableAnswerError",
]
