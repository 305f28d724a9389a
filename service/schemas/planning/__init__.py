"""Schemas of planning: the JSON bodies of questions about several pushes of one object, and of their answers.

``rollouts`` has sequences of pushes, and the object's pose after each of them, ``push_maps`` pushes from all around it,
and ``plans`` pushes to a goal. ``refinements`` has pushes with their outcomes, and the context with what they tell.
Calls point downward: this package imports ``service.schemas`` and the packages below it.
"""
