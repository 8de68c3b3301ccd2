"""One HTML file: charts, sentences, and the pictures side by side. Needs no network and no server."""

import base64
import html
import io
import json
import pathlib

import numpy
from matplotlib import colormaps, image

from tessera_chart import measures, methods

PICTURE_WIDTH_MAX = 640
ERROR_SHOWN_MAX = 0.5  # relative error that is drawn in the brightest colour


def _png(display: numpy.ndarray) -> str:
    """A data URI of height x width x 3 in [0, 1]."""
    step = -(-display.shape[1] // PICTURE_WIDTH_MAX)
    if step > 1:  # whole blocks are averaged
        h, w = (display.shape[0] // step) * step, (display.shape[1] // step) * step
        display = display[:h, :w].reshape(h // step, step, w // step, step, 3).mean(axis=(1, 3))
    out = io.BytesIO()
    image.imsave(out, numpy.clip(display, 0, 1), format="png")
    return "data:image/png;base64," + base64.b64encode(out.getvalue()).decode()


def _difference(picture: numpy.ndarray, reference: numpy.ndarray) -> numpy.ndarray:
    """|x - r| / (r + 0.1), mean over channels, in false colour."""
    relative = (numpy.abs(picture - reference) / (numpy.abs(reference) + 0.1)).mean(axis=2)
    return colormaps["inferno"](numpy.clip(relative / ERROR_SHOWN_MAX, 0, 1))[:, :, :3]


def pictures_of(ladder) -> dict:
    """For the page: the reference, and by sample count and method picture, difference and errors."""
    reference = ladder.reference()
    seed = ladder.plan.seeds[0]
    shown = {"reference": _png(measures.srgb_encode(reference.mean)), "spp": {}}
    for spp in ladder.plan.spp:
        found = {}
        for method in ladder.plan.methods:
            if method.name == methods.CYCLES:
                continue
            path = ladder.picture(method.name, seed, spp)
            result = ladder.store.get(ladder.key(method.name, seed, spp))
            if result is None or not path.is_file():
                continue
            picture = measures.read_rgb(path)
            found[method.name] = {
                "picture": _png(measures.srgb_encode(picture)),
                "difference": _png(_difference(picture, reference.mean)),
                "text": f"relMSE {result['rel_mse']:.3g}, FLIP {result['flip']:.3g}"}
        if found:
            shown["spp"][str(spp)] = found
    return shown


_PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>tessera chart</title>
<meta name="viewport" content="width=device-width">
<style>
body{font:15px/1.5 system-ui,sans-serif;margin:0 auto;max-width:1200px;padding:1em;color:#222}
h2{margin-top:2em;border-top:1px solid #ddd;padding-top:1em}
img.chart{width:100%}
.viewer{position:relative;width:100%;background:#eee;line-height:0}
.viewer img{width:100%;display:block;image-rendering:pixelated}
.viewer .over{position:absolute;inset:0}
.viewer .line{position:absolute;top:0;bottom:0;width:2px;background:#fff;box-shadow:0 0 2px #000}
.controls{display:flex;flex-wrap:wrap;gap:.4em 1.2em;align-items:center;margin:.5em 0}
input[type=range]{width:100%;margin:.3em 0}
table{border-collapse:collapse;margin:1em 0}td,th{padding:.15em .7em;text-align:right;
border-bottom:1px solid #eee}td:first-child,th:first-child{text-align:left}
.below{color:#b00020}.note{color:#666}
</style></head><body>
<h1>Accuracy against time</h1>
%INTRO%
%SCENES%
<script>
const DATA = %DATA%;
for (const [scene, data] of Object.entries(DATA)) {
  const root = document.querySelector(`[data-scene="${CSS.escape(scene)}"]`);
  const at = name => root.querySelector(name);
  const counts = Object.keys(data.spp).sort((a, b) => a - b);
  const fill = (select, names, chosen) => {
    select.replaceChildren(...names.map(n => new Option(n, n)));
    select.value = names.includes(chosen) ? chosen : names[0];
  };
  fill(at('.spp'), counts, counts[Math.floor(counts.length / 2)]);
  const methods = () => ['reference', ...Object.keys(data.spp[at('.spp').value])];
  fill(at('.left'), methods(), 'raw');
  fill(at('.right'), methods(), 'regression');
  const source = name => name === 'reference'
    ? {picture: data.reference, difference: data.reference, text: 'mean of the references'}
    : data.spp[at('.spp').value][name];
  const show = () => {
    const which = at('.difference').checked ? 'difference' : 'picture';
    const left = source(at('.left').value), right = source(at('.right').value);
    at('.under').src = right[which];
    at('.over').src = left[which];
    const x = at('.split').value;
    at('.over').style.clipPath = `inset(0 ${100 - x}% 0 0)`;
    at('.line').style.left = x + '%';
    at('.figures').textContent = `left: ${at('.left').value}, ${left.text}; ` +
      `right: ${at('.right').value}, ${right.text}` +
      (which === 'difference' ? '; shown is |x - r| / (r + 0.1), black 0 to yellow 0.5 and more' : '');
  };
  at('.spp').onchange = () => {
    const chosen = [at('.left').value, at('.right').value];
    fill(at('.left'), methods(), chosen[0]);
    fill(at('.right'), methods(), chosen[1]);
    show();
  };
  for (const name of ['.left', '.right', '.difference', '.split']) at(name).oninput = show;
  show();
}
</script></body></html>
"""

_SCENE = """<h2>{name}</h2><p>{sentence}</p>
<img class="chart" alt="errors against time, samples and bytes: {name}" src="{chart}">
<div data-scene="{name}">
<div class="controls"><label>samples per pixel <select class="spp"></select></label>
<label>left <select class="left"></select></label>
<label>right <select class="right"></select></label>
<label><input type="checkbox" class="difference"> difference from the reference</label></div>
<div class="viewer"><img class="under" alt="right picture"><img class="over" alt="left picture">
<div class="line"></div></div>
<input type="range" class="split" min="0" max="100" value="50" aria-label="where the pictures meet">
<p class="figures note"></p></div>
<p>Equivalent samples, as a multiple of the samples taken (below 1 the filter does harm):</p>
{multipliers}
"""


def multiplier_table(rows: list[tuple[str, float, float]], as_html: bool = True) -> str:
    """Methods by sample counts, in HTML or Markdown; `rows` as results.multipliers gives them."""
    counts = sorted({spp for _, spp, _ in rows})
    by_method: dict[str, dict] = {}
    for method, spp, times in rows:
        by_method.setdefault(method, {})[spp] = times
    if not as_html:
        lines = ["| method | " + " | ".join(f"{c:g} spp" for c in counts) + " |",
                 "|---" * (len(counts) + 1) + "|"]
        for method, times in by_method.items():
            cells = [f"{times[c]:.2f}" if c in times else "" for c in counts]
            lines.append(f"| {method} | "
                         + " | ".join(f"**{c}**" if c and float(c) < 1 else c for c in cells) + " |")
        return "\n".join(lines)
    out = "<table><tr><th>method</th>" + "".join(f"<th>{c:g} spp</th>" for c in counts) + "</tr>"
    for method, times in by_method.items():
        cells = "".join(f'<td class="{"below" if times[c] < 1 else ""}">{times[c]:.2f}</td>'
                        if c in times else "<td></td>" for c in counts)
        out += f"<tr><td>{html.escape(method)}</td>{cells}</tr>"
    return out + "</table>"


def write(path: pathlib.Path, intro: list[str], scenes: list[dict]) -> None:
    """`scenes`: name, sentence, chart (an SVG file), multipliers, pictures."""
    parts, data = "", {}
    for scene in scenes:
        svg = base64.b64encode(scene["chart"].read_bytes()).decode()
        parts += _SCENE.format(name=html.escape(scene["name"]), sentence=html.escape(scene["sentence"]),
                               chart="data:image/svg+xml;base64," + svg,
                               multipliers=multiplier_table(scene["multipliers"]))
        data[scene["name"]] = scene["pictures"]
    page = _PAGE.replace("%INTRO%", "".join(f"<p>{html.escape(p)}</p>" for p in intro))
    page = page.replace("%SCENES%", parts).replace("%DATA%", json.dumps(data).replace("</", "<\\/"))
    path.write_text(page, encoding="utf-8")
