"""Fitting of a network to pushes, and its evaluation.

``recipe`` reads the settings of a run, ``samples`` and ``augmentation`` prepare its data. ``training_loop`` minimises
the ``losses``, with gradients from ``sharded_gradients`` or a ``neural_process_step``, and keeps its state in a
``run_folder``. ``evaluation`` computes held-out figures, and ``bands`` calibrates them and splits them by band.
``shape_samples`` prepares tables of shapes, and ``shape_evaluation`` measures and calibrates on them. Calls point
downward: of the trainer, this package imports ``networks``, ``omnipush``, ``tables`` and ``recipes``.
"""
