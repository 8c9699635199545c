"""Train the network of ``propose_segmentation`` on drawn scenes, and write it as ONNX.

    python train.py --minutes 120 --out FOLDER

trains for two hours of processor time, on from the training in ``FOLDER`` if there is one. Every five minutes it is
validated and written: ``FOLDER/checkpoint.pt``, ``FOLDER/click_net.onnx``. Two cores are used, one to draw scenes.
Needs ``pip install torch scikit-image onnx``.
"""

from __future__ import annotations

import os
import time
from dataclasses import asdict, dataclass, field, replace
from itertools import count, islice
from pathlib import Path
from typing import Final

import cv2
import numpy as np
import torch
import tyro
from curves import Array, Random
from network import ClickNet, export
from samples import Batches, Sample, draw_sample
from scene import draw_scene
from torch import Tensor, nn
from torch.nn import functional
from torch.optim.swa_utils import AveragedModel
from torch.utils.data import DataLoader

_RATE: Final = 3e-3  # learning rate
_TAIL: Final = 0.5  # last share of the planned time, in which the rate falls as a cosine
_WARM: Final = 60  # steps over which the rate rises
_AVERAGED: Final = 1000  # steps over which the weights are averaged
_SECOND: Final = 0.35  # share of the steps that train the second pass
_SAVE: Final = 5.0  # minutes from one validation and checkpoint to the next


@dataclass
class Progress:
    """How far a training is, in all runs."""

    seed: int  # of scenes and samples
    minutes: float = 0.0  # processor time of this process, which a busy machine does not change
    step: int = 0
    curve: list[list[float]] = field(default_factory=list)  # minutes, steps, and what ``validate`` returned

    def rate(self, total: float) -> float:
        """Return the learning rate for ``total`` planned minutes: constant, then a cosine down to a thousandth."""
        tail = np.clip(1 - (1 - self.minutes / total) / _TAIL, 0, 1)
        return _RATE * min(1.0, (self.step + 1) / _WARM) * max(1e-3, float(0.5 + 0.5 * np.cos(np.pi * tail)))


def loss_of(logits: Tensor, target: Tensor) -> Tensor:
    """Return twice the cross-entropy, with more weight near borders, plus the dice loss."""
    counts, truth = (target < 2).float(), (target == 1).float()
    border = functional.max_pool2d(truth, 7, 1, 3) + functional.max_pool2d(-truth, 7, 1, 3)  # dilated without eroded
    weight = (1 + 4 * border) * counts
    entropy = functional.binary_cross_entropy_with_logits(logits, truth, reduction="none")
    entropy = (entropy * weight).sum((1, 2, 3)) / weight.sum((1, 2, 3))
    probability, soft = torch.sigmoid(logits) * counts, 20.0  # pixels, so that a tiny object does not dominate
    both, sizes = (probability * truth).sum((1, 2, 3)), (probability + truth).sum((1, 2, 3))
    return (2 * entropy + 1 - (2 * both + soft) / (sizes + soft)).mean()


def logits_of(network: nn.Module, seen: Tensor) -> Tensor:
    """Run a network in bfloat16; returns float32 ``(B, 1, h, w)``."""
    with torch.autocast("cpu", torch.bfloat16):
        return network(seen.contiguous(memory_format=torch.channels_last)).float()


@torch.no_grad()
def probability_of(network: nn.Module, seen: Tensor) -> Array:
    """Return the probability of each pixel ``(B, h, w)``, as when the network is used."""
    return torch.sigmoid(logits_of(network.eval(), seen))[:, 0].numpy()


def second_pass(network: nn.Module, rng: Random, samples: list[Sample], seen: Tensor) -> Tensor:
    """Return what the network sees in the pass after the first: its own answer, and mostly a click that corrects it."""
    again = seen.clone()
    for i, (sample, answer) in enumerate(zip(samples, probability_of(network, seen), strict=True)):
        if sample.kind == "click":
            after = sample.corrected(rng, answer) if rng.random() < 0.7 else replace(sample, previous=answer)
            again[i] = torch.from_numpy(after.seen())
    return again


def held_out(number: int) -> list[Sample]:
    """Return samples for the validation, the same in all runs: one click on an object."""
    rngs = (np.random.default_rng([45, 2, k]) for k in count())
    drawn = (draw_sample(rng, draw_scene(rng), "click") for rng in rngs)
    return list(islice((s for s in drawn if s and len(s.on.places) == 1 and not len(s.off.places)), number))


