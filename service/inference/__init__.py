"""Models in memory, and the way of a query through one of them.

``loaded_models`` keeps verified versions in line with the registry, ``snapshot`` is the immutable set that one request
uses, ``probing`` runs the self-check of each version, and ``readiness`` judges by the results. ``pushes`` makes rows of
pushes that a model can answer. ``query`` predicts those of a request and encodes the answer. ``pieces`` cuts many
pushes into bounded calls of the runtime, and ``micro_batching`` runs the single pushes of one event loop iteration in
one call. ``object_model`` makes a served model the model of one object that planning asks. Calls point downward: this
package imports ``service.registry``, ``service.storage``, ``service.planning``, ``service.pushing``,
``service.model``, ``service.observability``, ``service.background``, ``service.turns`` and ``service.errors``.
"""
