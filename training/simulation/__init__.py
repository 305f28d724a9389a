"""Simulated pushes and drawn views that stand in for the published data.

``solids`` and ``surfaces`` describe objects and plates, ``scene`` builds the MuJoCo model, and ``dataset`` simulates
pushes with it. ``drawing`` draws top-down views, and ``camera`` makes them look like photographs. Calls point downward:
of the trainer, this package imports ``omnipush`` alone.
"""
