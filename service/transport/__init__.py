"""Transport: from a request to an endpoint and back, within limits.

``endpoints`` is the one way from bytes to an answer, and ``fast_path`` takes it without the framework. ``admission``
bounds bodies and concurrent requests by ``shares`` of callers, and gives them ``loop_turns``. ``heads`` checks headers,
``keys`` checks API keys, and ``callers`` names callers. ``threads`` runs work that would block the event loop, in the
order of ``fair_queue``. ``draining`` ends the server without losing a request, and ``problems`` encodes failures. Calls
point downward: this package imports ``service.inference``, ``service.schemas``, ``service.observability``,
``service.processors``, ``service.turns`` and ``service.errors``.
"""
