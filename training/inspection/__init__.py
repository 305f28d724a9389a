"""Inspection of folders of pushes: checks, reports and galleries.

``statistics`` compares a dataset with the published figures, ``findings``, ``object_lists`` and ``views`` check it, and
``inspection`` runs all checks. ``text`` prints an inspection. ``dataset_page`` and ``view_gallery`` draw pages and
images with matplotlib. Calls point downward: of the trainer, this package imports ``simulation`` and ``omnipush``.
"""
