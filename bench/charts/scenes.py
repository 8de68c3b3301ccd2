"""The main charts: `tessera chart` on the project's scenes, and on others where they are."""

import shutil

from charts import pages
from tessera_chart import command, drawing, methods, report, results

# Name -> flags of the view; the project's own.
OWN = {"window_room": "--sky 3,3,3", "veach_mis": "", "still_life": "", "cornell": "",
       "wires": "--sky 1,1,1"}
# Of the folder of --scenes: name -> file and flags.
OTHERS = {"kitchen": ("apartment.glb", "--sky 2,2,2 --look-from 7,1.7,-6.8 --look-at 10.8,0.9,-4.2 "
                                       "--fov-y 65")}
# The frame that times are said for: small enough that 1 s is more than a sample or two, large enough
# that 60 s are not beyond the ladder.
FRAME = "320x180"
SIZE = "128x72"
FLAGS = ("--size", SIZE, "--frame", FRAME, "--spp", "2,8,32,128,512", "--seeds", "2", "--reference",
         "1024", "--jobs", "2")
# One scene at the frame's own size, alone on all cores: are times in proportion to pixels, and what
# are they on a clock?
WHOLE = "still_life"
WHOLE_FLAGS = ("--size", FRAME, "--spp", "2,8,32,128", "--seeds", "1", "--reference", "256")
QUICK_FLAGS = ("--size", "32x18", "--frame", "64x36", "--spp", "1,2", "--seeds", "1", "--reference",
               "8")


def _run(arguments: list) -> None:
    """Errors: RuntimeError if the command ends with an error, KeyboardInterrupt if stopped."""
    code = command.main([str(a) for a in arguments])
    if code == command.EXIT_CANCELLED:
        raise KeyboardInterrupt
    if code != 0:
        raise RuntimeError("tessera chart failed")


def _chart(run, scenes: list[str], method_names: list[str], name: str, flags: tuple) -> list[dict]:
    oidn = ["--oidn", run.oidn, "--oidn-weights", run.oidn_weights] if run.oidn else []
    folder = run.work / name
    _run([*scenes, "-o", folder, "--tessera", run.bin("tessera"), "--methods",
          ",".join(method_names), *oidn, *flags])
    return results.read_points(folder / "points.json")


def _methods(run) -> list[str]:
    """All filters, of the previews ours alone; adaptive sampling; the peers that are here."""
    chosen = [m.name for m in methods.filters_of(run.tessera.denoisers())
              if m.quality == "final" or m.denoiser == "regression"] + [methods.ADAPTIVE]
    if run.has_oidn():
        chosen += [methods.OIDN, methods.OIDN_HQ]
    return chosen + ([methods.CYCLES] if shutil.which("blender") else [])


def _tables(rows: list[dict], names: list[str], uncertainty: dict) -> str:
    """For each scene who wins, and equivalent samples by method and sample count."""
    parts = []
    for name in names:
        by_method = results.means_of(rows, name)
        who_wins = results.sentence(name, by_method, uncertainty=uncertainty[name]).split(": ", 1)[1]
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
    return "\n".join([pages.table(header, lines), "", *_claim_in_words(found)])


def _claim_in_words(found: dict) -> list[str]:
    """Where baseline 0 reaches the 4 of the claim, how far it comes, and where it harms."""
    words = []
    for method, text in (("geometric", "default thresholds"),
                         ("geometric-best", "the best thresholds for the very picture")):
        of = {(scene, spp): times for (scene, m, spp), times in found.items() if m == method}
        if not of:
            continue
        (scene, spp), most = max(of.items(), key=lambda item: item[1])
        reached = [f"{s} at {n:g}" for (s, n), times in of.items() if times >= 4]
        words.append(f"- With {text} 4 is reached " + (", ".join(reached) if reached else "nowhere")
                     + f"; the most is {most:.1f} ({scene} at {spp:g} samples). It is below 1 in "
                     f"{sum(t < 1 for t in of.values())} of {len(of)} cells.")
    return words


def _whole_frame(run, small: list[dict], scene: str, chosen: list[str]) -> str:
    """Charts of WHOLE at its own size; a table of CPU seconds there over those in proportion."""
    rows = _chart(run, [scene], chosen, "whole", WHOLE_FLAGS)
    floor = results.read_settings(run.work / "whole" / "points.json")["noise_floor"][WHOLE]
    by_method = results.means_of(rows, WHOLE)
    drawing.draw_scene(by_method, command.title_of(WHOLE, FRAME, None), floor,
                       run.made / "scene-whole", png=False)
    results.write_csv(rows, run.made / "whole.csv")
    scaled = {(p.method, p.spp): p.values["total_cpu_s"]
              for points in results.means_of(small, WHOLE).values() for p in points}
    counts = [p.spp for p in by_method[methods.RAW]]
    lines = []
    for method, points in by_method.items():
        cells = [f"{p.values['total_cpu_s']:.2f} / {scaled[method, p.spp]:.2f} / "
                 f"{p.values['total_s']:.2f}" for p in points if (method, p.spp) in scaled]
        lines.append([method, *cells])
    return (results.sentence(WHOLE, by_method) + "\n\n" + results.sentence(
        WHOLE, by_method, "total_s") + "\n\n" + pages.table(
            ["method", *(f"{c:g} spp" for c in counts)], lines))


def make(run) -> None:
    own = [f"{name}={run.build.resolve() / 'scenes' / (name + '.glb')} {flags}"
           for name, flags in OWN.items()]
    if run.quick:
        own = own[-2:-1]
    elif run.scenes:
        # Not last: it takes long, and nothing would run beside it.
        own[1:1] = [f"{name}={run.scenes / file} {flags}" for name, (file, flags) in OTHERS.items()]
    names = [scene.split("=")[0] for scene in own]
    chosen = ["raw", "regression"] if run.quick else _methods(run)
    rows = _chart(run, own, chosen, "scenes", QUICK_FLAGS if run.quick else FLAGS)
    settings = results.read_settings(run.work / "scenes" / "points.json")
    floors = settings["noise_floor"]
    drawing.draw_main(rows, names, floors, run.made / "accuracy", png=False)
    drawing.draw_multipliers(rows, names, run.made / "multipliers", png=False)
    for name in ("still_life", "kitchen"):
        if name in names:
            drawing.draw_scene(results.means_of(rows, name), command.title_of(name, SIZE, FRAME),
                               floors[name], run.made / f"scene-{name}", png=False)
    results.write_csv(rows, run.made / "scenes.csv")
    run.add_part("charts.md", "scenes", _tables(rows, names, settings["uncertainty"]))
    run.add_part("charts.md", "claim", _claim(rows, names))
    if WHOLE in names:
        run.add_part("charts.md", "whole",
                     _whole_frame(run, rows, own[names.index(WHOLE)],
                                  [m for m in chosen if m not in (methods.CYCLES, methods.ADAPTIVE)
                                   and not m.endswith(methods.ORACLE_SUFFIX)]))
