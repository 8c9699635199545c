"""Train the network of ``propose_segmentation`` on drawn scenes, and write it as ONNX.

    python train.py --minutes 120 --out FOLDER

trains for two hours of processor time, on from the training in ``FOLDER`` if there is one. Every five minutes it is
validated, and written as ``checkpoint.pt`` and ``click_net.onnx``. Needs two cores, torch, scikit-image and onnx.
"""

from __future__ import annotations

import time
from dataclasses import replace
from itertools import count, islice
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
import tyro
from curves import Array
from network import ClickNet, export
from samples import Batches, Sample, draw_sample
from scene import draw_scene
from torch import Tensor, nn
from torch.nn import functional
from torch.optim.swa_utils import AveragedModel
from torch.utils.data import DataLoader


def loss_of(logits: Tensor, target: Tensor) -> Tensor:
    """Return twice the cross-entropy, with more weight near borders, plus the dice loss."""
    counts, truth = (target < 2).float(), (target == 1).float()
    border = functional.max_pool2d(truth, 7, 1, 3) + functional.max_pool2d(-truth, 7, 1, 3)  # dilated without eroded
    weight, pixels = (1 + 4 * border) * counts, (1, 2, 3)
    entropy = functional.binary_cross_entropy_with_logits(logits, truth, weight, reduction="none").sum(pixels)
    probability, soft = torch.sigmoid(logits) * counts, 20.0  # pixels, so that a tiny object does not dominate
    both, sizes = (probability * truth).sum(pixels), (probability + truth).sum(pixels)
    return (2 * entropy / weight.sum(pixels) + 1 - (2 * both + soft) / (sizes + soft)).mean()


def logits_of(network: nn.Module, seen: Tensor) -> Tensor:
    """Run a network in bfloat16; returns float32 ``(B, 1, h, w)``."""
    with torch.autocast("cpu", torch.bfloat16):
        return network(seen.contiguous(memory_format=torch.channels_last)).float()


@torch.no_grad()
def probability_of(network: nn.Module, seen: Tensor) -> Array:
    """Return the probability of each pixel ``(B, h, w)``, as when the network is used."""
    return torch.sigmoid(logits_of(network.eval(), seen))[:, 0].numpy()


def validate(network: nn.Module, samples: list[Sample]) -> list[float]:
    """Return the mean IoU after one click and two passes, in per cent: of all, of ropes and rings, of sheets."""
    overlaps, thin = np.zeros(len(samples)), np.array([sample.thin for sample in samples])
    for i, sample in enumerate(samples):
        first = probability_of(network, torch.from_numpy(sample.seen())[None])[0]
        second = probability_of(network, torch.from_numpy(replace(sample, previous=first).seen())[None])[0]
        truth, found = sample.target == 1, (second > 0.5) & (sample.target < 2)
        overlaps[i] = 100 * (truth & found).sum() / (truth | found).sum()
    return [float(overlaps[group].mean()) for group in (thin | ~thin, thin, ~thin)]


def train(minutes: float, out: Path = Path("click_net"), total: float = 240, seed: int = 0, tests: int = 120) -> None:
    """Train for some ``minutes`` more, of a ``total`` planned for all runs, and write the network."""
    torch.set_num_threads(1)
    cv2.setNumThreads(1)  # before the process that draws is forked: threads of OpenCV do not survive that
    torch.manual_seed(seed)
    out.mkdir(parents=True, exist_ok=True)
    file, network = out / "checkpoint.pt", ClickNet().to(memory_format=torch.channels_last)
    average = AveragedModel(  # of 1000 steps; in the first ones a plain mean
        network, avg_fn=lambda mean, new, steps: mean + (new - mean) / min(int(steps) + 1, 1000), use_buffers=True
    )
    optimiser = torch.optim.AdamW(network.parameters(), weight_decay=1e-3, betas=(0.9, 0.99))
    states = {"network": network, "average": average, "optimiser": optimiser}
    # Of all runs; the minutes are processor time of this process, which a busy machine does not change.
    progress: dict[str, Any] = {"seed": seed, "minutes": 0.0, "step": 0, "curve": []}
    if file.exists():
        stored = torch.load(file, weights_only=True)
        progress = stored["progress"]
        for name, state in states.items():
            state.load_state_dict(stored[name])
    seed, done, step = progress["seed"], progress["minutes"], progress["step"]
    print(f"{done:.0f} minutes and {step} steps so far", flush=True)
    drawn = (draw_sample(rng, draw_scene(rng), "click") for rng in (np.random.default_rng([45, 2, k]) for k in count()))
    shown = list(islice((s for s in drawn if s and len(s.on.places) == 1 and not len(s.off.places)), tests))
    ended, saved, losses, start = done + minutes, done, [], done - time.process_time() / 60
    for samples, half in DataLoader(Batches(seed), None, sampler=count(step), num_workers=1, prefetch_factor=8):
        rng = np.random.default_rng([seed, 3, step])
        target, seen = torch.from_numpy(np.stack([sample.target for sample in samples]))[:, None], half.float()
        if rng.random() < 0.35:  # the second pass: the network sees its own answer, and mostly a click on its error
            for i, (sample, answer) in enumerate(zip(samples, probability_of(network, seen), strict=True)):
                if sample.kind == "click":
                    after = sample.corrected(rng, answer) if rng.random() < 0.7 else replace(sample, previous=answer)
                    seen[i] = torch.from_numpy(after.seen())
        if rng.random() < 0.5:  # upright photos
            seen, target = seen.transpose(2, 3), target.transpose(2, 3)
        # The learning rate rises over 60 steps, and falls in the second half of the time to a thousandth.
        falling = 0.5 - 0.5 * np.cos(np.pi * np.clip(2 * done / total, 1, 2))
        optimiser.param_groups[0]["lr"] = 3e-3 * min(1, (step + 1) / 60) * max(1e-3, float(falling))
        loss = loss_of(logits_of(network.train(), seen), target)
        optimiser.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(network.parameters(), 2.0)
        optimiser.step()
        average.update_parameters(network)
        losses.append(loss.item())
        step, done = step + 1, start + time.process_time() / 60
        if done < min(saved + 5, ended):
            continue
        progress["curve"].append([done, step, *validate(average, shown)])
        report = "{:.0f} min, {} steps: IoU {:.0f} %, thin {:.0f} %, sheets {:.0f} %; loss {:.3f}"
        print(report.format(*progress["curve"][-1], np.mean(losses)), flush=True)
        export(average.module, out / "click_net.onnx")
        content = {name: state.state_dict() for name, state in states.items()}
        torch.save(content | {"progress": progress | {"minutes": done, "step": step}}, out / "checkpoint.new")
        (out / "checkpoint.new").replace(file)  # at once: a training that is killed leaves the old one or the new
        if done >= ended:
            break
        saved, losses = done, []


if __name__ == "__main__":
    tyro.cli(train)
