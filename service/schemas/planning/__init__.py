"""Schemas of planning: the JSON bodies of questions about several pushes of one object, and of their answers.

``rollouts`` has sequences of pushes, and the object's pose after each of them. Calls point downward: this package
imports ``service.schemas`` and the packages below it.
"""
