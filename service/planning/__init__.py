"""Planning: questions about several pushes of one object, answered with arrays and without input or output.

``push_model`` is the protocol of a model of one object, which may be a served model, mechanics or a simulator.
``particles`` are poses of the object that pushes move, with their moments. ``rollout`` predicts sequences of pushes
with them, and ``push_map`` pushes from all around an outline.

``plan`` searches pushes that bring the object to a goal: ``candidates`` are pushes around its outline, ``search``
composes their motions, and ``paths`` are checked against the ``surroundings``, workspace and obstacles.

``refine`` learns from a few pushes about the object's body: it weighs hypotheses of ``bodies``, drawn from
``mixtures``.

The service, the client in process and the benchmarks call the same functions. Calls point downward: this package
imports ``service.pushing``, ``service.model``, ``service.turns`` and ``service.errors``.
"""
