"""Environments: one object on a table, pushed one push at a time in the world, for planners and for learning.

``tabletop`` simulates the pushes in MuJoCo. ``tasks`` draws objects, starts and goals. ``environment`` is both for
gymnasium, with the extra ``gym``. ``around`` names pushes about an object by three numbers, and ``pictures`` draws the
table from above. Calls point downward: of the trainer, this package imports ``simulation`` and ``shapes``.
"""
