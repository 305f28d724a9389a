"""Publishing of a finished run as a version of a model in the registry.

``onnx_export`` turns the network into an ONNX graph, ``parity`` compares the two on ``parity_inputs``, ``rivals``
measures the versions before on the same data, ``card`` writes the model card, and ``publish`` puts the version into the
registry. ``shape_publish`` does so for models of any shape, with a ``shape_card``, and ``support_publish`` for a neural
process, with a ``support_card``. Calls point downward: of the trainer, this package imports ``fitting``, ``networks``,
``omnipush`` and ``tables``.
"""
