"""Inspection of tables of pushes: checks against the laws that any push obeys, and report pages.

``geometry`` measures every push against the outline of its object, before and after. ``frames`` finds other units and
frames, ``findings`` all other faults, and ``inspection`` runs the checks. ``text`` prints an inspection. ``figures``
and ``page`` draw a table with matplotlib. Calls point downward: of the trainer, this package imports ``inspection``,
``tables`` and ``omnipush``.
"""
