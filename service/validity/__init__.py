"""Validity: warnings that come with an answer, for pushes, objects and pictures that a version does not vouch for.

``codes`` names the warnings, and ``pictures`` has those of pictures. ``known_objects`` has the geometry of an object
that a context describes, from its four sides or from the silhouette in its view, and ``contact`` finds the pushes that
never touch it or start inside it. ``views`` compares a view with those of Omnipush's objects, and ``omnipush`` says
whether a context is one of them. ``domains`` has the domain of a version: that of its manifest, or of its training for
versions that were published without one. ``judging`` puts them together, and ``rollouts`` judges pushes that particles
meet, and ``refinements`` those that tell of an object. Calls point downward: this package imports ``service.pushing``
and ``service.model`` only.
"""
