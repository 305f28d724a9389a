"""One model version: its name, its manifest, its graph, and the predictor that runs the graph.

``reference`` is the grammar of names, aliases and versions. ``manifest`` is the record of a version in the text of
``canonical_json``, read by ``strict_json``, with the tensors and context kinds of ``tensors``. ``onnx_graph`` checks a
graph, in the process of ``trial_process`` that ``trial`` starts and limits. ``predictor`` runs it, ``self_check``
compares a stored output and measures the ``push_cost``, from which the limits of a call follow, and
``loaded_model`` is all of that in memory. ``domain`` is the protocol through which a registry asks for the tensors and
gates of a physical domain, so that no module here knows of pushes. Calls point downward: this package imports
``service.turns``, ``service.processors`` and ``service.errors`` only.
"""
