"""Logs, metrics and traces of requests.

``records`` holds the record of one request, and ``timings`` the phases that fill it. ``telemetry`` begins and ends a
record, ``logs`` makes a line of JSON of it, which ``log_writer`` writes. ``metrics`` counts it in families of
``prometheus``, and ``tracing`` exports it as a span. Calls point downward: this package imports ``service.background``
and the version of the service.
"""
