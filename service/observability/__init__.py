"""Logs, metrics and traces of requests.

``records`` holds the record of one request, and ``timings`` the phases that fill it. ``telemetry`` begins and ends a
record, ``logs`` writes it as a line of JSON, ``metrics`` counts it in families of ``prometheus``, and ``tracing``
exports it as a span. Calls point downward: this package imports no other module of the service, only its version.
"""
