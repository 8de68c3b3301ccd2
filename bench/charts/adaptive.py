"""Whether sampling that the samples themselves decide moves the mean: `--target-error` against the
same number of samples for all seeds."""

import functools

import numpy
import OpenImageIO as oiio

from charts.sweeps import mean_and_error
from tessera_chart import lanes

NUM_SEEDS = 12
# One for each severity: such that renders stop early, and not all at the same count.
TARGETS = (0.05, 0.1, 0.15, 0.3)
SPP_MAX = 256


def _raw_mean(path) -> float:
    picture = oiio.ImageBuf(str(path))
    names = list(picture.spec().channelnames)
    pixels = picture.get_pixels(oiio.FLOAT).astype(numpy.float64)
    return float(pixels[:, :, [names.index(f"raw.{c}") for c in "RGB"]].mean())


def _render(each, kind: str, seed: int, goal: tuple) -> None:
    key = f"{kind}.{seed}"
    if each.store.get(key):
        return
    plan = each.plan
    out = each.store.path(key + ".exr")
    figures, _ = plan.tessera.run(
        "render", each.view.file, *each.view.flags, "--size", plan.size, "--seed", seed, "--threads",
        1, "--quiet", *goal, "--layers", "final,raw", "-o", out)
    each.store.put(key, {"spp": figures["spp"], "mean": _raw_mean(out)})
    out.unlink()


def measure(run, sweep) -> list[dict]:
    """By severity of `sweep`: bias of the raw mean relative to the reference's, with its standard
    error over seeds, when the error asked for ends the render, and at the number of samples that
    this takes on average."""
    seeds = range(101, 101 + (1 if run.quick else NUM_SEEDS))
    most = 8 if run.quick else SPP_MAX

    def work(each, target: float) -> None:
        for seed in seeds:
            _render(each, "adaptive", seed, ("--target-error", target, "--spp", most))
        counts = [each.store.get(f"adaptive.{s}")["spp"] for s in seeds]
        spp = max(2, round(sum(counts) / len(counts)))
        for seed in seeds:
            _render(each, "uniform", seed, ("--spp", spp))

    chosen = [sweep.ladder_of(at)[0] for at in range(len(sweep.values))]
    lanes.run([functools.partial(work, *pair) for pair in zip(chosen, TARGETS)],
              1 if run.quick else 2)
    rows = []
    for value, each in zip(sweep.values, chosen):
        truth = each.reference().mean.mean()
        for kind in ("uniform", "adaptive"):
            found = [each.store.get(f"{kind}.{s}") for s in seeds]
            mean, error = mean_and_error([f["mean"] / truth - 1 for f in found])
            rows.append({"severity": value, "kind": kind, "seeds": len(found),
                         "spp": sum(f["spp"] for f in found) / len(found),
                         "least_spp": min(f["spp"] for f in found),
                         "greatest_spp": max(f["spp"] for f in found),
                         "bias": mean, "bias_error": error})
    return rows
