"""CAZSL training: from folders of pushes to published ONNX models.

Packages, each of which imports only packages before it: ``omnipush`` reads and writes the data, ``tables`` those of
any other objects, ``simulation`` makes stand-ins for them, and ``inspection`` checks them. ``networks`` holds the
models, ``fitting`` trains and evaluates them by the ``recipes``, ``publishing`` exports them, ``paper`` reproduces the
paper, and ``cli`` is the command line. Of the service, the trainer imports the packages that need neither a server nor
a client.
"""
