"""API ``/v2``: the Open Inference Protocol, for clients that implement it already.

``endpoints`` declares the inference endpoints and decompresses bodies, ``bodies`` has the schemas, and ``wire`` reads
and writes tensors as JSON or raw bytes. ``queries`` makes the query that a request asks, with the tensors that
``contexts`` checks, and ``routes`` documents the endpoints and serves health and metadata. Calls point downward: this
package imports ``service.api``, ``service.transport`` and the packages below them.
"""
