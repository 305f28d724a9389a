"""API: the routes of FastAPI and their documentation.

``v1`` is our protocol, with ``planning`` for several pushes, and ``open_inference`` the Open Inference Protocol. Their
routes answer through ``endpoint_route``. ``health`` has the routes of health and metrics, ``gauges`` the readings
behind the metrics and ``scrapes`` their text. ``docs_page`` has the page of documentation, and ``openapi`` the examples
in its document. ``path_prefix`` strips the prefix of a proxy. ``dependencies`` gives routes the parts of the
application, and ``error_handlers`` answers failures as problems. Calls point downward: this package imports
``service.transport``, ``service.inference``, ``service.schemas``, ``service.observability``, ``service.background`` and
``service.errors``.
"""
