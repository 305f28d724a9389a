"""Routes of the framework that document endpoints, and answer as the fast path does."""

from collections.abc import Callable, Coroutine
from typing import Any

from fastapi import Request, Response
from fastapi.routing import APIRoute

from service.api.dependencies import parts_of
from service.observability.records import record_of
from service.transport.callers import caller_of
from service.transport.endpoints import HttpRequest
from service.transport.fast_path import note_answer


class EndpointRoute(APIRoute):
    """A route whose function is its documentation: signature, docstring and responses go into the OpenAPI document.

    The fast path in front of the framework answers the requests. A request that reaches the framework nevertheless is
    answered by the same endpoint.
    """

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """Return a handler that answers with the endpoint of the route's path."""

        async def answer(request: Request) -> Response:
            """Answer one request."""
            endpoints, scope = parts_of(request).endpoints, request.scope
            asked = HttpRequest(scope["headers"], await request.body(), request.path_params, caller_of(scope))
            answer = await endpoints.answer(endpoints.at(self.path), asked)
            note_answer(record_of(scope), answer)
            headers = {name.decode(): value.decode() for name, value in answer.headers}
            return Response(answer.content, headers=headers)

        return answer
