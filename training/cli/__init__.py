"""``cazsl-train``, the command line of the trainer.

``main`` is the command, ``data``, ``simulation``, ``shapes``, ``runs`` and ``reproduction`` hold its subcommands.
``shape_runs`` is the part of ``runs`` for shapes. ``options`` holds the options that several of them share.
``service.cli`` has the form and the output of all commands. Calls point downward: this package may
import every other package of the trainer, and no package imports it.
"""
