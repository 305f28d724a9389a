"""The ``cazsl`` command line: serve predictions, predict, and manage the registry.

``main`` is the group of all commands. ``serve``, ``config``, ``predict`` (with ``predict_parquet``), ``keys``,
``models``, ``model_checks`` and ``model_changes`` hold one command or group each. ``registries`` opens a registry as
the service does. ``configuration`` merges options, environment and file. ``command_line`` has the form of commands,
options and arguments, and turns every fault into one line. ``terminal`` writes all output. The trainer's commands use
these two. Calls point downward: commands import any other package of the service, and no other package of the service
imports them.
"""
