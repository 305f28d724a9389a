"""The ``cazsl`` command line: serve predictions, predict, and manage the registry.

``main`` is the group of all commands. ``serve``, ``config``, ``predict`` (with ``predict_parquet``), ``keys``,
``models`` and ``model_changes`` hold one command or group each. ``configuration`` merges options, environment and
file, and ``terminal`` has the options, the output and the exit statuses that commands share. Calls point downward:
commands import any other package of the service, and no package imports them.
"""
