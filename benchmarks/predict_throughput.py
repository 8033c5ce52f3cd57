"""Throughput of batch prediction against the bare network's forward pass on the same tensors.

`predict_batch` reads mp4 files (copies of the bundled real ones: 24 frames of 448²), finds the object, runs the
network, writes all result files and the gallery; the bare network gets the same clips as tensors that are already
there. The host's part is named step by step, each measured alone on one thread. Where the network keeps all cores
busy, the host's processor time is taken from the network's: the share that can be reached is network / (network +
host) in processor seconds, which other programs hardly change.

    python benchmarks/predict_throughput.py --checkpoint default --clips 48
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import resource
import shlex
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # as the command line does; for the bare network too

import cv2
import numpy as np
import torch
from torch.nn.modules.module import register_module_forward_hook, register_module_forward_pre_hook

from inference import (
    ClipPictures,
    ClipSource,
    ResultsFolder,
    StatedConditions,
    frame_strip,
    load_clip,
    predict_batch,
    ready_source,
    to_prediction,
    weight_maps,
)
from models import (
    EncoderConfig,
    NetworkConfig,
    OutlineNetwork,
    PhysicsPredictor,
    SilhouetteSegmenter,
    answer_both_ways,
    collate_clips,
    dimensionless_interval,
)
from physconvex import InputError

CLIPS = Path(__file__).parents[1] / "examples" / "clips"
RESULT = Path(__file__).parent / "results" / "predict_throughput.json"


@dataclass(frozen=True, kw_only=True)
class Throughput:
    """What was measured, in seconds per clip unless said otherwise.

    "Processor" is time of all threads on a core, which other programs hardly change; all else is wall time.
    """

    command: str
    machine: str
    device: str
    cores: int
    torch_threads: int
    load_before: float
    """Mean number of processes that wanted to run in the last minute: above 0, others took time."""
    wait_policy: str
    """Of OpenMP, for the bare network as for the batch."""
    network: str
    parameters: int
    clips: int
    batch_size: int
    bare_network: float
    """Forward pass on tensors that are there, wall time."""
    bare_network_processor: float
    decode_processor: float
    """Reading the mp4."""
    find_and_crop_processor: float
    """Foreground, cropping, resampling, moments."""
    finder_networks_processor: float
    """Of that, the two networks that find the object."""
    picture_processor: float
    """Strip with outlines."""
    write_processor: float
    """Result files, skinning section and journal."""
    estimate_extra: float
    """Densities, intervals and skinning fields beyond the bare network."""
    write: float
    """The same as `write_processor`, with the waiting for the disk."""
    batch_total: float
    """Whole `predict_batch`, start of worker processes and gallery included."""
    batch_steady: float
    """From the first written clip to the last."""
    batch_processor: float
    """Processor time of this and the worker processes during the whole batch."""
    share_of_bare_total: float
    share_of_bare_steady: float
    """Wall time of the bare network over that of the batch."""
    networks_share_of_host: float
    """Processor time of all three networks over that of the networks and all named steps."""
    share_of_bare_processor: float
    """The same in processor time: what a machine with these cores and nothing else to do can reach."""


def main() -> None:
    """Measure, print, store."""
    options = _options()
    if options.threads:
        torch.set_num_threads(options.threads)
    predictor = _predictor(options)
    with tempfile.TemporaryDirectory() as folder:
        sources = _copied_clips(Path(folder) / "clips", options)
        result = _measure(predictor, sources, Path(folder), options)
    options.result.parent.mkdir(exist_ok=True)
    options.result.write_text(json.dumps(asdict(result), indent=1) + "\n", encoding="utf-8")
    print(json.dumps(asdict(result), indent=1))


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--clips", type=int, default=96)
    parser.add_argument("--folder", type=Path, default=CLIPS, help="clips that are copied so often")
    parser.add_argument("--batch-size", type=int, default=8)
    parser.add_argument("--workers", type=int, default=None)
    parser.add_argument("--repeats", type=int, default=3, help="the best of so many is kept")
    parser.add_argument("--checkpoint", default="", help="folder or name; empty: untrained weights of --size")
    parser.add_argument("--size", choices=("tiny", "small", "base"), default="tiny")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--threads", type=int, default=0, help="of torch; 0: its own choice")
    parser.add_argument("--result", type=Path, default=RESULT)
    return parser.parse_args()


def _predictor(options: argparse.Namespace) -> PhysicsPredictor:
    if options.checkpoint:
        return PhysicsPredictor.from_pretrained(options.checkpoint, device=options.device)
    config = NetworkConfig(encoder=EncoderConfig.of_size(options.size))
    return PhysicsPredictor.from_config(config, device=options.device)


def _copied_clips(folder: Path, options: argparse.Namespace) -> list[ClipSource]:
    """So many copies of the clips, one after the other."""
    folder.mkdir()
    files = sorted(options.folder.glob("*.mp4"))
    if not files:
        raise InputError(f"--folder: {options.folder} holds no mp4 file; expected a folder of clips")
    sources = []
    for k in range(options.clips):
        path = folder / f"{k:04d}.mp4"
        shutil.copyfile(files[k % len(files)], path)
        sources.append(ClipSource(path, "video", path.stem))
    return sources


def _measure(
    predictor: PhysicsPredictor, sources: Sequence[ClipSource], folder: Path, options: argparse.Namespace
) -> Throughput:
    load = os.getloadavg()[0]
    steps, write = _host_steps(predictor, sources, folder)
    bare, bare_processor, extra = _network_steps(predictor, sources, options)
    total, steady, processor = _batch(predictor, sources, folder, options)
    named = sum(value for name, value in steps.items() if name != "finder_networks_processor")
    return Throughput(
        command=shlex.join(["python", *sys.argv]),
        machine=platform.processor() or platform.machine(),
        device=_device_name(options.device),
        cores=len(os.sched_getaffinity(0)),
        torch_threads=torch.get_num_threads(),
        load_before=load,
        wait_policy=os.environ["OMP_WAIT_POLICY"],
        network=options.checkpoint or f"untrained {options.size}",
        parameters=sum(p.numel() for p in predictor.network.parameters()),
        clips=len(sources),
        batch_size=options.batch_size,
        bare_network=bare,
        bare_network_processor=bare_processor,
        **steps,
        estimate_extra=extra,
        write=write,
        batch_total=total,
        batch_steady=steady,
        batch_processor=processor,
        share_of_bare_total=bare / total,
        share_of_bare_steady=bare / steady,
        networks_share_of_host=(bare_processor + steps["finder_networks_processor"]) / (bare_processor + named),
        share_of_bare_processor=bare_processor / processor,
    )


def _device_name(device: str) -> str:
    return torch.cuda.get_device_name(device) if device.startswith("cuda") else device


def _seconds(work: Callable[[], object], repeats: int, device: str = "cpu") -> float:
    """Best wall time of `repeats` runs."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        if device.startswith("cuda"):
            torch.cuda.synchronize()
        times.append(time.perf_counter() - start)
    return min(times)


