"""Schemas: the JSON bodies of requests and responses, and their conversion to arrays of the domain.

``documents`` parses JSON within bounds. ``body`` is the base of every schema and reads bodies strictly. ``pushes`` has
the prediction requests, with the columns of ``rows`` and the object contexts of ``contexts``, which have the fields of
``shapes`` and ``posteriors``, or one of ``supports``. ``predictions``, ``models``, ``health`` and ``problems`` have the
responses. The OpenAPI document is made of these classes: every field has a description, a unit and an example. Calls
point downward: this package imports ``service.pushing``, ``service.model`` and ``service.errors`` only.
"""
