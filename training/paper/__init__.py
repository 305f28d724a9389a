"""Reproduction of the paper's experiments.

``experiments`` lists tables and claims of the paper, and ``gaussian_process`` draws the data of its regression.
``reproduction`` runs an experiment, on other machines by means of ``run_transfer``. ``figures`` and ``report`` write
the results. ``options`` holds the options of the command, and ``rebuild`` runs all experiments that they name. Calls
point downward: of the trainer, this package imports ``fitting``, ``networks`` and ``omnipush``.
"""
