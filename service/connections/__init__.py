"""Connections: HTTP/1.1 over sockets (RFC 9110 and 9112), one request at a time, with bounds of time, bytes and number.

``connection`` reads requests, and ``framing`` finds where heads and bodies end. ``lifecycle`` ends connections,
and ``listener`` has what they share. ``shortcut_connection`` answers plain single pushes without ASGI. ``head_clock``
bounds the wait for a head, ``unsent`` cuts off clients that do not read, and ``open_connections`` bounds the number of
connections. Calls point downward: this package imports ``service.transport`` and ``service.errors``.
"""
