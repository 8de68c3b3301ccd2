// The page that a browser shows at /: every job with its picture, refreshed by itself.
#pragma once

namespace tessera {

inline constexpr char kIndexPage[] = R"html(<!doctype html>
<meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>Tessera</title>
<style>
  body { font: 15px system-ui, sans-serif; margin: 2em; background: #17181a; color: #ddd; }
  h1 { font-weight: 500; }
  #jobs { display: grid; grid-template-columns: repeat(auto-fill, minmax(20em, 1fr)); gap: 1.5em; }
  figure { margin: 0; }
  img { width: 100%; background: #000; min-height: 6em; }
  a { color: inherit; }
  figcaption { margin-top: .4em; line-height: 1.4; color: #aaa; }
  b { color: #eee; font-weight: 600; }
  progress { width: 100%; height: .5em; }
</style>
<h1>Tessera</h1>
<div id="jobs">No jobs yet.</div>
<script>
const states = {JOB_STATE_QUEUED: "queued", JOB_STATE_RUNNING: "rendering",
  JOB_STATE_PAUSED: "paused", JOB_STATE_FINISHING: "finishing", JOB_STATE_DONE: "done",
  JOB_STATE_CANCELLED: "cancelled", JOB_STATE_FAILED: "failed"};
const figures = new Map();
function show(job) {
  let figure = figures.get(job.name);
  if (!figure) {
    figure = document.createElement("figure");
    figure.innerHTML = '<a><img></a><progress></progress><figcaption></figcaption>';
    figure.querySelector("a").href = "/" + job.name + "/image.png";
    figures.set(job.name, figure);
    const list = document.getElementById("jobs");
    if (figures.size === 1) list.textContent = "";
    list.prepend(figure);
  }
  const p = job.progress || {};
  if (figure.counter !== job.revision.counter) {
    figure.counter = job.revision.counter;
    figure.querySelector("img").src = "/" + job.name + "/image.png?r=" + job.revision.counter;
  }
  const bar = figure.querySelector("progress");
  bar.max = Number(p.samples_total || 1);
  bar.value = Number(p.samples || 0);
  const s = job.settings;
  const caption = figure.querySelector("figcaption");
  caption.innerHTML = "<b></b> ";
  caption.firstChild.textContent = job.name + " " + (states[job.state] || "");
  caption.append(s.scene_name + ", " + s.width + "x" + s.height + ", " +
    (p.spp || 0).toFixed(1) + " of " + s.spp + " spp" +
    (p.estimated_error ? ", error " + p.estimated_error.toPrecision(2) : "") +
    (job.error ? ", " + job.error : "") + (job.waiting ? ", " + job.waiting : ""));
}
async function refresh() {
  try {
    const jobs = [];
    for (let page, after = 0; !page || page.length > 0; ) {
      page = (await (await fetch("/jobs?after=" + after)).json()).jobs || [];
      jobs.push(...page);
      if (page.length > 0) after = page[page.length - 1].name.slice("jobs/".length);
    }
    const names = new Set(jobs.map(job => job.name));
    for (const [name, figure] of figures) {
      if (!names.has(name)) { figure.remove(); figures.delete(name); }
    }
    jobs.forEach(show);
  } catch (error) { console.log(error); }
  setTimeout(refresh, 1000);
}
refresh();
</script>
)html";

}  // namespace tessera
