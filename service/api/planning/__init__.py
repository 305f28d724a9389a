"""API of planning, under ``/v1``: questions about several pushes of one object.

``endpoints`` declares how requests are checked and read, ``objects`` finds the model of the object that they are about,
``rollout``, ``push_map``, ``plan`` and ``refine`` answer, and ``answers`` writes their JSON. ``routes`` documents the
endpoints with ``request_examples``. Calls point downward: this package imports ``service.api.v1``, ``service.api`` and
the packages below them.
"""
