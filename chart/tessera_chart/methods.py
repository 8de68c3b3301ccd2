"""What is compared: the program's filters, a search over a filter's numbers, and peers."""

import dataclasses
import itertools
import pathlib

from tessera_chart.errors import BadInput

RAW = "raw"
ADAPTIVE = "adaptive"
CYCLES = "cycles"
OIDN, OIDN_HQ = "oidn", "oidn-hq"
ORACLE_SUFFIX = "-best"

# What a filter's numbers are tried at when the best are searched; names as the program has them.
SEARCHED = {"radius": (0.125, 0.5, 1, 2, 4, 8, 32), "depth": (0.01, 0.05, 0.2, 1e6),
            "normal": (-1, 0.5, 0.9, 0.98)}


@dataclasses.dataclass(frozen=True)
class Method:
    """A row of the charts."""

    name: str
    denoiser: str = ""  # of tessera; empty: not one of its filters
    quality: str = "final"
    options: tuple[tuple[str, float], ...] = ()
    searched: tuple[str, ...] = ()  # options whose best values are searched

    def flags(self, options: dict[str, float] | None = None) -> list[str]:
        """Of `tessera denoise`."""
        flags = ["--denoiser", self.denoiser, "--quality", self.quality]
        for name, value in (options or dict(self.options)).items():
            flags += ["--denoiser-option", f"{name}={value:g}"]
        return flags


def filters_of(denoisers: list[dict]) -> list[Method]:
    """All filters of the program, in its order: both qualities where they are two filters, and the
    oracle of those that have numbers to be set."""
    found = [Method(RAW, "none")]
    for entry in denoisers:
        name = entry["name"]
        if name == "none":
            continue
        found.append(Method(name, name))
        if entry["halo_px"]["preview"] != entry["halo_px"]["final"]:
            found.append(Method(name + "-preview", name, "preview"))
        searched = tuple(o["name"] for o in entry["options"] if o["name"] in SEARCHED)
        if searched:
            defaults = tuple((o["name"], o["value"]) for o in entry["options"])
            found.append(Method(name + ORACLE_SUFFIX, name, options=defaults, searched=searched))
    return found


def choose(text: str | None, denoisers: list[dict], oidn: bool) -> list[Method]:
    """The methods of --methods; by default all filters, and the network if it is given.

    Errors: BadInput naming what is known.
    """
    known = filters_of(denoisers) + [Method(n) for n in (ADAPTIVE, CYCLES, OIDN, OIDN_HQ)]
    by_name = {m.name: m for m in known}
    if text is None:
        return [m for m in known if m.denoiser or (m.name in (OIDN, OIDN_HQ) and oidn)]
    chosen = []
    for name in text.split(","):
        names = [m.name for m in known if m.denoiser] if name == "all" else [name]
        for n in names:
            if n not in by_name:
                raise BadInput(f"--methods {n}: unknown; use all or some of " + ",".join(by_name))
            if by_name[n] not in chosen:
                chosen.append(by_name[n])
    if by_name[RAW] not in chosen:
        chosen.insert(0, by_name[RAW])  # what all others are compared with
    for name in (OIDN, OIDN_HQ):
        if by_name[name] in chosen and not oidn:
            raise BadInput(f"--methods {name}: needs --oidn PROGRAM and --oidn-weights FOLDER")
    # Its target is a filter's error, whatever the order in which they were named.
    return sorted(chosen, key=lambda m: m.name == ADAPTIVE)


def search(method: Method, error_of) -> tuple[dict[str, float], int]:
    """The best options by coordinate descent over SEARCHED, two rounds, and how many were tried.

    `error_of(options)` measures one choice, reference in hand: an oracle, not a method.
    """
    best = dict(method.options)
    seen = {tuple(best.items()): error_of(best)}
    for _, name in itertools.product(range(2), method.searched):
        for value in SEARCHED[name]:
            tried = {**best, name: value}
            if tuple(tried.items()) not in seen:
                seen[tuple(tried.items())] = error_of(tried)
        best = dict(min(seen, key=seen.get))
    return best, len(seen)

