"""Tables of pushes: one row per push, any objects with outlines, in CSV or Parquet.

``push_table`` is the table in memory, and ``splits`` divides one into training and test. ``files`` finds the files of a
table and bounds them. ``csv_file`` and ``parquet_file`` read batches of rows, and ``columns`` turns them into arrays.
``objects`` reads outlines, ``reading`` a whole table, and ``writing`` writes one. Calls point downward: of the trainer,
this package imports ``omnipush``.
"""
