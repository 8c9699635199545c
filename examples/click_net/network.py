"""The network: a U-Net of 0.53 million parameters, and its export to an ONNX file that ``cv2.dnn`` reads."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import onnx
import torch
from curves import HEIGHT, WIDTH
from torch import Tensor, nn
from torch.nn import functional

from shape_obs.image.click_net import CHANNELS

_A, _B, _C = 24, 40, 64  # channels at 1/2, at 1/4, and at 1/8 and 1/16 of the photo's size


def _conv(inputs: int, outputs: int, size: int = 3, stride: int = 1, dilation: int = 1) -> nn.Sequential:
    convolution = nn.Conv2d(inputs, outputs, size, stride, (size - 1) // 2 * dilation, dilation, bias=False)
    return nn.Sequential(convolution, nn.BatchNorm2d(outputs), nn.ReLU(inplace=True))


class _Residual(nn.Module):
    """Add what two convolutions find, the first of them dilated."""

    def __init__(self, dilation: int) -> None:
        super().__init__()
        self.first, self.second = _conv(_C, _C, dilation=dilation), _conv(_C, _C)[:2]

    def forward(self, x: Tensor) -> Tensor:
        return torch.relu(x + self.second(self.first(x)))


class _Up(nn.Module):
    """Double the size of a map and join it with the finer one of the way down."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.narrow = _conv(inputs, outputs, 1)
        self.join = nn.Sequential(_conv(2 * outputs, outputs, 1), _conv(outputs, outputs))

    def forward(self, x: Tensor, finer: Tensor) -> Tensor:
        doubled = functional.interpolate(self.narrow(x), scale_factor=2, mode="bilinear")
        return self.join(torch.cat([doubled, finer], 1))


class ClickNet(nn.Module):
    """Map what ``network_input`` returns to the logit of each pixel: ``(B, 11, h, w)`` to ``(B, 1, h, w)``.

    h and w are multiples of 16, at least 32. The middle works at 1/8 and at 1/16 of the size, with dilation: it sees
    over 200 pixels to each side, so that a click reaches far along a rope. Nothing works at the full size.
    """

    def __init__(self) -> None:
        super().__init__()
        half = nn.Sequential(_conv(CHANNELS, _A, 2, stride=2), _conv(_A, _A))
        quarter = nn.Sequential(_conv(_A, _B, stride=2), _conv(_B, _B))
        eighth = nn.Sequential(_conv(_B, _C, stride=2), _Residual(1), _Residual(2))
        sixteenth = nn.Sequential(_conv(_C, _C, stride=2), _Residual(1), _Residual(2), _Residual(4))
        self.down = nn.ModuleList([half, quarter, eighth, sixteenth])
        self.up = nn.ModuleList([_Up(_C, _C), _Up(_C, _B), _Up(_B, _A)])
        self.parts = nn.Conv2d(_A, 4, 3, padding=1)  # four pixels of the photo for each of half of the size
        self.interleave = nn.ConvTranspose2d(4, 1, 2, 2, bias=False)  # a pixel shuffle, which cv2.dnn misreads
        self.parts.bias = nn.Parameter(torch.full((4,), -2.0))  # most pixels are no object
        self.interleave.weight = nn.Parameter(torch.eye(4).reshape(4, 1, 2, 2), requires_grad=False)

    def forward(self, x: Tensor) -> Tensor:
        half = self.down[0](x)
        quarter = self.down[1](half)
        eighth = self.down[2](quarter)
        x = self.up[0](self.down[3](eighth), eighth)
        return self.interleave(self.parts(self.up[2](self.up[1](x, quarter), half)))


def export(network: nn.Module, path: Path) -> None:
    """Write a network as ONNX with float16 weights: input ``x``, output ``y``, logits.

    The file states the size of the photos in training, because OpenCV 4.9 reads no free sizes; ``cv2.dnn`` takes any
    sides of 32 or more that are multiples of 16 (OpenCV 5.0 computes nonsense from a side of 16).
    """
    write = partial(torch.onnx.export, opset_version=17, dynamo=False)  # operators that OpenCV 4.9 reads
    write(network.eval(), (torch.zeros(1, CHANNELS, HEIGHT, WIDTH),), path, input_names=["x"], output_names=["y"])
    model = onnx.load(path)
    for tensor in list(model.graph.initializer):  # weights are stored as float16, and cast when the file is read
        weights, name, stored = onnx.numpy_helper.to_array(tensor), tensor.name, f"{tensor.name}_half"
        if weights.dtype == "float32" and weights.size > 200:
            tensor.CopyFrom(onnx.numpy_helper.from_array(weights.astype("float16"), stored))
            model.graph.node.insert(0, onnx.helper.make_node("Cast", [stored], [name], to=onnx.TensorProto.FLOAT))
    onnx.save(model, path)
