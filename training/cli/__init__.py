"""``cazsl-train``, the command line of the trainer.

``main`` is the command, ``data``, ``simulation``, ``runs`` and ``reproduction`` hold its subcommands. ``options`` holds
the options that several of them share, and ``errors`` turns errors into one line. Calls point downward: this package
may import every other package of the trainer, and no package imports it.
"""
