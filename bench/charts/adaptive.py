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


def _key(kind: str, seed: int, goal: tuple) -> str:
    """Names all that decides the result and that the store's folder does not."""
    return ".".join([kind, str(seed), *(str(g).lstrip("-") for g in goal)])


def _render(each, kind: str, seed: int, goal: tuple) -> dict:
    """`spp` and the raw `mean`, measured or taken up."""
    key = _key(kind, seed, goal)
    found = each.store.get(key)
    if found is not None:
        return found
    plan = each.plan
    out = each.store.path(key + ".exr")
    figures, _ = plan.tessera.run(
        "render", each.view.file, *each.view.flags, "--size", plan.size, "--seed", seed, "--threads",
        1, "--quiet", *goal, "--layers", "final,raw", "-o", out)
    found = {"spp": figures["spp"], "mean": _raw_mean(out)}
    each.store.put(key, found)
    out.unlink()
    return found


def measure(run, sweep) -> list[dict]:
    """By severity of `sweep`: bias of the raw mean relative to the reference's, with its standard
    error over seeds, when the error asked for ends the render, and at the number of samples that
    this takes on average."""
    seeds = range(101, 101 + (1 if run.quick else NUM_SEEDS))
    most = 8 if run.quick else SPP_MAX

    by_severity: list[dict[str, list[dict]]] = [{} for _ in sweep.values]

    def work(each, target: float, of: dict[str, list[dict]]) -> None:
        goal = ("--target-error", target, "--spp", most)
        of["adaptive"] = [_render(each, "adaptive", seed, goal) for seed in seeds]
        counts = [found["spp"] for found in of["adaptive"]]
        goal = ("--spp", max(2, round(sum(counts) / len(counts))))
        of["uniform"] = [_render(each, "uniform", seed, goal) for seed in seeds]

    chosen = [sweep.ladder_of(at)[0] for at in range(len(sweep.values))]
    lanes.run([functools.partial(work, *piece) for piece in zip(chosen, TARGETS, by_severity)],
              1 if run.quick else 2)
    rows = []
    for value, each, of in zip(sweep.values, chosen, by_severity):
        truth = each.reference().mean.mean()
        for kind in ("uniform", "adaptive"):
            found = of[kind]
            mean, error = mean_and_error([f["mean"] / truth - 1 for f in found])
            rows.append({"severity": value, "kind": kind, "seeds": len(found),
                         "spp": sum(f["spp"] for f in found) / len(found),
                         "least_spp": min(f["spp"] for f in found),
                         "greatest_spp": max(f["spp"] for f in found),
                         "bias": mean, "bias_error": error})
    return rows
