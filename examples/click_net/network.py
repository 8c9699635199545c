"""The network: a U-Net of 0.53 million parameters, and its export to an ONNX file that ``cv2.dnn`` reads."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import onnx
import torch
from curves import HEIGHT, WIDTH
from torch import Tensor, nn

from shape_obs.image.click_net import CHANNELS

_A, _B, _C = 24, 40, 64  # channels at 1/2, at 1/4, and at 1/8 and 1/16 of the photo's size
_OPSET: Final = 17  # of ONNX: OpenCV 4.9 reads its operators
_SMALL: Final = 200  # values of a tensor up to which it stays float32


def _conv(inputs: int, outputs: int, size: int = 3, stride: int = 1, dilation: int = 1) -> nn.Sequential:
    padding = dilation * ((size - 1) // 2)
    convolution = nn.Conv2d(inputs, outputs, size, stride, padding, dilation, bias=False)
    return nn.Sequential(convolution, nn.BatchNorm2d(outputs), nn.ReLU(inplace=True))


class _Residual(nn.Module):
    """Add what two convolutions find, the first of them dilated."""

    def __init__(self, dilation: int) -> None:
        super().__init__()
        self.first = _conv(_C, _C, dilation=dilation)
        self.second = nn.Sequential(nn.Conv2d(_C, _C, 3, padding=1, bias=False), nn.BatchNorm2d(_C))

    def forward(self, x: Tensor) -> Tensor:
        return torch.relu(x + self.second(self.first(x)))


class _Up(nn.Module):
    """Double the size of a map and join it with the finer one of the way down."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.narrow = _conv(inputs, outputs, 1)
        self.double_size = nn.Upsample(scale_factor=2, mode="bilinear", align_corners=False)
        self.join = nn.Sequential(_conv(2 * outputs, outputs, 1), _conv(outputs, outputs))

    def forward(self, x: Tensor, finer: Tensor) -> Tensor:
        return self.join(torch.cat([self.double_size(self.narrow(x)), finer], 1))


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
        maps = []
        for level in self.down:
            x = level(x)
            maps.append(x)
        for level, finer in zip(self.up, maps[-2::-1], strict=True):
            x = level(x, finer)
        return self.interleave(self.parts(x))


def export(network: nn.Module, path: Path) -> None:
    """Write a network as ONNX with float16 weights: input ``x``, output ``y``, logits.

    The file states the size of the photos in training, because OpenCV 4.9 reads no free sizes; ``cv2.dnn`` takes any
    sides of 32 or more that are multiples of 16 (OpenCV 5.0 computes nonsense from a side of 16).
    """
    seen = torch.zeros(1, CHANNELS, HEIGHT, WIDTH)
    torch.onnx.export(
        network.eval(), (seen,), path, input_names=["x"], output_names=["y"], opset_version=_OPSET, dynamo=False
    )
    model = onnx.load(path)
    for tensor in list(model.graph.initializer):  # weights are stored as float16, and cast when the file is read
        weights, name, stored = onnx.numpy_helper.to_array(tensor), tensor.name, f"{tensor.name}_half"
        if weights.dtype == "float32" and weights.size > _SMALL:
            tensor.CopyFrom(onnx.numpy_helper.from_array(weights.astype("float16"), stored))
            model.graph.node.insert(0, onnx.helper.make_node("Cast", [stored], [name], to=onnx.TensorProto.FLOAT))
    onnx.save(model, path)
