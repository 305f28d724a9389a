"""Transport: from the bytes of a connection to an endpoint, and back.

``endpoints`` is the one way from bytes to an answer, and ``fast_path`` takes it without the framework. ``connection``
reads HTTP with the bounds of ``head_clock``, ``draining`` ends the server without losing a request, ``admission``
bounds bodies and concurrent requests, and gives them ``loop_turns``. ``keys`` checks API keys, ``callers`` names
callers, ``threads`` runs work that would block the event loop, in the order of ``fair_queue``, and ``problems`` encodes
failures. Calls point downward: this package imports ``service.inference``,
``service.schemas``, ``service.observability``, ``service.processors``, ``service.turns`` and ``service.errors``.
"""
