"""Servers that stand beside ours in ``benchmarks/serving.py``: each a script that takes a port."""
