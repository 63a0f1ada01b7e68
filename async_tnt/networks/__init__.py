"""Networks: model files, the compiled networks, and other engines in their place.

    Model, load_model    a configuration, weights and class names, in one .safetensors file
    CompiledClassifier   a Model's classifier, compiled; it computes only what has changed
    CompiledRegressor    a Model's landmark network, compiled
    OnnxClassifier       any ONNX network, run by onnxruntime
    TorchClassifier      any torch module, TorchScript or exported program
    to_onnx              a Model's classifier as an ONNX network
    to_nir               a spiking Model's network as a NIR graph
    spiking_from_rates   a spiking Model of a trained network of ReLUs

A `Processor(config, classifier=...)` takes the two other classifiers. onnx, onnxruntime (extra
`onnx`) and torch are imported only when they are needed.
"""

from async_tnt.networks.loading import bundled_models, load_model
from async_tnt.networks.models.compiled import CompiledClassifier, CompiledRegressor
from async_tnt.networks.models.compiled_network import CompiledNetwork
from async_tnt.networks.models.model import Model
from async_tnt.networks.models.nir_export import to_nir
from async_tnt.networks.models.rate_conversion import spiking_from_rates
from async_tnt.networks.models.torch_modules import TorchClassifier
from async_tnt.networks.onnx.export import to_onnx
from async_tnt.networks.onnx.network import OnnxClassifier

__all__ = [
    "CompiledClassifier",
    "CompiledNetwork",
    "CompiledRegressor",
    "Model",
    "OnnxClassifier",
    "TorchClassifier",
    "bundled_models",
    "load_model",
    "spiking_from_rates",
    "to_nir",
    "to_onnx",
]
