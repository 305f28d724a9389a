"""CAZSL serving: verified ONNX models over HTTP, without torch and without the trainer."""

__version__ = "0.1.0"
