"""CAZSL training: pushes in, fitted networks and published ONNX models out."""
