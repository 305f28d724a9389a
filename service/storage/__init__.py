"""Storage of models: where the bytes of a registry lie, and how each change becomes visible.

``base`` is the protocol. ``folder_storage`` and ``folder_writer`` implement it on a plain disk, ``bucket_storage`` in
an S3-compatible bucket (``bucket``) with a cache on the disk (``bucket_cache``). ``bucket_state`` is the content of the
one object that makes changes visible, and ``bucket_causes`` puts failures of a store into words. ``history`` is the
chain of ``events`` that both storages keep, ``survey`` finds entries outside of the layout, and ``disk`` has bounded
reads and synced writes. Calls point downward: this package imports
``service.model`` and ``service.errors`` only.
"""
