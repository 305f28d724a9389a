"""Registry of models: versions and aliases in a storage, verified before use.

``registry`` lists, publishes, moves aliases and removes. ``location`` opens a registry by its address. ``verification``
checks every byte of a version, ``draft`` checks one before it is published, ``signing`` makes and checks signatures,
``loading`` brings a version into memory, ``promotion`` runs the gates before an alias moves, and ``doctor`` finds
faults. Calls point downward: this package imports ``service.storage``, ``service.pushing``, ``service.model`` and
``service.errors``.
"""
