"""Check a network of ONNX before it runs: it computes, in bounded time and memory, and does nothing else."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, Final

import onnx
from google.protobuf.message import DecodeError, EncodeError
from onnx import TensorProto

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
    "Abs", "Add", "And", "ArgMax", "ArgMin", "AveragePool", "BatchNormalization", "BitShift", "Cast",
    "CastLike", "Ceil", "Celu", "Clip", "Concat", "Constant", "ConstantOfShape", "Conv", "Cos", "CumSum", "Div",
    "Elu", "Equal", "Erf", "Exp", "Expand", "Flatten", "Floor", "GRU", "Gather", "GatherElements", "GatherND",
    "Gelu", "Gemm", "GlobalAveragePool", "GlobalMaxPool", "Greater", "GreaterOrEqual", "GroupNormalization",
    "HardSigmoid", "HardSwish", "Hardmax", "Identity", "InstanceNormalization", "IsInf", "IsNaN", "LRN", "LSTM",
    "LayerNormalization", "LeakyRelu", "Less", "LessOrEqual", "Log", "LogSoftmax", "MatMul", "Max", "MaxPool",
    "Mean", "Min", "Mish", "Mod", "Mul", "Neg", "Not", "OneHot", "Or", "PRelu", "Pad", "Pow",
    "RMSNormalization", "RNN", "Range", "Reciprocal", "ReduceL1", "ReduceL2", "ReduceLogSum", "ReduceLogSumExp",
    "ReduceMax", "ReduceMean", "ReduceMin", "ReduceProd", "ReduceSum", "ReduceSumSquare", "Relu", "Reshape",
    "Round", "Selu", "Shape", "Sigmoid", "Sign", "Sin", "Size", "Slice", "Softmax", "Softplus", "Softsign",
    "Split", "Sqrt", "Squeeze", "Sub", "Sum", "Swish", "Tan", "Tanh", "ThresholdedRelu", "Tile", "TopK",
    "Transpose", "Trilu", "Unsqueeze", "Where", "Xor",
})  # fmt: skip
_RECURRENT: Final = ("LSTM", "GRU", "RNN")

Shapes = dict[str, tuple[int, ...]]


def check_graph(data: bytes) -> onnx.ModelProto:
    """Read a network and refuse one that could do more than compute a small result from its inputs.

    Args:
        data: Content of a file of ONNX.

    Returns:
        The network, with an axis of unknown size in its inputs, the batch, set to 1.

    Raises:
        PolicyError: The message gives the reason.
    """
    if len(data) > MOST_BYTES:
        raise PolicyError(f"expected a network of at most {MOST_BYTES} bytes, got {len(data)}.")
    try:
        model = onnx.load_model_from_string(data)
        _check_parts(model)
        _fix_batch(model)
        del model.graph.value_info[:]  # shapes that the file claims; they are inferred again
        inferred = onnx.shape_inference.infer_shapes(model, check_type=True, strict_mode=True, data_prop=True)
        onnx.checker.check_model(inferred)
        _check_cost(inferred)
    except PolicyError:
        raise
    except (DecodeError, EncodeError, onnx.checker.ValidationError, onnx.shape_inference.InferenceError) as error:
        raise PolicyError(f"not a network of ONNX, or a damaged one: {error!s:.300}") from error
    except (RuntimeError, ValueError, TypeError, IndexError, KeyError, AttributeError, MemoryError) as error:
        raise PolicyError(f"the network cannot be understood: {error!s:.300}") from error
    return model


def _check_parts(model: onnx.ModelProto) -> None:
    """Refuse operators, kinds of tensors and parts of a file that no policy needs."""
    domains = [opset.domain for opset in model.opset_import if opset.domain not in _DOMAINS]
    if domains:
        raise PolicyError(f"the network uses operators of {domains[0]!r:.80}; expected only those of ONNX itself.")
    if model.functions or model.graph.sparse_initializer:
        raise PolicyError("the network has functions or sparse tensors; export it with optimize=True.")
    if len(model.graph.node) > _MOST_NODES:
        raise PolicyError(f"expected at most {_MOST_NODES} operators, got {len(model.graph.node)}.")
    for node in model.graph.node:
        if node.domain not in _DOMAINS or node.op_type not in _OPERATORS:
            raise PolicyError(
                f"the operator {node.domain[:40]}{'.' if node.domain else ''}{node.op_type[:40]} is not allowed."
            )
        for attribute in node.attribute:
            if (
                attribute.HasField("g")
                or attribute.graphs
                or attribute.HasField("sparse_tensor")
                or attribute.sparse_tensors
            ):
                raise PolicyError(f"the operator {node.op_type} has a subgraph or a sparse tensor.")
    for tensor in _tensors(model):
        if tensor.data_location == TensorProto.EXTERNAL or tensor.external_data:
            raise PolicyError(f"the tensor {tensor.name!r:.80} is in another file; save the network with its weights.")
        if tensor.data_type == TensorProto.STRING:
            raise PolicyError(f"the tensor {tensor.name!r:.80} holds texts.")
        if any(side < 0 for side in tensor.dims) or math.prod(tensor.dims) * 1 > MOST_BYTES:
            raise PolicyError(f"the tensor {tensor.name!r:.80} has the shape {list(tensor.dims)[:8]}.")


def _tensors(model: onnx.ModelProto) -> Iterator[TensorProto]:
    yield from model.graph.initializer
    for node in model.graph.node:
        for attribute in node.attribute:
            yield from attribute.tensors
            if attribute.HasField("t"):
                yield attribute.t


def _fix_batch(model: onnx.ModelProto) -> None:
    for value in model.graph.input:
        for place, side in enumerate(value.type.tensor_type.shape.dim):
            if not side.HasField("dim_value"):
                if place > 0:
                    raise PolicyError(f"the input {value.name!r:.80} has an unknown size besides the batch.")
                side.dim_value = 1
    for value in model.graph.output:
        value.type.tensor_type.ClearField("shape")


def _check_cost(model: onnx.ModelProto) -> None:
    """Refuse results of unknown or large size, and long computations."""
    graph = model.graph
    shapes: Shapes = {tensor.name: tuple(tensor.dims) for tensor in graph.initializer}
    for value in (*graph.input, *graph.value_info, *graph.output):
        kind: Any = value.type.tensor_type
        if not kind.HasField("shape") or any(not side.HasField("dim_value") for side in kind.shape.dim):
            raise PolicyError(f"the size of {value.name!r:.80} is unknown before the network runs.")
        shapes[value.name] = tuple(side.dim_value for side in kind.shape.dim)
    computed = work = 0
    for node in graph.node:
        missing = [name for name in (*node.output, *node.input) if name and name not in shapes]
        if missing:
            raise PolicyError(f"the size of {missing[0]!r:.80} is unknown before the network runs.")
        computed += sum(math.prod(shapes[name]) for name in node.output if name) * _ITEM_BYTES
        work += _work(node, shapes)
    if computed > _MOST_COMPUTED or work > _MOST_WORK:
        raise PolicyError(
            f"expected at most {_MOST_COMPUTED} bytes and {_MOST_WORK:.0g} multiplications in a step, got {computed} "
            f"and {work:.3g}."
        )


def _work(node: onnx.NodeProto, shapes: Shapes) -> int:
    """Estimate the number of multiplications of an operator, from above."""
    sizes = [math.prod(shapes[name]) if name else 0 for name in node.input]
    result = math.prod(shapes[node.output[0]]) if node.output[0] else 0
    attributes = {attribute.name: attribute for attribute in node.attribute}
    if node.op_type in ("MatMul", "Gemm"):
        return result * max(shapes[node.input[0]] or (1,))
    if node.op_type == "Conv":
        return result * math.prod(shapes[node.input[1]][1:])
    if node.op_type in _RECURRENT:
        return shapes[node.input[0]][0] * shapes[node.input[0]][1] * (sizes[1] + sizes[2])
    if node.op_type in ("MaxPool", "AveragePool"):
        return result * math.prod(attributes["kernel_shape"].ints)
    if node.op_type == "LRN":
        return result * abs(attributes["size"].i)
    return result + sum(sizes)