def validate(network: nn.Module, samples: list[Sample]) -> list[float]:
    """Return the mean IoU after one click and two passes, in per cent: of all, of ropes and rings, of sheets."""
    overlaps, thin = np.zeros(len(samples)), np.array([sample.thin for sample in samples])
    for i, sample in enumerate(samples):
        for _ in range(2):
            seen = torch.from_numpy(sample.seen())[None]
            sample = replace(sample, previous=probability_of(network, seen)[0])
        truth, found = sample.target == 1, (np.asarray(sample.previous) > 0.5) & (sample.target < 2)
        overlaps[i] = 100 * (truth & found).sum() / (truth | found).sum()
    return [float(overlaps[group].mean()) for group in (thin | ~thin, thin, ~thin)]


def _moving_mean(mean: Tensor, new: Tensor, count: Tensor | int) -> Tensor:
    return mean + (new - mean) / min(int(count) + 1, _AVERAGED)  # a plain mean in the first steps


def train(
    minutes: float, out: Path = Path("click_net"), total_minutes: float = 240, seed: int = 0, validation: int = 120
) -> None:
    """Train for some minutes more, and write the network.

    Args:
        minutes: Processor time of this run.
        out: Folder of the checkpoint and the network.
        total_minutes: Time planned for all runs.
        seed: Seed of a new training.
        validation: Number of samples of the validation.
    """
    torch.set_num_threads(1)
    cv2.setNumThreads(1)  # before the process that draws is forked: threads of OpenCV do not survive that
    torch.manual_seed(seed)
    out.mkdir(parents=True, exist_ok=True)
    file, progress, network = out / "checkpoint.pt", Progress(seed), ClickNet().to(memory_format=torch.channels_last)
    average = AveragedModel(network, avg_fn=_moving_mean, use_buffers=True)
    optimiser = torch.optim.AdamW(network.parameters(), _RATE, weight_decay=1e-3, betas=(0.9, 0.99))
    states = {"network": network, "average": average, "optimiser": optimiser}
    if file.exists():
        stored = torch.load(file, weights_only=True)
        progress = Progress(**stored["progress"])
        for name, state in states.items():
            state.load_state_dict(stored[name])
    print(f"{progress.minutes:.0f} minutes and {progress.step} steps so far", flush=True)
    ended, saved, losses = progress.minutes + minutes, progress.minutes, []
    tests, start = held_out(validation), progress.minutes - time.process_time() / 60
    batches = Batches(progress.seed, progress.step)
    for samples, half in DataLoader(batches, batch_size=None, num_workers=1, prefetch_factor=8):
        rng = np.random.default_rng([progress.seed, 3, progress.step])
        target, seen = torch.from_numpy(np.stack([sample.target for sample in samples]))[:, None], half.float()
        if rng.random() < _SECOND:
            seen = second_pass(network, rng, samples, seen)
        if rng.random() < 0.5:  # upright photos
            seen, target = seen.transpose(2, 3), target.transpose(2, 3)
        optimiser.param_groups[0]["lr"] = progress.rate(total_minutes)
        loss = loss_of(logits_of(network.train(), seen), target)
        optimiser.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(network.parameters(), 2.0)
        optimiser.step()
        average.update_parameters(network)
        losses.append(loss.item())
        progress.step, progress.minutes = progress.step + 1, start + time.process_time() / 60
        if progress.minutes < min(saved + _SAVE, ended):
            continue
        progress.curve.append([progress.minutes, progress.step, *validate(average, tests)])
        report = "{:.0f} min, {} steps: IoU {:.0f} %, thin {:.0f} %, sheets {:.0f} %; loss {:.3f}"
        print(report.format(*progress.curve[-1], np.mean(losses)), flush=True)
        export(average.module, out / "click_net.onnx")
        content = {name: state.state_dict() for name, state in states.items()} | {"progress": asdict(progress)}
        torch.save(content, out / "checkpoint.new")
        os.replace(out / "checkpoint.new", file)  # at once: a training that is killed leaves the old one or the new
        if progress.minutes >= ended:
            break
        saved, losses = progress.minutes, []


if __name__ == "__main__":
    tyro.cli(train)
