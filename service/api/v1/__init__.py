"""API ``/v1``: pushes in JSON or beside an image file, and the catalogue of models.

``endpoints`` declares how requests are checked, read and weighed. ``uploads`` reads forms and image files,
``object_contexts`` encodes contexts as tensors, and ``queries`` makes the query that a request asks. ``routes``
documents the endpoints with ``request_examples`` and serves ``catalogue``, the models that can be asked. Calls point
downward: this package imports ``service.api``, ``service.transport`` and the packages below them.
"""
