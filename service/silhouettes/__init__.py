"""Silhouettes: from a picture of an object to its outline in metres.

``search`` is the way in: ``find_outline`` takes a picture and its scale. ``masks`` recognises pictures that are masks,
and ``segmentation`` separates an object from the table in a photograph, with the light on the table from ``tables``,
colours from ``mixtures`` and filters from ``planes``. ``tracing`` turns either into polygons, and ``faults`` words the
refusals. Calls point downward: this package imports ``service.pushing``, ``service.turns`` and ``service.errors`` only.
"""
