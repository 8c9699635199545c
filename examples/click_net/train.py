"""Train the network of ``propose_segmentation`` on drawn scenes, and write it as ONNX.

    python train.py --minutes 120 --out FOLDER

trains for two hours more, of processor time, and resumes an earlier training, also one that was killed:
``FOLDER/checkpoint.pt`` is written every two minutes, ``FOLDER/click_net.onnx`` with each validation. Two cores are
used, one of them to draw scenes.
Needs ``pip install torch scikit-image onnx``.
"""

from __future__ import annotations

import argparse
import os
import time
from dataclasses import asdict, dataclass, field
from itertools import count, islice
from pathlib import Path
from typing import Final

import cv2
import numpy as np
import torch
from curves import Array, Random
from network import ClickNet, export
from samples import Batches, Sample, draw_sample
from scene import draw_scene
from skimage.morphology import skeletonize
from torch import Tensor, nn
from torch.nn import functional
from torch.optim.swa_utils import AveragedModel
from torch.utils.data import DataLoader

_RATE: Final = 3e-3  # learning rate
_TAIL: Final = 0.5  # last share of the planned time, in which the rate falls as a cosine
_WARM: Final = 60  # steps over which the rate rises
_AVERAGED: Final = 1000  # steps over which the weights are averaged
_SECOND: Final = 0.35  # share of the steps that train the second pass
_SAVE, _VALIDATE = 2.0, 10.0  # minutes between checkpoints, between validations
_HELD_OUT: Final = (45, 120)  # seed and number of the samples of the validation, the same in all runs


@dataclass
class Progress:
    """How far a training is, in all runs.

    Args:
        seed: Seed of scenes and samples.
        minutes: Processor time of this process, which a busy machine does not change.
        step: Steps.
        curve: Minutes, steps, and the per cent that were right after one click: all, ropes and rings, sheets.
    """

    seed: int
    minutes: float = 0.0
    step: int = 0
    curve: list[list[float]] = field(default_factory=list)

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
    answer, again = probability_of(network, seen), seen.clone()
    for i, sample in enumerate(samples):
        if sample.kind == "click" and rng.random() < 0.7:
            again[i] = torch.from_numpy(sample.corrected(rng, answer[i]).seen())
        elif sample.kind == "click":
            again[i, -1] = torch.from_numpy(answer[i])
    return again


def held_out_samples() -> list[Sample]:
    """Return the samples of the validation: one click on an object."""
    rngs = (np.random.default_rng([_HELD_OUT[0], 2, number]) for number in count())
    drawn = (draw_sample(rng, draw_scene(rng), "click") for rng in rngs)
    return list(islice((s for s in drawn if s and len(s.on.places) == 1 and not len(s.off.places)), _HELD_OUT[1]))


def is_right(sample: Sample, probability: Array) -> bool:
    """Return whether an answer is right: IoU of 0.85 for a sheet.

    Of a rope or ring, 90 % of the middle line lie within 2 pixels of the mask, 90 % of the mask within 3 of the object.
    """
    truth, found = sample.target == 1, (probability > 0.5) & (sample.target < 2)
    if not sample.thin or not found.any():
        return bool((truth & found).sum() >= 0.85 * (truth | found).sum())
    to_found, to_truth = (cv2.distanceTransform(1 - mask.astype(np.uint8), cv2.DIST_L2, 5) for mask in (found, truth))
    return bool((to_found[skeletonize(truth)] <= 2).mean() >= 0.9 and (to_truth[found] <= 3).mean() >= 0.9)


def validate(network: nn.Module, samples: list[Sample]) -> list[float]:
    """Return the per cent that are right after one click and two passes: all, ropes and rings, sheets."""
    right, thin = np.zeros(len(samples), bool), np.array([sample.thin for sample in samples])
    for i, sample in enumerate(samples):
        seen = torch.from_numpy(sample.seen())[None]
        seen[0, -1] = torch.from_numpy(probability_of(network, seen)[0])
        right[i] = is_right(sample, probability_of(network, seen)[0])
    return [100 * float(right[group].mean()) for group in (thin | ~thin, thin, ~thin)]


def _moving_mean(mean: Tensor, new: Tensor, count: Tensor | int) -> Tensor:
    return mean + (new - mean) / min(int(count) + 1, _AVERAGED)  # a plain mean in the first steps


def train(minutes: float, out: Path, total: float, seed: int) -> None:
    """Train for some minutes more, and write the network."""
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
    held_out, losses = held_out_samples(), []
    batches = iter(DataLoader(Batches(progress.seed, progress.step), batch_size=None, num_workers=1, prefetch_factor=8))
    samples, seen = next(batches)
    begun, started = progress.minutes, time.process_time()
    saved, validated, ended = begun, begun, begun + minutes
    while progress.minutes < ended:
        rng = np.random.default_rng([progress.seed, 3, progress.step])
        target, seen = torch.from_numpy(np.stack([sample.target for sample in samples]))[:, None], seen.float()
        if rng.random() < _SECOND:
            seen = second_pass(network, rng, samples, seen)
        if rng.random() < 0.5:  # upright photos
            seen, target = seen.transpose(2, 3), target.transpose(2, 3)
        for group in optimiser.param_groups:
            group["lr"] = progress.rate(total)
        loss = loss_of(logits_of(network.train(), seen), target)
        optimiser.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(network.parameters(), 2.0)
        optimiser.step()
        average.update_parameters(network)
        losses.append(loss.item())
        progress.step, progress.minutes = progress.step + 1, begun + (time.process_time() - started) / 60
        if len(losses) % 100 == 0:
            pace = 60e3 * (progress.minutes - begun) / len(losses)
            print(f"{progress.minutes:.1f} min, {progress.step} steps: loss {np.mean(losses[-100:]):.3f}", end=", ")
            print(f"{pace:.0f} ms of processor time a step", flush=True)
        if progress.minutes - validated > _VALIDATE or progress.minutes >= ended:
            validated = progress.minutes
            progress.curve.append([progress.minutes, progress.step, *validate(average, held_out)])
            report = "{:.0f} min, {} steps: right {:.0f} %, thin {:.0f} %, sheets {:.0f} %"
            print(report.format(*progress.curve[-1]), flush=True)
            export(average.module, out / "click_net.onnx")
        if progress.minutes - saved > _SAVE or progress.minutes >= ended:
            saved = progress.minutes
            content = {name: state.state_dict() for name, state in states.items()} | {"progress": asdict(progress)}
            torch.save(content, out / "checkpoint.new")
            os.replace(out / "checkpoint.new", file)  # at once: a training that is killed leaves the old one or the new
        samples, seen = next(batches)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, required=True, help="processor time of this run")
    parser.add_argument("--out", type=Path, default=Path("click_net"), help="folder of the checkpoint and the network")
    parser.add_argument("--total-minutes", type=float, default=240, help="time planned for all runs")
    parser.add_argument("--seed", type=int, default=0, help="seed of a new training")
    arguments = parser.parse_args()
    train(arguments.minutes, arguments.out, arguments.total_minutes, arguments.seed)