def _processor_seconds(work: Callable[[], object]) -> float:
    """Least processor time of two runs."""
    times = []
    for _ in range(2):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return min(times)


@contextmanager
def _finder_networks() -> Iterator[list[float]]:
    """Processor seconds of each forward pass of the finder's networks while this is open."""
    found: list[float] = []
    begun: list[float] = []
    kinds = (SilhouetteSegmenter, OutlineNetwork)

    def before(module: torch.nn.Module, _: object) -> None:
        if isinstance(module, kinds):
            begun.append(time.process_time())

    def after(module: torch.nn.Module, _: object, __: object) -> None:
        if isinstance(module, kinds):
            found.append(time.process_time() - begun.pop())

    handles = register_module_forward_pre_hook(before), register_module_forward_hook(after)
    try:
        yield found
    finally:
        for handle in handles:
            handle.remove()


def _host_steps(
    predictor: PhysicsPredictor, sources: Sequence[ClipSource], folder: Path
) -> tuple[dict[str, float], float]:
    """Processor time of each step of the host, and wall time of writing, means over a sample of clips."""
    sample, settings = sources[: min(16, len(sources))], StatedConditions()
    cv2.setNumThreads(1)
    loaded = [load_clip(source) for source in sample]
    decode = _processor_seconds(lambda: [load_clip(source) for source in sample])
    prepared = [predictor.prepare(clip.frames, fps=clip.fps or 24.0) for clip in loaded]
    find = _processor_seconds(lambda: [predictor.prepare(clip.frames, fps=clip.fps or 24.0) for clip in loaded])
    with _finder_networks() as passes:
        for clip in loaded:
            predictor.prepare(clip.frames, fps=clip.fps or 24.0)
    pairs = list(zip(loaded, prepared, strict=True))
    picture = _processor_seconds(lambda: [frame_strip(*pair) for pair in pairs])
    ready = [ready_source(source, settings, predictor.prepare, picture=True) for source in sample]
    ones = [1.0] * len(sample)
    estimates = predictor.estimate(prepared, density=[1000.0 * one for one in ones], object_size=ones)
    predictions = [to_prediction(*pair) for pair in zip(ready, estimates, strict=True)]

    def write() -> None:
        with ResultsFolder(folder / "written", settings="") as results:
            for clip, prediction in zip(ready, predictions, strict=True):
                assert clip.source is not None
                maps = weight_maps(prediction.skinning_field, clip.prepared.mask[0], 1.0)
                pictures = ClipPictures(frames=clip.picture, weights=maps)
                results.add_prediction(clip.source, clip.source.title, "", prediction, pictures)

    seconds = {"decode": decode, "find_and_crop": find, "finder_networks": sum(passes), "picture": picture}
    seconds["write"] = _processor_seconds(write)
    cv2.setNumThreads(-1)
    steps = {f"{name}_processor": value / len(sample) for name, value in seconds.items()}
    return steps, _seconds(write, 2) / len(sample)


