"""Omnipush, the benchmark of pushes: its published facts, its objects and its files.

``published`` holds splits and statistics, ``object_identity`` recognises turned objects. ``npy_files`` and ``files``
read and write single files, ``layout`` finds folders, and ``declaration`` handles ``dataset.json``. ``pushes`` and
``views`` read whole folders. Calls point downward: the package imports no other package of the trainer.
"""
