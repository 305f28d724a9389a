"""Bulk prediction: millions of pushes from a Parquet file, on threads, processes or a Ray cluster.

``executors`` runs any independent tasks, so the trainer uses it too. ``chunk`` validates and
predicts rows in columns, ``parquet_file`` reads and writes the tables within the bounds of ``parquet_pages``, and
``predict_file`` joins them.
Calls point downward: this package imports ``service.inference``, ``service.validity``, ``service.storage.disk``,
``service.pushing``, ``service.model`` and ``service.errors``.
"""
