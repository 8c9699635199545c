"""Check a network of ONNX before it runs: it computes, in bounded time and memory, and does nothing else."""

from __future__ import annotations

import math
from typing import Any, Final

import onnx
from onnx import AttributeProto, TensorProto

from shape_obs.policy.contract import PolicyError

#: Bytes of the file, and of all values that the network computes in a step.
MOST_BYTES: Final = 128 << 20
_MOST_COMPUTED: Final = 64 << 20
#: Multiplications of a step: a tenth of a second on one core.
_MOST_WORK: Final = 2e9
_MOST_NODES: Final = 5000
_ITEM_BYTES: Final = 8  # of the widest type
_DOMAINS: Final = ("", "ai.onnx")
#: Operators without subgraphs, randomness, texts, sequences or results of unknown shape.
_OPERATORS: Final = frozenset({
    "Abs", "Add", "And", "ArgMax", "ArgMin", "AveragePool", "BatchNormalization", "Cast", "CastLike", "Ceil", "Celu",
    "Clip", "Concat", "Constant", "ConstantOfShape", "Conv", "Cos", "CumSum", "Div", "Elu", "Equal", "Erf", "Exp",
    "Expand", "Flatten", "Floor", "GRU", "Gather", "GatherElements", "GatherND", "Gelu", "Gemm", "GlobalAveragePool",
    "GlobalMaxPool", "Greater", "GreaterOrEqual", "GroupNormalization", "HardSigmoid", "HardSwish", "Identity",
    "InstanceNormalization", "IsInf", "IsNaN", "LSTM", "LayerNormalization", "LeakyRelu", "Less", "LessOrEqual", "Log",
    "LogSoftmax", "MatMul", "Max", "MaxPool", "Mean", "Min", "Mish", "Mod", "Mul", "Neg", "Not", "OneHot", "Or",
    "PRelu", "Pad", "Pow", "RMSNormalization", "RNN", "Range", "Reciprocal", "ReduceL1", "ReduceL2", "ReduceLogSum",
    "ReduceLogSumExp", "ReduceMax", "ReduceMean", "ReduceMin", "ReduceProd", "ReduceSum", "ReduceSumSquare", "Relu",
    "Reshape", "Round", "Selu", "Shape", "Sigmoid", "Sign", "Sin", "Size", "Slice", "Softmax", "Softplus", "Softsign",
    "Split", "Sqrt", "Squeeze", "Sub", "Sum", "Swish", "Tan", "Tanh", "ThresholdedRelu", "Tile", "TopK", "Transpose",
    "Trilu", "Unsqueeze", "Where", "Xor",
})  # fmt: skip


def check_graph(data: bytes) -> onnx.ModelProto:
    """Read a network and refuse one that could do more than compute a small result from its inputs.

    Returns:
        The network, with a batch of 1 and the shapes of all values.

    Raises:
        PolicyError: The message gives the reason. Damaged files raise what onnx and protobuf raise.
    """
    if len(data) > MOST_BYTES:
        raise PolicyError(f"expected a network of at most {MOST_BYTES} bytes, got {len(data)}.")
    model = onnx.load_model_from_string(data)
    _check_parts(model)
    for value in model.graph.input:
        for side in list(value.type.tensor_type.shape.dim)[:1]:
            side.dim_value = side.dim_value or 1
    # Shapes that the file claims are inferred again.
    del model.graph.value_info[:]
    for value in model.graph.output:
        value.type.tensor_type.ClearField("shape")
    model = onnx.shape_inference.infer_shapes(model, check_type=True, strict_mode=True, data_prop=True)
    onnx.checker.check_model(model)
    _check_cost(model.graph)
    return model


def _check_parts(model: onnx.ModelProto) -> None:
    """Refuse operators, kinds of tensors and parts of a file that no policy needs."""
    nodes, tensors = model.graph.node, list(model.graph.initializer)
    if model.functions or model.graph.sparse_initializer:
        raise PolicyError("the network has functions or sparse tensors; export it with optimize=True.")
    if len(nodes) > _MOST_NODES:
        raise PolicyError(f"expected at most {_MOST_NODES} operators, got {len(nodes)}.")
    for node in nodes:
        if node.domain not in _DOMAINS or node.op_type not in _OPERATORS:
            raise PolicyError(f"the operator {f'{node.domain[:40]}.{node.op_type[:40]}'.strip('.')} is not allowed.")
        if any(attribute.type == AttributeProto.SPARSE_TENSOR for attribute in node.attribute):
            raise PolicyError(f"the operator {node.op_type} has a sparse tensor.")
        tensors += [attribute.t for attribute in node.attribute if attribute.type == AttributeProto.TENSOR]
    for tensor in tensors:
        if tensor.data_location == TensorProto.EXTERNAL or tensor.external_data:
            raise PolicyError(f"the tensor {tensor.name!r:.80} is in another file; save the network with its weights.")
        if tensor.data_type == TensorProto.STRING or min(tensor.dims, default=0) < 0:
            raise PolicyError(f"the tensor {tensor.name!r:.80} holds texts, or has sides below 0.")
        if math.prod(tensor.dims) > MOST_BYTES:
            raise PolicyError(f"the tensor {tensor.name!r:.80} has the shape {list(tensor.dims)[:8]}.")


def _check_cost(graph: onnx.GraphProto) -> None:
    """Refuse values of unknown or large size, and long computations."""
    shapes: dict[str, tuple[int, ...]] = {tensor.name: tuple(tensor.dims) for tensor in graph.initializer}
    for value in (*graph.input, *graph.value_info, *graph.output):
        kind: Any = value.type.tensor_type
        sides = [side.dim_value if side.HasField("dim_value") else -1 for side in kind.shape.dim]
        if kind.HasField("shape") and min(sides, default=0) >= 0:
            shapes[value.name] = tuple(sides)
    names = {name for node in graph.node for name in (*node.input, *node.output)} | {
        value.name for value in graph.input
    }
    unknown = names - shapes.keys() - {""}
    if unknown:
        raise PolicyError(f"the size of {min(unknown)!r:.80} is unknown before the network runs.")
    sizes = {"": 0, **{name: math.prod(shape) for name, shape in shapes.items()}}
    results = {name for node in graph.node for name in node.output} | {value.name for value in graph.input}
    computed = sum(sizes[name] for name in results) * _ITEM_BYTES
    work = sum(_work(node, shapes, sizes) for node in graph.node)
    if computed > _MOST_COMPUTED or work > _MOST_WORK:
        most = f"{_MOST_COMPUTED} bytes and {_MOST_WORK:.0g} multiplications"
        raise PolicyError(f"expected at most {most} in a step, got {computed} and {work:.3g}.")


def _work(node: onnx.NodeProto, shapes: dict[str, tuple[int, ...]], sizes: dict[str, int]) -> int:
    """Estimate the number of multiplications of an operator, from above."""
    result = sizes[node.output[0]]
    if node.op_type in ("MatMul", "Gemm"):
        return result * max(shapes[node.input[0]] or (1,))
    if node.op_type == "Conv":
        return result * math.prod(shapes[node.input[1]][1:])
    if node.op_type in ("LSTM", "GRU", "RNN"):
        return math.prod(shapes[node.input[0]][:2]) * (sizes[node.input[1]] + sizes[node.input[2]])
    if node.op_type in ("MaxPool", "AveragePool"):
        return result * math.prod(next(a.ints for a in node.attribute if a.name == "kernel_shape"))
    return result + sum(sizes[name] for name in node.input)
