"""ONNX files that are made at random, as other programs write them and as they should not.

They have opsets 9 to 22, old and new forms of attributes, training mode, operations of other
domains, and weights of any type. Each file can be made again from its seed.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

SHAPE = (2, 9, 8)
N_CLASSES = 3


class _Builder:
    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        # only opset 9 has Upsample
        self.opset = int(self.rng.choice([9, 9, *range(9, 23)]))
        self.odd = seed % 3 == 0  # a third of the files
        self.nodes: list[onnx.NodeProto] = []
        self.constants: list[onnx.TensorProto] = []
        self.value = "x"
        self.shape = SHAPE
        self.functions: list[onnx.FunctionProto] = []

    def pick(self, *choices: Any) -> Any:
        return choices[self.rng.integers(len(choices))]

    def chance(self, share: float) -> bool:
        return self.odd and self.rng.random() < share

    def weights(self, *shape: int, low: float = -1.0, dtype: Any = np.float32) -> str:
        """A constant, as initializer or as node."""
        if dtype is np.float32 and self.chance(0.04):
            dtype = self.pick(bool, np.int64, np.complex64, np.float64, np.float16)
        values = self.rng.uniform(low, 1.0, shape).astype(dtype)
        return self.constant(values)

    def constant(self, values: Any) -> str:
        name = f"c{len(self.constants) + len(self.nodes)}"
        tensor = numpy_helper.from_array(np.asarray(values), name)
        if self.pick(True, True, False):
            self.constants.append(tensor)
        else:
            self.nodes.append(helper.make_node("Constant", [], [name], value=tensor))
        return name

    def node(self, op: str, *inputs: str, n_outputs: int = 1, **attributes: Any) -> None:
        name = f"v{len(self.nodes)}"
        if self.chance(0.02):
            attributes["domain"] = "my"
            if self.pick(True, False):
                negative = helper.make_node("Neg", ["a"], ["b"])
                opsets = [helper.make_opsetid("", self.opset)]
                self.functions.append(
                    helper.make_function("my", op, ["a"], ["b"], [negative], opsets)
                )
        outputs = [name, *(f"{name}_{k}" for k in range(1, n_outputs))]
        self.nodes.append(helper.make_node(op, [self.value, *inputs], outputs, **attributes))
        self.value = name

    def window(self, kernel: tuple[int, ...], *, strides: bool = True) -> dict[str, Any]:
        given: dict[str, Any] = {}
        if strides and self.pick(True, False):
            given["strides"] = [self.pick(1, 2), self.pick(1, 2)]
        if self.pick(True, False):
            given["pads"] = [int(self.rng.integers(0, k)) for k in (*kernel, *kernel)]
        elif self.pick(True, False):
            given["auto_pad"] = self.pick("SAME_UPPER", "SAME_LOWER", "VALID", "NOTSET")
        if self.chance(0.2):
            given["auto_pad"] = "VALID"
        return given

    def conv(self) -> None:
        channels = self.shape[0]
        group = self.pick(1, 1, channels)
        kernel = self.pick((3, 3), (1, 1), (2, 3))
        attributes = self.window(kernel)
        filters = group * self.pick(1, 2, 3)
        inputs = [self.weights(filters, channels // group, *kernel)]
        if self.pick(True, False):
            inputs.append(self.weights(filters))
        if self.pick(True, False):
            attributes["kernel_shape"] = [3, 2] if self.chance(0.2) else list(kernel)
        if self.chance(0.3):
            attributes["dilations"] = [2, 1]
        self.node("Conv", *inputs, **attributes, **({"group": group} if group > 1 else {}))

    def batch_norm(self) -> None:
        n = self.shape[0]
        inputs = [self.weights(n), self.weights(n), self.weights(n), self.weights(n, low=0.3)]
        training = self.chance(0.3)
        if training and self.opset >= 14:
            self.node("BatchNormalization", *inputs, n_outputs=self.pick(1, 3), training_mode=1)
        else:
            self.node(
                "BatchNormalization",
                *inputs,
                n_outputs=5 if training else 1,
                epsilon=self.pick(1e-5, 1e-3),
            )

    def clip(self) -> None:
        low = self.pick(None, -0.5, 0.0)
        high = self.pick(None, 1.0, 6.0)
        if self.opset < 11:
            limits = {"min": low, "max": high}
            self.node("Clip", **{name: v for name, v in limits.items() if v is not None})
            return
        shape = ()
        if self.chance(0.2):
            shape = (1,)
        elif self.chance(0.1):
            shape = (2,)
        inputs = []
        for v in (low, high):
            inputs.append("" if v is None else self.constant(np.full(shape, v, np.float32)))
        self.node("Clip", *inputs)

    def dropout(self) -> None:
        if self.opset < 12:
            self.node("Dropout", ratio=0.5, n_outputs=self.pick(1, 2))
            return
        mode = [self.constant(self.chance(0.6))] if self.pick(True, False) else []
        self.node("Dropout", self.constant(np.float32(0.5)), *mode, n_outputs=self.pick(1, 2))

    def pool(self) -> None:
        op = self.pick("MaxPool", "AveragePool")
        kernel = self.pick((2, 2), (2, 3))
        attributes = self.window(kernel)
        if op == "AveragePool":
            attributes["count_include_pad"] = self.pick(0, 1)
        elif self.chance(0.2):
            attributes["dilations"] = [2, 1]
        if self.opset >= 10 and self.chance(0.2):
            attributes["ceil_mode"] = 1
        self.node(op, kernel_shape=list(kernel), **attributes)

    def spread(self) -> None:
        filters = 4 * self.pick(1, 2)
        crd = self.opset >= 11 and not self.chance(0.2)
        self.node("Conv", self.weights(filters, self.shape[0], 1, 1))
        self.node("DepthToSpace", blocksize=2, **({"mode": "CRD"} if crd else {}))

    def transposed(self) -> None:
        group = self.pick(1, 1, self.shape[0])
        side, pads = self.pick((2, 0), (4, 1))
        filters = self.pick(1, 2)
        inputs = [self.weights(self.shape[0], filters, side, side)]
        if self.pick(True, False):
            inputs.append(self.weights(group * filters))
        attributes = {"strides": [2, 2], "pads": [pads] * 4}
        if self.chance(0.2):
            attributes["strides"] = [1, 2]
        self.node("ConvTranspose", *inputs, **attributes, **({"group": group} if group > 1 else {}))

    def grow(self) -> None:
        """An upsampling by the nearest place, in the form of the file's opset."""
        factor = 1.5 if self.chance(0.1) else self.pick(2, 3)
        scales = self.constant(np.array([1, 1, factor, factor], np.float32))
        mode = "linear" if self.chance(0.1) else "nearest"
        if self.opset < 10:
            self.node("Upsample", scales, mode=mode)
        elif self.opset < 11:
            self.node("Resize", scales, mode=mode)
        else:
            roi = self.constant(np.zeros(0, np.float32))
            forms = (
                {"coordinate_transformation_mode": "asymmetric", "nearest_mode": "floor"},
                {"coordinate_transformation_mode": "half_pixel"},
                {},
            )
            self.node("Resize", roi, scales, mode=mode, **self.pick(*forms))

    def frame(self) -> None:
        """A padding of zeros, or of the edge."""
        pads = [
            0,
            0,
            *self.rng.integers(0, 3, 2).tolist(),
            0,
            0,
            *self.rng.integers(0, 3, 2).tolist(),
        ]
        if self.chance(0.2):
            pads[1] = 1
        mode = (
            self.pick("constant", "edge", "reflect") if self.odd else self.pick("constant", "edge")
        )
        if self.opset < 11:
            self.node("Pad", mode=mode, pads=pads)
        else:
            self.node("Pad", self.constant(np.array(pads, np.int64)), mode=mode)

    def every(self) -> None:
        """Some rows or columns, to the last."""
        axis = self.pick(2, 3, -1)
        first = self.pick(0, 1, -1) if self.chance(0.3) else self.pick(0, 1)
        end = 3 if self.chance(0.2) else 1 << 31
        if self.opset < 10:
            self.node("Slice", starts=[first], ends=[end], axes=[axis])
            return
        inputs = [self.constant(np.array([n], np.int64)) for n in (first, end, axis)]
        if self.pick(True, False):
            inputs.append(self.constant(np.array([2], np.int64)))
        self.node("Slice", *inputs)

    def arrange(self) -> None:
        """Some channels, or all in another order."""
        if len(self.shape) != 3:  # a constant of more axes came before
            return
        n = self.shape[0]
        choice = self.pick("gather", "split", "shuffle")
        if choice == "gather":
            most = n + 1 if self.chance(0.1) else n
            indices = self.rng.integers(-most, most, int(self.rng.integers(1, 7)))
            axis = 2 if self.chance(0.1) else 1
            self.node("Gather", self.constant(indices.astype(np.int64)), axis=axis)
        elif choice == "split":
            sizes = [n - n // 2, n // 2] if n > 1 else [1]
            axis = 2 if self.chance(0.1) else self.pick(1, -3)
            if self.opset < 13:
                self.node("Split", n_outputs=len(sizes), axis=axis, split=sizes)
            else:
                given = self.constant(np.int64(sizes))
                self.node("Split", given, n_outputs=len(sizes), axis=axis)
            self.value = self.pick(*self.nodes[-1].output)
        else:
            self.node("Concat", self.value, axis=1)
            rows, columns = self.shape[1:]
            self.node("Reshape", self.constant(np.int64([1, 2, n, rows, columns])))
            perm = [0, 1, 2, 4, 3] if self.chance(0.1) else [0, 2, 1, 3, 4]
            self.node("Transpose", perm=perm)
            self.node("Reshape", self.constant(np.int64([self.pick(1, -1), 2 * n, rows, columns])))

    def norm(self) -> None:
        """A norm over channels, or over groups of them as torch exports it."""
        if len(self.shape) != 3:  # a constant of more axes came before
            return
        n, rows, columns = self.shape
        choice = self.pick("layer", "group", "instance")
        if choice == "layer" and self.opset >= 17:
            self.node("Transpose", perm=[0, 2, 3, 1])
            axis = 1 if self.chance(0.2) else -1
            self.node("LayerNormalization", self.weights(n), self.weights(n), axis=axis)
            if self.pick(True, False):
                self.node("Tanh")
                self.node("MatMul", self.weights(n, n))
                self.node("Add", self.weights(n))
            self.node("Transpose", perm=[0, 3, 1, 2])
        elif choice == "group":
            groups = self.pick(1, n)
            self.node("Reshape", self.constant(np.int64([self.pick(0, 1), groups, -1])))
            ones = self.constant(np.ones(groups, np.float32))
            zeros = self.constant(np.zeros(groups, np.float32))
            self.node("InstanceNormalization", ones, zeros, epsilon=0.01)
            self.node("Reshape", self.constant(np.int64([1, n, rows, columns])))
            self.node("Mul", self.weights(n, 1, 1))
        else:
            self.node("InstanceNormalization", self.weights(n), self.weights(n))
        if self.opset >= 9 and self.pick(True, False):
            self.node("Erf")

    def affine(self) -> None:
        n = self.shape[0]
        rest = [1] * (len(self.shape) - 1)
        shape = self.pick((), (1,), (n, *rest), (1, n, *rest), (1,) * 4)
        if self.chance(0.3):
            shape = self.pick((self.shape[-1],), (1, 1, 1, n, *rest), (2, n, *rest))
        if self.chance(0.5):
            self.node(self.pick("Neg", "Abs"))
        if self.chance(0.1) and len(self.shape) == 3:
            axes = self.pick([1], [-3], [2] if self.chance(0.3) else [1])
            before = self.value
            if self.opset < 13:
                self.node("ReduceSum", axes=axes, keepdims=1)
            else:
                self.node("ReduceSum", self.constant(np.int64(axes)), keepdims=1)
            self.node("Tanh")
            self.node("Mul", before)
        op = self.pick("Add", "Mul", "Sub", "Div")
        # a quotient by a small number would make rounding large
        self.node(op, self.weights(*shape, **({"low": 0.3} if op == "Div" else {})))

    def function(self) -> None:
        before = self.value
        op = self.pick(
            "Sigmoid", "Tanh", "HardSigmoid", "HardSwish", "Gelu", "SiLU", "Log1p", "Shrink"
        )
        if self.opset >= 20 and self.pick(True, False):  # no older one has it
            op = "Gelu"
        if op == "SiLU":
            self.node("Sigmoid")
            factor = self.value
            self.value, other = self.pick((before, factor), (factor, before))
            self.node("Mul", other)
        elif op == "Log1p":
            self.node("Relu")
            self.node("Add", self.constant(np.float32(2.0 if self.chance(0.3) else 1.0)))
            self.node("Log")
        elif op == "HardSigmoid":
            self.node(op, **({} if self.chance(0.5) else {"alpha": 1 / 6, "beta": 0.5}))
        elif op == "Shrink":
            limit = self.pick(0.5, 0.3, 0.0)
            self.node(op, lambd=limit, **({} if self.chance(0.5) else {"bias": limit}))
        elif op == "Gelu":
            self.node(op, **({"approximate": "tanh"} if self.pick(True, False) else {}))
        else:
            self.node(op)

    def activation(self) -> None:
        n = self.shape[0]
        rest = [1] * (len(self.shape) - 1)
        slopes = self.pick((n, *rest), (1,), (1, *rest))
        self.pick(
            lambda: self.node("Relu"),
            lambda: self.node("LeakyRelu", **self.pick({}, {"alpha": 0.3})),
            lambda: self.node(
                "PRelu", self.weights(*((self.shape[-1],) if self.chance(0.2) else slopes))
            ),
            self.clip,
            self.dropout,
            *3 * [self.function],
            lambda: self.node("Identity"),
        )()

    def join(self) -> None:
        before = self.value
        self.activation()
        if len(self.shape) == 3 and self.chance(0.15):
            self.add_stacked(before)
        elif self.pick(True, False):
            self.node(self.pick("Add", "Sum", "Sub"), before)
        elif self.pick(True, False):
            self.node("Tanh")
            self.node("Mul", before)
        else:
            self.node("Concat", before, axis=self.pick(1, 1, 1, -3, 2))

    def add_stacked(self, other: str) -> None:
        """The sum of two maps, which are stacked before."""
        after = self.value
        stacked = []
        for self.value in (other, after):
            self.along_first_axis("Unsqueeze")
            stacked.append(self.value)
        self.node("Concat", stacked[0], axis=0)
        self.along_first_axis("ReduceSum", keepdims=0)

    def along_first_axis(self, op: str, **attributes: int) -> None:
        if self.opset < 13:
            self.node(op, axes=[0], **attributes)
        else:
            self.node(op, self.constant(np.int64([0])), **attributes)

    def flatten(self) -> None:
        choice = self.pick("pool", "mean", "flatten", "reshape")
        n = int(np.prod(self.shape))
        if choice == "mean":
            axes = self.pick([2, 3], [-2, -1], [3, 2])
            keep = self.pick(0, 1)
            if self.opset < 18:
                self.node("ReduceMean", axes=axes, keepdims=keep)
            else:
                self.node("ReduceMean", self.constant(np.int64(axes)), keepdims=keep)
            if not keep:
                return
        elif choice == "pool":
            self.node("GlobalAveragePool")
        if choice != "reshape":
            self.node(
                "Flatten", **self.pick({}, {"axis": 1}, {"axis": 2} if self.chance(0.3) else {})
            )
            return
        shape = self.pick([1, -1], [0, -1], [-1, n], [1, n])
        if self.chance(0.3):
            shape = self.pick([2, -1], [-1, max(n // 2, 1)], [0, n // 2 or 1])
        allow = {"allowzero": 1} if self.opset >= 14 and self.chance(0.3) else {}
        self.node("Reshape", self.constant(np.int64(shape)), **allow)

    def dense(self, n: int, units: int) -> None:
        if self.pick(True, False):
            self.node("MatMul", self.weights(n, units))
            return
        transposed = self.pick(0, 1)
        weight = self.weights(*((units, n) if transposed else (n, units)))
        bias = (
            [self.weights(*self.pick((units,), (1, units), (1,), ()))]
            if self.pick(True, False)
            else []
        )
        odd = self.pick({"alpha": 0.5}, {"beta": 2.0}, {}) if self.chance(0.3) else {}
        self.node("Gemm", weight, *bias, **({"transB": 1} if transposed else {}), **odd)

    def softmax(self) -> None:
        self.node(
            "Softmax",
            **self.pick({}, {"axis": 1}, {"axis": -1}, {"axis": 0} if self.chance(0.5) else {}),
        )

    def file(self, output_shape: list[str] | None = None) -> onnx.ModelProto:
        opsets = [helper.make_opsetid("", self.opset), helper.make_opsetid("my", 1)]
        given = [helper.make_tensor_value_info("x", TensorProto.FLOAT, [self.pick(1, "N"), *SHAPE])]
        output = helper.make_tensor_value_info(self.value, TensorProto.FLOAT, output_shape)
        graph = helper.make_graph(self.nodes, "made", given, [output], self.constants)
        return helper.make_model(
            graph, opset_imports=opsets, ir_version=8, functions=self.functions[:1]
        )


def _shape(proto: onnx.ModelProto) -> tuple[int, ...] | None:
    """(C, H, W) or (N,) of the output, by ONNX's own rules; None where they do not tell."""
    try:
        output = onnx.shape_inference.infer_shapes(proto).graph.output[0].type.tensor_type.shape.dim
    except Exception:  # a wrong file raises errors of many types
        return None
    sides = tuple(side.dim_value for side in output)[1:]
    return sides if sides and min(sides) > 0 else None


def _values(proto: onnx.ModelProto) -> dict[str, np.ndarray]:
    """The constants of a file by name."""
    tensors = [*proto.graph.initializer]
    tensors += [node.attribute[0].t for node in proto.graph.node if node.op_type == "Constant"]
    return {tensor.name: numpy_helper.to_array(tensor) for tensor in tensors}


def _shapes(proto: onnx.ModelProto) -> dict[str, list[int]]:
    """The shape of each value, by ONNX's own rules, where they tell; 0 for an open side."""
    graph = onnx.shape_inference.infer_shapes(proto).graph
    values = [*graph.input, *graph.value_info, *graph.output]
    return {
        value.name: [side.dim_value for side in value.type.tensor_type.shape.dim]
        for value in values
    }


class _Of:
    """A node as the rules below see it: attributes, constant inputs, the shape of its first map."""

    def __init__(
        self, node: onnx.NodeProto, values: dict[str, np.ndarray], shapes: dict[str, list[int]]
    ) -> None:
        self.op = node.op_type
        self.domain = node.domain
        self.n_outputs = len(node.output)
        self.attributes = {one.name: helper.get_attribute_value(one) for one in node.attribute}
        self.constants = [values[name] for name in node.input if name in values]
        self.sources = [name for name in node.input if name and name not in values]
        self.source = shapes.get(self.sources[0], []) if self.sources else []

    def get(self, name: str, default: Any) -> Any:
        value = self.attributes.get(name, default)
        return value.decode() if isinstance(value, bytes) else value


def _pads_otherwise(of: _Of) -> bool:
    """`auto_pad` beside `pads`, or with a stride, where the sides of the input decide."""
    auto_pad = of.get("auto_pad", "NOTSET")
    has_stride = list(of.get("strides", [1, 1])) != [1, 1]
    return (auto_pad.startswith("SAME") and has_stride) or (
        auto_pad != "NOTSET" and any(of.get("pads", [0]))
    )


def _pools_otherwise(of: _Of) -> bool:
    is_dilated = list(of.get("dilations", [1, 1])) != [1, 1]
    pads = of.get("pads", [0] * 4)
    sides = [side + pads[k] + pads[2 + k] for k, side in enumerate(of.source[2:4])]
    is_larger = any(
        k > side > 0 for k, side in zip(of.get("kernel_shape", []), sides, strict=False)
    )
    return _pads_otherwise(of) or is_dilated or is_larger or of.get("ceil_mode", 0) == 1


def _reshapes_otherwise(of: _Of) -> bool:
    """Whether a node reshapes to anything but one row for each volume, or a shuffle."""
    if of.constants[0].size > 2:
        return False
    rows, n = of.constants[0].tolist()
    one_row = [-1, int(np.prod(of.source[1:]))]
    if rows == 0 and of.get("allowzero", 0) == 1:
        return True
    is_free = rows in (0, 1) and n in one_row
    return not (is_free or (rows == -1 and n == one_row[1]))


def _trains(of: _Of) -> bool:
    return of.get("training_mode", 0) == 1 or of.n_outputs > 1


def _grows_otherwise(of: _Of) -> bool:
    factors = of.constants[-1].tolist() if of.constants else []
    is_other = of.get("mode", "nearest") != "nearest"
    return is_other or 1.5 in factors


def _pads_as_no_layer(of: _Of) -> bool:
    pads = of.get("pads", None) or of.constants[0].tolist()
    return of.get("mode", "constant") == "reflect" or any(pads[:2])


def _takes_nothing(of: _Of) -> bool:
    """Whether a Slice takes no row or column."""
    numbers = [*of.get("starts", []), *of.get("ends", []), *of.get("axes", [])]
    numbers += [int(constant[0]) for constant in of.constants[:3]]
    first, end, axis = numbers
    return len(of.source) == 4 and not len(range(of.source[axis])[first:end])


GAPS = {
    "Conv": lambda of: _pads_otherwise(of) or of.get("kernel_shape", []) == [3, 2],
    "MaxPool": _pools_otherwise,
    "AveragePool": _pools_otherwise,
    "ConvTranspose": lambda of: of.get("strides", [1, 1]) == [1, 2],
    "Pad": _pads_as_no_layer,
    "Slice": _takes_nothing,
    "Div": lambda of: any((constant == 0).any() for constant in of.constants),
    "ReduceSum": lambda of: 2 in (of.get("axes", None) or of.constants[0].tolist()),
    "Gather": lambda of: of.get("axis", 0) != 1,
    "Split": lambda of: of.get("axis", 0) not in (1, -3),
    "Transpose": lambda of: list(of.get("perm", [])) == [0, 1, 2, 4, 3],
    "LayerNormalization": lambda of: of.get("axis", -1) != -1,
    "Resize": _grows_otherwise,
    "Upsample": _grows_otherwise,
    "Concat": lambda of: of.get("axis", 0) not in ((1, -3) if len(of.source) < 5 else (0,)),
    "Flatten": lambda of: of.get("axis", 1) != 1,
    "Reshape": _reshapes_otherwise,
    "HardSigmoid": lambda of: "alpha" not in of.attributes,
    "Shrink": lambda of: of.get("lambd", 0.5) != of.get("bias", 0.0),
    "Gemm": lambda of: of.get("alpha", 1.0) != 1.0 or of.get("beta", 1.0) != 1.0,
    "BatchNormalization": _trains,
    "Clip": lambda of: any(limit.shape != () for limit in of.constants),
    "Dropout": lambda of: len(of.constants) == 2 and bool(of.constants[1].any()),
    "Softmax": lambda of: of.get("axis", 1) == 0 or len(of.source) == 4,
}
"""Operation -> the forms of it that have no layer."""
BY_CHANNEL = "Add", "Mul", "Sub", "Div", "Neg", "PRelu", "BatchNormalization"
"""Operations with a number for each channel."""


def add_inner_output(proto: onnx.ModelProto, seed: int) -> None:
    """Let a random map inside a network be its second output, if its shape is known."""
    try:
        inferred = onnx.shape_inference.infer_shapes(proto)
    except Exception:  # a wrong file raises errors of many types
        return
    names = [node.output[0] for node in proto.graph.node if node.op_type != "Constant"]
    maps = [
        value
        for value in inferred.graph.value_info
        if len(value.type.tensor_type.shape.dim) == 4 and value.name in names
    ]
    if maps:
        place = np.random.default_rng(seed).integers(len(maps))
        proto.graph.output.add().CopyFrom(maps[place])


def known_gaps(proto: onnx.ModelProto) -> list[str]:
    """Why a file may be refused: from what `load_model` says it reads, and from ONNX's own rules.

    Where there is no reason, it must be accepted, unless onnxruntime refuses it.
    """
    try:
        onnx.checker.check_model(proto)
        shapes = _shapes(proto)
    except Exception:  # a wrong file raises errors of many types
        return ["no valid file"]
    values = _values(proto)
    found = []
    flattened: set[str] = set()  # maps of several places, without a dense layer since
    plus_one: set[str] = set()
    for node in proto.graph.node:
        of = _Of(node, values, shapes)
        if of.domain == "my" or GAPS.get(of.op, lambda of: False)(of):
            found.append(f"a form of {of.op}")
        if _has_other_constants(of):
            found.append(f"constants of {of.op}")
        if of.op == "Log" and of.sources[0] not in plus_one:
            found.append("a logarithm of other than x + 1")
        if of.op in BY_CHANNEL and of.constants and flattened.intersection(of.sources):
            found.append("a number for each place of a flattened map")
        flattens = of.op in ("Flatten", "Reshape") and max(of.source[2:], default=1) > 1
        passes_on = of.op not in ("Gemm", "MatMul") and flattened.intersection(of.sources)
        if flattens or passes_on:
            flattened.add(node.output[0])
        if of.op == "Add" and of.constants and (of.constants[0] == 1.0).all():
            plus_one.add(node.output[0])
    return found


def _has_other_constants(of: _Of) -> bool:
    """Whether a constant has another type, or neither one number nor one for each channel."""
    whole = (
        "Constant",
        "Reshape",
        "ReduceMean",
        "Dropout",
        "Pad",
        "Slice",
        "Gather",
        "Split",
        "ReduceSum",
        "Unsqueeze",
    )
    if of.op not in whole and any(constant.dtype != np.float32 for constant in of.constants):
        return True
    if of.op not in ("Add", "Sum", "Sub", "Mul", "Div", "PRelu") or not of.constants:
        return False
    sides = list(of.constants[0].shape)
    if len(sides) > len(of.source):
        return True
    while sides[:1] == [1]:
        sides = sides[1:]
    return bool(sides) and sides != [*of.source[1:2], *[1] * (len(of.source) - 2)]


def random_onnx(seed: int) -> onnx.ModelProto:
    """A network of one input (1 or N, *SHAPE), whose output is (1, N_CLASSES) in most cases."""
    builder = _Builder(seed)
    steps = (
        builder.batch_norm,
        builder.pool,
        builder.affine,
        builder.activation,
        builder.join,
        builder.spread,
        builder.transposed,
        builder.grow,
        builder.frame,
        builder.every,
        builder.arrange,
        builder.norm,
    )
    for _ in range(builder.rng.integers(0, 6)):
        before = list(builder.nodes), builder.value
        builder.pick(*2 * [builder.conv], *steps)()
        shape = _shape(builder.file())
        if shape is None and not builder.odd:  # a window larger than the map
            builder.nodes, builder.value = before
        builder.shape = shape or builder.shape
    builder.flatten()
    shape = _shape(builder.file())
    n = int(np.prod(shape or (builder.shape[0],)))
    if builder.pick(True, False):
        builder.shape = (n,)
        builder.pick(builder.activation, builder.affine)()
    builder.dense(n, N_CLASSES)
    if builder.pick(True, False):
        builder.shape = (N_CLASSES,)
        builder.affine()
    if builder.pick(True, False, False):
        builder.softmax()
    return builder.file(["a", "b"])
