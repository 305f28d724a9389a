"""The service from Python: arrays in, arrays out; blocking or asyncio, over HTTP or in this process.

    from service.client import Client

    with Client("http://localhost:8000") as client:
        predictions = client.predict_batch(pushers, "1a2b3c4a")     # pushers (n, 3); .mean and .std (n, 3)

The distribution is ``cazsl``. Neither torch nor onnxruntime is loaded, unless predictions are made in this process.
Calls point downward: ``blocking`` and ``asynchronous`` share ``base``, which sends the requests of ``calls``; ``local``
answers them in this process and is imported only by ``Client.local``.
"""

from service.client.asynchronous import AsyncClient
from service.client.blocking import Client
from service.client.calls import Predictions
from service.client.errors import ClientError, ProblemError, TimedOutError, UnreachableError, UnreadableAnswerError
from service.client.retries import Retries
from service.schemas.contexts import ContextBody

__all__ = [
    "AsyncClient",
    "Client",
    "ClientError",
    "ContextBody",
    "Predictions",
    "ProblemError",
    "Retries",
    "TimedOutError",
    "UnreachableError",
    "UnreadableAnswerError",
]
