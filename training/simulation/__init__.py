"""Simulated pushes and drawn views that stand in for the published data.

Any object: ``bodies`` spreads the weight of an outline over feet and draws the conditions of pushes, ``pushing``
simulates pushes of it, quasi-static and vectorised. ``replay`` simulates the pushes of a table. ``approach`` draws
starts and aims around an outline. ``pieces`` cuts it into convex pieces for MuJoCo.

Omnipush: ``solids`` and ``surfaces`` describe objects and plates, ``scene`` builds the MuJoCo model, ``plans`` names
the ways to draw starts and aims, and ``dataset`` simulates pushes. ``drawing`` draws top-down views, and ``camera``
makes them look like photographs. ``exact`` has functions whose values do not depend on the processor. Calls point
downward: of the trainer, this package imports ``omnipush`` and ``tables``.
"""
