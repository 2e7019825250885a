"use strict";

// Asks the server of a fit that runs for its newest steps and image, and loads the report once it is over.
const main = document.querySelector("main.live");
const steps = Number(main.dataset.steps);
const names = main.dataset.names.split("|");
const newest = document.getElementById("newest");
const lost = main.querySelector(".lost");
const EVERY = 500;
const points = [];
let frame = 0;

const said = (value, digits) => (value === null ? "not finite" : String(Number(value.toPrecision(digits))));

function show(state) {
  if (state.from === 0 && points.length) points.length = 0;
  points.push(...state.points);
  if (state.frame && state.frame !== frame) {
    frame = state.frame;
    newest.src = `/frame.png?${frame}`;
    newest.hidden = false;
  }
  if (!points.length) return;
  const [objective, step, value, psnr] = points[points.length - 1];
  main.querySelector(".name").textContent = names[objective];
  main.querySelector(".now").textContent = `step ${step + 1} of ${steps}, PSNR ${said(psnr, 4)} dB, objective ${said(value, 4)}`;
  main.querySelector("progress").value = (objective + (step + 1) / steps) / names.length;
  for (const svg of main.querySelectorAll("svg")) draw(svg, svg.dataset.of);
}

function draw(svg, what) {
  const lines = names.map(() => []);
  const firsts = [];
  for (const [objective, step, value, psnr] of points) {
    firsts[objective] ??= value;
    const shown = what === "psnr" ? psnr : Math.log10(value / firsts[objective]);
    if (shown !== null && Number.isFinite(shown)) lines[objective].push([step, shown]);
  }
  const all = lines.flat().map(([, value]) => value);
  if (!all.length) return;
  let low = all.reduce((one, other) => Math.min(one, other));
  let high = all.reduce((one, other) => Math.max(one, other));
  if (what === "value") [low, high] = [Math.floor(low), Math.ceil(high)];
  if (high - low < 1e-9) [low, high] = [low - 1, high + 1];
  const x = (step) => 50 + (360 * step) / Math.max(1, steps - 1);
  const y = (value) => 180 - (165 * (value - low)) / (high - low);
  const parts = [];
  for (const value of [low, high]) {
    const text = element("text", { x: 44, y: y(value) + 4, "text-anchor": "end" });
    text.textContent = what === "value" ? String(Number((10 ** value).toPrecision(3))) : value.toFixed(1);
    parts.push(element("path", { class: "grid", d: `M50 ${y(value)}H410` }), text);
  }
  lines.forEach((line, index) => {
    const every = Math.max(1, Math.ceil(line.length / 400));
    const kept = line.filter((_, at) => at % every === 0 || at === line.length - 1);
    const drawn = kept.map(([step, value]) => `${x(step).toFixed(1)},${y(value).toFixed(1)}`).join(" ");
    parts.push(element("polyline", { class: `line c${index % 8}`, points: drawn }));
  });
  svg.replaceChildren(...parts);
}

function element(name, attributes) {
  const made = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  return made;
}

async function follow() {
  try {
    const answer = await fetch(`/state?known=${points.length}`, { cache: "no-store" });
    const state = await answer.json();
    lost.textContent = "";
    show(state);
    if (state.done) {
      location.reload();
      return;
    }
    setTimeout(follow, state.total > points.length ? 0 : EVERY);
  } catch {
    lost.textContent = "The fit no longer answers: it has ended, and report.html in its folder is its report.";
    setTimeout(follow, 4 * EVERY);
  }
}

follow();
