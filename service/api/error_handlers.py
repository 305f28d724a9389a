"""Exception handlers of the framework, which answer every failure as a problem."""

from http import HTTPStatus
from typing import Final, cast

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import Response
from starlette.exceptions import HTTPException

from service.errors import CazslError
from service.schemas.body import invalid_request
from service.transport.problems import problem_response, render_problem

_HTTP_CODES: Final = {
    404: ("no_such_route", "No such route"),
    405: ("method_not_allowed", "Method not allowed"),
}


def install_error_handlers(app: FastAPI) -> None:
    """Install handlers that answer every failure of the application as a problem."""
    app.add_exception_handler(CazslError, _on_error)
    app.add_exception_handler(RequestValidationError, _on_validation)
    app.add_exception_handler(HTTPException, _on_http)


async def _on_error(request: Request, error: Exception) -> Response:
    return problem_response(request.scope, cast(CazslError, error))


async def _on_validation(request: Request, error: Exception) -> Response:
    return problem_response(request.scope, invalid_request(cast(RequestValidationError, error).errors()))


async def _on_http(request: Request, raised: Exception) -> Response:
    """Answer a refusal of the framework: an unknown route, or a method that a route lacks."""
    error = cast(HTTPException, raised)
    if error.status_code == HTTPStatus.INTERNAL_SERVER_ERROR:
        return problem_response(request.scope, raised)
    phrase = HTTPStatus(error.status_code).phrase
    code, title = _HTTP_CODES.get(error.status_code, (phrase.lower().replace(" ", "_"), phrase))
    detail = "see /docs for the routes and their methods"
    headers = dict(error.headers or {})
    if headers.get("Allow") == "GET":
        headers["Allow"] = "GET, HEAD"  # ``Service.framework`` answers it
    return render_problem(request.scope, error.status_code, code, title, detail, headers=headers or None)
