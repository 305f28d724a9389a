"""Peer servers for ``benchmarks/serving.py``, each a script that takes a port."""
