"""The main charts: `tessera chart` on the project's scenes, and on others where they are."""

import pathlib

from charts import pages
from tessera_chart import command, drawing, methods, programs, report, results

# Name -> flags of the view; the project's own.
OWN = {"cornell": "", "window_room": "--sky 3,3,3", "still_life": "", "veach_mis": "",
       "wires": "--sky 1,1,1"}
# Of the folder of --scenes: name -> file and flags.
OTHERS = {"kitchen": ("apartment.glb", "--sky 2,2,2 --look-from 7,1.7,-6.8 --look-at 10.8,0.9,-4.2 "
                                       "--fov-y 65")}
FLAGS = ("--size", "128x72", "--spp", "4,16,64", "--seeds", "2", "--reference", "512")
QUICK_FLAGS = ("--size", "32x18", "--spp", "1,2", "--seeds", "1", "--reference", "8")


def _run(arguments: list) -> None:
    """Errors: RuntimeError if the command ends with an error, KeyboardInterrupt if stopped."""
    code = command.main([str(a) for a in arguments])
    if code == command.EXIT_CANCELLED:
        raise KeyboardInterrupt
    if code != 0:
        raise RuntimeError("tessera chart failed")


def _chart(args, scenes: list[str], method_names: list[str], folder: pathlib.Path) -> list[dict]:
    oidn = ["--oidn", args.oidn, "--oidn-weights", args.oidn_weights] if args.oidn else []
    if oidn:
        method_names = method_names + [methods.OIDN]
    _run([*scenes, "-o", folder, "--tessera", args.build / "bin" / "tessera", "--methods",
          ",".join(method_names), *oidn, *(QUICK_FLAGS if args.quick else FLAGS)])
    return results.read_points(folder / "points.json")


def _methods(args) -> list[str]:
    """All filters, of the previews ours alone, and adaptive sampling."""
    tessera = programs.Tessera(str(args.build / "bin" / "tessera"))
    return [m.name for m in methods.filters_of(tessera.denoisers())
            if m.quality == "final" or m.denoiser == "regression"] + [methods.ADAPTIVE]


def _tables(rows: list[dict], names: list[str]) -> str:
    """For each scene who wins, and equivalent samples by method and sample count."""
    parts = []
    for name in names:
        by_method = results.means_of(rows, name)
        who_wins = results.sentence(name, by_method).split(": ", 1)[1]
        parts.append(f"**{name}**: {who_wins}\n\n"
                     + report.multiplier_table(results.multipliers(by_method), as_html=False))
    return "\n\n".join(parts)


def _claim(rows: list[dict], names: list[str]) -> str:
    """Baseline 0's equivalent samples: defaults, and thresholds tuned on the very picture."""
    found, counts = {}, set()
    for name in names:
        for method, spp, times in results.multipliers(results.means_of(rows, name)):
            found[name, method, spp] = times
            counts.add(spp)
    lines = []
    for name in names:
        cells = []
        for method in ("geometric", "geometric-best", "regression"):
            for spp in sorted(counts):
                times = found.get((name, method, spp))
                text = "" if times is None else f"{times:.2f}"
                cells.append(f"**{text}**" if times is not None and times < 1 else text)
        lines.append([name, *cells])
    header = ["scene"] + [f"{m}, {n:g}" for m in ("geometric", "-best", "regression")
                          for n in sorted(counts)]
    return pages.table(header, lines)


def make(args, work: pathlib.Path, page: pathlib.Path | None) -> None:
    """`args` of regenerate_charts.py."""
    folder = work / "scenes"
    own = [f"{name}={args.build.resolve() / 'scenes' / (name + '.glb')} {flags}"
           for name, flags in OWN.items()]
    if args.quick:
        own = own[:1]
    elif args.scenes:
        own += [f"{name}={args.scenes / file} {flags}" for name, (file, flags) in OTHERS.items()]
    names = [scene.split("=")[0] for scene in own]
    chosen = ["raw", "regression", "geometric"] if args.quick else _methods(args)
    rows = _chart(args, own, chosen, folder)
    floors = results.read_settings(folder / "points.json")["noise_floor"]
    if args.cycles:
        # Slow to start, so on two scenes only; what is finished above is not done again.
        with_peer = [s for s in own if s.split("=")[0] in ("cornell", "kitchen")]
        found = _chart(args, with_peer, [*chosen, methods.CYCLES], folder)
        rows += [r for r in found if r["method"] == methods.CYCLES]
    drawing.draw_main(rows, names, floors, args.out / "accuracy", png=False)
    drawing.draw_multipliers(rows, names, args.out / "multipliers", png=False)
    for name in ("still_life", "kitchen"):
        if name in names:
            drawing.draw_scene(results.means_of(rows, name), f"{name}, {FLAGS[1]} pixels",
                               floors[name], args.out / f"scene-{name}", png=False)
    results.write_csv(rows, args.out / "scenes.csv")
    if page:
        pages.replace_part(page, "scenes", _tables(rows, names))
        pages.replace_part(page, "claim", _claim(rows, names))
