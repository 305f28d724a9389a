"""The record of one request, from which its log line, its metrics and its span are made."""

from collections.abc import Mapping, MutableMapping
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any, Final, get_args

from service.observability.timings import Phase, Timings

UNKNOWN_ROUTE: Final = "unknown"
_PHASE_FIELDS: Final[Mapping[Phase, str]] = {phase: f"{phase}_ms" for phase in get_args(Phase)}


@dataclass(slots=True)
class RequestRecord:
    """Record of one request, filled from its head to the end of its answer.

    Attributes:
        request_id: the caller's id if it is safe to log, else one of ours.
        method: HTTP method.
        trace: trace id and span id of the caller (W3C Trace Context), if it sent them.
        route: template of the route that answered, never the path that was requested.
        code: code of the problem that was answered. Empty for other answers.
        model, version, pushes: those of the prediction. Empty and 0 for other answers.
        timings: durations of the phases, in s.
        status: HTTP status. 0: the client left before the answer.
        duration_s: time from the head of the request to the end of its answer, in s.
        time: end of the answer.
    """

    request_id: str
    method: str
    trace: tuple[str, str] | None = None
    route: str = UNKNOWN_ROUTE
    code: str = ""
    model: str = ""
    version: int = 0
    pushes: int = 0
    timings: Timings = field(default_factory=list)
    status: int = 0
    duration_s: float = 0.0
    time: datetime | None = None

    def line(self) -> dict[str, Any]:
        """Return the fields of the log line."""
        line: dict[str, Any] = {
            "time": self.time,
            "request_id": self.request_id,
            "method": self.method,
            "route": self.route,
            "status": self.status,
            "duration_ms": round(self.duration_s * 1000.0, 4),
        }
        for phase, seconds in self.timings:
            name = _PHASE_FIELDS[phase]
            line[name] = round(line.get(name, 0.0) + seconds * 1000.0, 4)
        if self.code:
            line["code"] = self.code
        if self.trace is not None:
            line["trace_id"], line["span_id"] = self.trace
        if self.model:
            line |= {"model": self.model, "version": self.version, "pushes": self.pushes}
        return line


def record_of(scope: MutableMapping[str, Any]) -> RequestRecord:
    """Return the record of the request with this ASGI scope."""
    record: RequestRecord = scope["state"]["record"]
    return record


def attach_record(scope: MutableMapping[str, Any], record: RequestRecord) -> None:
    """Attach a record to the request with this ASGI scope."""
    scope.setdefault("state", {})["record"] = record
