"""The table of the ONNX forms of all operations.

For each operation of `networks/layers/operations.py` it lists the ONNX operators that are read as
this operation, with a rule for each of them, and the rule that writes the operation.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from async_tnt.networks.onnx import arranging, norms
from async_tnt.networks.onnx import read_rules as read
from async_tnt.networks.onnx import write_rules as write
from async_tnt.networks.onnx.read_rules import ReadRule, plain_layer
from async_tnt.networks.onnx.write_rules import WriteRule, plain_node, window_node


@dataclass(frozen=True)
class OnnxForm:
    """The rules by which an operation is read from ONNX, and written to it.

    Parameters
    ----------
    read : ONNX operator -> the rule that reads its nodes. The attributes or inputs of some nodes
        decide which operation they become. Each of these operations lists the nodes' operator.
    write : the rule that writes a layer of the operation.
    not_read : the reason why no ONNX operator is read as the operation, if none is.
    not_written : the reason why the operation is not written, if it is not.
    """

    read: Mapping[str, ReadRule] = field(default_factory=dict)
    write: WriteRule | None = None
    not_read: str = ""
    not_written: str = ""


FORMS: dict[str, OnnxForm] = {
    "conv": OnnxForm(
        {
            "Conv": read.conv,
            "ConvTranspose": read.conv_transpose,
            "Slice": arranging.cut,
            "ReduceSum": arranging.sum_of_channels,
        },
        write.write_conv,
    ),
    "dense": OnnxForm({"Gemm": read.gemm, "MatMul": read.matmul}, write.write_dense),
    "batch_norm": OnnxForm(
        {
            "BatchNormalization": read.batch_norm,
            "Add": arranging.add,
            "Sum": arranging.add,
            "Mul": arranging.multiply,
            "Sub": arranging.subtract,
            "Neg": arranging.negative,
            "Div": arranging.divide,
        },
        write.write_batch_norm,
    ),
    "relu": OnnxForm({"Relu": plain_layer("relu")}, plain_node("Relu")),
    "leaky_relu": OnnxForm(
        {"LeakyRelu": read.leaky_relu, "Abs": read.absolute}, write.write_leaky_relu
    ),
    "prelu": OnnxForm({"PRelu": read.prelu}, write.write_prelu),
    "clip": OnnxForm({"Clip": read.clip}, write.write_clip),
    "softshrink": OnnxForm({"Shrink": read.shrink}, write.write_softshrink),
    "log1p": OnnxForm({"Log": read.log}, write.write_log1p),
    "sigmoid": OnnxForm({"Sigmoid": plain_layer("sigmoid")}, plain_node("Sigmoid")),
    "tanh": OnnxForm({"Tanh": plain_layer("tanh")}, plain_node("Tanh")),
    "silu": OnnxForm({"Mul": arranging.multiply}, write.write_silu),
    "gelu": OnnxForm({"Gelu": read.gelu}, write.write_gelu),
    "gelu_tanh": OnnxForm({"Gelu": read.gelu}, write.write_gelu_tanh),
    "erf": OnnxForm({"Erf": plain_layer("erf")}, plain_node("Erf")),
    "hardswish": OnnxForm({"HardSwish": plain_layer("hardswish")}, write.write_hardswish),
    "hardsigmoid": OnnxForm(
        {"HardSigmoid": read.hardsigmoid}, plain_node("HardSigmoid", alpha=1 / 6, beta=0.5)
    ),
    "max_pool": OnnxForm({"MaxPool": read.max_pool}, window_node("MaxPool")),
    "average_pool": OnnxForm(
        {"AveragePool": read.average_pool}, window_node("AveragePool", count_include_pad=1)
    ),
    "sum_pool": OnnxForm(
        write=write.write_sum_pool,
        not_read="its two nodes are read as an average_pool and a batch_norm",
    ),
    "inside_average_pool": OnnxForm(
        {"AveragePool": read.average_pool}, window_node("AveragePool", count_include_pad=0)
    ),
    "adaptive_average_pool": OnnxForm(
        write=write.write_adaptive_average_pool,
        not_read="ONNX has no such operator, and its products of matrices with maps are no layers",
    ),
    "global_average_pool": OnnxForm(
        {
            "GlobalAveragePool": plain_layer("global_average_pool"),
            "ReduceMean": read.reduce_mean,
        },
        plain_node("GlobalAveragePool"),
    ),
    "depth_to_space": OnnxForm(
        {"DepthToSpace": arranging.depth_to_space, "Resize": read.resize, "Upsample": read.resize},
        write.write_depth_to_space,
    ),
    "layer_norm": OnnxForm({"LayerNormalization": norms.layer_norm}, norms.write_layer_norm),
    "group_norm": OnnxForm({"InstanceNormalization": norms.instance_norm}, norms.write_group_norm),
    "zero_pad": OnnxForm({"Pad": read.pad}, write.write_pad("constant")),
    "edge_pad": OnnxForm({"Pad": read.pad}, write.write_pad("edge")),
    "bilinear_corners": OnnxForm(
        {"Resize": read.resize, "Upsample": read.resize}, write.write_bilinear_corners
    ),
    "expand": OnnxForm({"Resize": read.resize, "Upsample": read.resize}, write.write_expand),
    "pick": OnnxForm(
        {
            "Slice": arranging.cut,
            "Split": arranging.split,
            "Gather": arranging.gather,
            "Transpose": arranging.transpose,
        },
        write.write_pick,
    ),
    "multiply": OnnxForm({"Mul": arranging.multiply}, plain_node("Mul")),
    "add": OnnxForm(
        {
            "Add": arranging.add,
            "Sum": arranging.add,
            "Sub": arranging.subtract,
            "Unsqueeze": arranging.unsqueeze,
            "ReduceSum": arranging.sum_of_channels,
        },
        plain_node("Sum"),
    ),
    "concat": OnnxForm({"Concat": arranging.concat}, plain_node("Concat", axis=1)),
    "flatten": OnnxForm(
        {"Flatten": arranging.flatten, "Reshape": arranging.reshape}, plain_node("Flatten")
    ),
    "heatmap_centroid": OnnxForm(
        not_read="ONNX has no such operator",
        not_written="a landmark network has no ONNX form",
    ),
}
"""Operation -> its ONNX form."""

NO_LAYERS: dict[str, ReadRule] = {
    "Constant": read.constant,
    "Softmax": read.softmax,
    "Dropout": read.dropout,
    "Identity": read.identity,
}
"""ONNX operator -> the rule of its nodes, for operators that add no layer."""

RULES: dict[str, ReadRule] = {
    operator: rule for form in FORMS.values() for operator, rule in form.read.items()
} | NO_LAYERS
"""ONNX operator -> the rule of its nodes, for all operators that are read."""
