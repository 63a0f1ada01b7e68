"""Layers from ONNX files and models into them; ONNX Runtime as a classifier."""
