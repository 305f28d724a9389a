"""Families of random outlines, as objects on a table have them, and random objects with such outlines.

``pieces`` holds rectangles, discs, rounding and unions. ``polygons``, ``letters``, ``tools`` and ``blobs`` draw the
proportions of each family, and ``families`` names them. ``outlines`` gives an outline its size, orientation and origin.
``objects`` adds centre of mass, mass, friction and pusher, ``dataset`` simulates their pushes into a table, and
``gallery`` draws pictures of them. Calls point downward: of the trainer, this package imports ``omnipush``, ``tables``
and ``simulation``.
"""