def _network_steps(
    predictor: PhysicsPredictor, sources: Sequence[ClipSource], options: argparse.Namespace
) -> tuple[float, float, float]:
    """Bare network: wall and processor time; what `estimate` takes beyond it."""
    clips = [predictor.prepare(load_clip(source).frames) for source in sources]
    groups = [clips[k : k + options.batch_size] for k in range(0, len(clips), options.batch_size)]
    batches = [
        collate_clips(
            group,
            dimensionless_interval(np.array([clip.fps for clip in group]), object_size=np.ones(len(group))),
            predictor.clip_config,
        ).to(predictor.device)
        for group in groups
    ]

    @torch.inference_mode()
    def bare() -> None:
        for batch in batches:
            answer_both_ways(predictor.network, batch)

    def estimate() -> None:
        for group in groups:
            ones = [1.0] * len(group)
            predictor.estimate(group, density=ones, object_size=ones)

    bare()
    before = time.process_time()
    bare_wall = _seconds(bare, options.repeats, options.device)
    processor = (time.process_time() - before) / options.repeats
    whole = _seconds(estimate, options.repeats, options.device)
    return bare_wall / len(clips), processor / len(clips), (whole - bare_wall) / len(clips)


def _batch(
    predictor: PhysicsPredictor, sources: Sequence[ClipSource], folder: Path, options: argparse.Namespace
) -> tuple[float, float, float]:
    """Whole and steady wall time and processor time per clip; the fastest run counts."""
    runs = []
    for repeat in range(options.repeats):
        ticks: list[float] = []
        before, start = _processor_time(), time.perf_counter()
        summary = predict_batch(
            folder / "clips",
            out=folder / f"out{repeat}",
            predictor=predictor,
            batch_size=options.batch_size,
            workers=options.workers,
            on_row=lambda row, ticks=ticks: ticks.append(time.perf_counter()),
        )
        total, processor = time.perf_counter() - start, _processor_time() - before
        assert summary.predicted == len(sources), summary
        steady = (ticks[-1] - ticks[0]) / (len(ticks) - 1)
        runs.append((total / len(sources), steady, processor / len(sources)))
    return min(runs)


def _processor_time() -> float:
    own, children = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return own.ru_utime + own.ru_stime + children.ru_utime + children.ru_stime


if __name__ == "__main__":
    main()
