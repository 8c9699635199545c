"""Check a network of ONNX before it runs: it computes, in bounded time and memory, and does nothing else."""

from __future__ import annotations

import math
from typing import Any, Final

import onnx
from google.protobuf.descriptor import FieldDescriptor
from onnx import AttributeProto, TensorProto

from shape_obs.policy.contract import PolicyError

#: Bytes of the file, of which some six copies exist for a moment, and of all values that are computed in a step.
MOST_BYTES: Final = 36 << 20
_MOST_COMPUTED: Final = 64 << 20
#: Work of a step in multiplications of a matrix product: 25 ms on one core.
_MOST_WORK: Final = 5e8
#: Work of an operator itself (5 us), of a number that it reads (0.4 ns) and of one that it computes (at most 5 ns).
_WORK: Final = 100_000, 8, 100
_MOST_NODES: Final = 5000
#: Fields and numbers in the file outside of ``raw_data``. Each takes up to 0.2 kB and 2 us to read.
_MOST_FIELDS: Final = 150_000
#: Kinds of fields in the coding of protobuf: of those with a fixed size, their bytes.
_VARINT, _LENGTH, _FIXED = 0, 2, {1: 8, 5: 4}
#: Types whose values take as many bytes in memory as in the file.
_AS_LONG: Final = (
    FieldDescriptor.TYPE_DOUBLE, FieldDescriptor.TYPE_FLOAT, FieldDescriptor.TYPE_STRING, FieldDescriptor.TYPE_BYTES
)  # fmt: skip
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
    "Split", "Sqrt", "Squeeze", "Sub", "Sum", "Swish", "Tan", "Tanh", "ThresholdedRelu", "Tile", "Transpose",
    "Trilu", "Unsqueeze", "Where", "Xor",
})  # fmt: skip
#: Kinds of an operator's attributes; others hold graphs, types or sparse tensors.
_ATTRIBUTES: Final = frozenset({
    AttributeProto.FLOAT, AttributeProto.INT, AttributeProto.STRING, AttributeProto.TENSOR, AttributeProto.FLOATS,
    AttributeProto.INTS, AttributeProto.STRINGS,
})  # fmt: skip


def check_graph(data: bytes) -> tuple[onnx.ModelProto, float]:
    """Read a network and refuse one that could do more than compute a small result from its inputs.

    Returns:
        The network, with a batch of 1 and the shapes of all values; and the work of a step in multiplications.

    Raises:
        PolicyError: The message gives the reason. Damaged files raise what onnx and protobuf raise.
    """
    if len(data) > MOST_BYTES:
        raise PolicyError(f"expected a network of at most {MOST_BYTES} bytes, got {len(data)}.")
    _check_fields(data)
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
    return model, _check_cost(model.graph)


def _check_fields(data: bytes) -> None:
    """Refuse a file of so many fields that reading it takes seconds or gigabytes, before it is read."""
    left, inside = _MOST_FIELDS, [(0, len(data), onnx.ModelProto.DESCRIPTOR)]
    while inside:
        at, end, message = inside.pop()
        while at < end:
            tag, at = _varint(data, at)
            field, size = message.fields_by_number.get(tag >> 3), _FIXED.get(tag & 7, 0)
            if tag & 7 == _VARINT:
                _, at = _varint(data, at)
            elif tag & 7 == _LENGTH:
                size, at = _varint(data, at)
                if field is not None and field.message_type is not None:
                    inside.append((at, min(at + size, end), field.message_type))
                elif field is not None and field.type not in _AS_LONG:
                    left -= size  # integers, each of a byte or more
            elif tag & 7 not in _FIXED or tag >= 1 << 32:
                raise PolicyError("the network is damaged: it has a field of unknown kind.")
            at, left = at + size, left - 1
            if left < 0:
                raise PolicyError(f"expected a network of at most {_MOST_FIELDS} fields; weights belong in raw_data.")


def _varint(data: bytes, at: int) -> tuple[int, int]:
    """Return an integer in the coding of protobuf, and the position behind it."""
    value = shift = 0
    while shift < 64:
        value |= (data[at] & 127) << shift
        at, shift = at + 1, shift + 7
        if data[at - 1] < 128:
            break
    return value, at


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
        if any(attribute.type not in _ATTRIBUTES for attribute in node.attribute):
            raise PolicyError(f"the operator {node.op_type} has a graph or a sparse tensor inside.")
        tensors += [attribute.t for attribute in node.attribute if attribute.type == AttributeProto.TENSOR]
    for tensor in tensors:
        if tensor.data_location == TensorProto.EXTERNAL or tensor.external_data:
            raise PolicyError(f"the tensor {tensor.name!r:.80} is in another file; save the network with its weights.")
        if tensor.data_type == TensorProto.STRING or min(tensor.dims, default=0) < 0:
            raise PolicyError(f"the tensor {tensor.name!r:.80} holds texts, or has sides below 0.")
        if math.prod(tensor.dims) > MOST_BYTES:
            raise PolicyError(f"the tensor {tensor.name!r:.80} has the shape {list(tensor.dims)[:8]}.")


def _check_cost(graph: onnx.GraphProto) -> float:
    """Refuse values of unknown or large size, and long computations; return the work of a step."""
    shapes: dict[str, tuple[int, ...]] = {tensor.name: tuple(tensor.dims) for tensor in graph.initializer}
    for value in (*graph.input, *graph.value_info, *graph.output):
        kind: Any = value.type.tensor_type
        sides = [side.dim_value if side.HasField("dim_value") else -1 for side in kind.shape.dim]
        if kind.HasField("shape") and min(sides, default=0) >= 0:
            shapes[value.name] = tuple(sides)
    results = {value.name for value in graph.input} | {name for node in graph.node for name in node.output}
    unknown = results.union(*(node.input for node in graph.node)) - shapes.keys() - {""}
    if unknown:
        raise PolicyError(f"the size of {min(unknown)!r:.80} is unknown before the network runs.")
    sizes = {"": 0, **{name: math.prod(shape) for name, shape in shapes.items()}}
    computed = sum(sizes[name] for name in results) * _ITEM_BYTES
    work = sum(_work(node, shapes, sizes) for node in graph.node)
    if computed > _MOST_COMPUTED or work > _MOST_WORK:
        most = f"{_MOST_COMPUTED} bytes and {_MOST_WORK:.0g} multiplications"
        raise PolicyError(f"expected at most {most} in a step, got {computed} and {work:.3g}.")
    return work


def _work(node: onnx.NodeProto, shapes: dict[str, tuple[int, ...]], sizes: dict[str, int]) -> int:
    """Estimate the work of an operator in multiplications, from above."""
    itself, read, computed = _WORK
    result = sum(sizes[name] for name in node.output)
    work, each = itself + read * sum(sizes[name] for name in node.input) + computed * result, 0
    if node.op_type in ("MatMul", "Gemm"):
        each = max(shapes[node.input[0]] or (1,))
    elif node.op_type == "Conv":
        each = math.prod(shapes[node.input[1]][1:])
    elif node.op_type in ("MaxPool", "AveragePool"):
        each = math.prod(next(a.ints for a in node.attribute if a.name == "kernel_shape"))
    elif node.op_type in ("LSTM", "GRU", "RNN"):
        return work + math.prod(shapes[node.input[0]][:2]) * read * (sizes[node.input[1]] + sizes[node.input[2]])
    return work + result * each
