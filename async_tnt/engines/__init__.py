"""Other engines for the networks: onnxruntime and torch, as callables from a volume to logits.

    OnnxClassifier      any ONNX network by onnxruntime: `Processor(config, classifier=OnnxClassifier("net.onnx"))`
    OnnxRegressor       the same for landmarks: raw volume -> (x, y), `Processor(..., regressor=OnnxRegressor(...))`
    TorchClassifier     any torch module, TorchScript or exported program
    to_onnx             a Model's classifier as an ONNX network; `regressor_to_onnx` its landmark network

Nothing here is needed to run a Model: `Processor(model)` compiles its networks itself. onnx, onnxruntime (extra `onnx`)
and torch are imported only when something of them is asked.
"""

from .onnx_export import regressor_to_onnx, to_onnx
from .onnx_network import OnnxClassifier, OnnxRegressor
from .torch_network import TorchClassifier

__all__ = ["OnnxClassifier", "OnnxRegressor", "TorchClassifier", "regressor_to_onnx", "to_onnx"]
