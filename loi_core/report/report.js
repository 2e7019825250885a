"use strict";

// A report is complete without this script, which compares, plays and saves pictures and reads charts.
const RELOAD_MS = 1500;
if (document.querySelector("main[data-running]")) setTimeout(() => location.reload(), RELOAD_MS);

for (const run of document.querySelectorAll("section.run")) {
  const picture = (key) => run.querySelector(`[data-picture="${CSS.escape(key)}"]`);
  const nameOf = (image) => (image ? image.closest("figure").querySelector("figcaption").textContent : "");
  const frames = [...run.querySelectorAll("figure.frame")];
  const charts = [...run.querySelectorAll("figure.chart")].map(readChart);
  const tools = run.querySelector(".tools");
  let current = 0;

  const compare = run.querySelector("figure.compare");
  const refresh = compare ? setUpDivider(compare) : () => {};
  const player = run.querySelector("figure.player");
  if (player) setUpPlayer(player);
  for (const link of run.querySelectorAll("a.save")) {
    const image = picture(link.dataset.of);
    if (image) {
      link.href = image.src;
      link.hidden = false;
    } else {
      link.closest("li").remove();
    }
  }
  for (const chart of charts) {
    chart.svg.addEventListener("pointermove", (event) => readAll(chart.stepAt(event)));
    chart.svg.addEventListener("pointerleave", () => readAll(stepShown()));
  }
  if (tools) tools.hidden = !(compare || player);
  readAll(stepShown());

  function put(image, source) {
    if (!source) return;
    image.src = source.src;
    image.alt = nameOf(source);
    image.className = `${image.className.split(" ")[0]}${source.classList.contains("pixels") ? " pixels" : ""}`;
    image.width = source.width || source.naturalWidth;
    image.height = source.height || source.naturalHeight;
    const ratio = source.getAttribute("width") / source.getAttribute("height");
    if (ratio) image.parentElement.style.maxWidth = `${Math.round(62 * ratio)}vh`;
  }

  function stepShown() {
    if (frames.length) return Number(frames[current].dataset.step);
    return charts.length ? charts[0].data.last : 0;
  }

  function readAll(step) {
    for (const chart of charts) chart.read(step);
  }

  function setUpDivider(figure) {
    const over = figure.querySelector(".over");
    const divider = figure.querySelector("input.divider");
    const halves = ["left", "right"].map((name) => ({
      image: figure.querySelector(`img.${name}`),
      select: figure.querySelector(`select.${name}`),
    }));
    const sourceOf = (key) => picture(key === "scrubber" ? `step-${frames[current].dataset.step}` : key);
    const show = () => {
      for (const { image, select } of halves) put(image, sourceOf(select.value));
      move();
    };
    const move = () => {
      over.style.setProperty("--cut", `${divider.value}%`);
      const [left, right] = halves.map(({ image }) => image.alt);
      divider.setAttribute("aria-valuetext", `${divider.value}% ${left}, then ${right}`);
    };
    const follow = (event) => {
      const box = over.getBoundingClientRect();
      divider.value = Math.round((100 * (event.clientX - box.left)) / box.width);
      move();
    };
    over.addEventListener("pointerdown", (event) => {
      event.preventDefault();
      over.setPointerCapture(event.pointerId);
      follow(event);
    });
    over.addEventListener("pointermove", (event) => {
      if (over.hasPointerCapture(event.pointerId)) follow(event);
    });
    divider.addEventListener("input", move);
    for (const { select } of halves) select.addEventListener("change", show);
    show();
    return () => {
      if (halves.some(({ select }) => select.value === "scrubber")) show();
    };
  }

  function setUpPlayer(figure) {
    const shown = figure.querySelector("img.shown");
    const caption = figure.querySelector(".caption");
    const scrubber = figure.querySelector("input.scrubber");
    const button = figure.querySelector("button");
    let timer = 0;
    const show = (index) => {
      current = index;
      const frame = frames[index];
      put(shown, frame.querySelector("img"));
      scrubber.value = index;
      const value = frame.dataset.value === "nan" ? "" : `, objective ${frame.dataset.value}`;
      caption.textContent = nameOf(frame.querySelector("img")) + value;
      scrubber.setAttribute("aria-valuetext", caption.textContent);
      refresh();
      readAll(stepShown());
    };
    const stop = () => {
      clearInterval(timer);
      timer = 0;
      button.textContent = "Play";
    };
    const play = () => {
      if (current >= frames.length - 1) show(0);
      button.textContent = "Pause";
      timer = setInterval(() => {
        if (current < frames.length - 1) show(current + 1);
        if (current >= frames.length - 1) stop();
      }, Math.max(60, 3000 / frames.length));
    };
    const toggle = () => (timer ? stop() : play());
    button.addEventListener("click", toggle);
    scrubber.addEventListener("input", () => {
      stop();
      show(Number(scrubber.value));
    });
    scrubber.addEventListener("keydown", (event) => {
      if (event.key !== " ") return;
      event.preventDefault();
      toggle();
    });
    show(frames.length - 1);
    const isStill = document.hidden || matchMedia("(prefers-reduced-motion: reduce)").matches;
    if (run === document.querySelector("section.run") && !isStill) play();
  }
}

function readChart(figure) {
  const svg = figure.querySelector("svg");
  const data = JSON.parse(figure.querySelector("script").textContent);
  const now = svg.querySelector(".now");
  const shown = [...figure.querySelectorAll(".at")];
  const width = svg.viewBox.baseVal.width;
  const span = data.last - data.first;
  const stepAt = (event) => {
    const box = svg.getBoundingClientRect();
    const fraction = ((event.clientX - box.left) / box.width - data.left) / (data.right - data.left);
    return Math.round(data.first + span * Math.min(1, Math.max(0, fraction)));
  };
  const read = (step) => {
    const fraction = Math.min(1, Math.max(0, (step - data.first) / span));
    const x = width * (data.left + fraction * (data.right - data.left));
    now.setAttribute("x1", x);
    now.setAttribute("x2", x);
    shown.forEach((label, line) => {
      const { steps, values } = data.lines[line];
      let index = 0;
      while (index + 1 < steps.length && steps[index + 1] <= step) index += 1;
      const value = values[index];
      label.textContent = data.fraction ? `${Math.round(100 * value)}%` : String(Number(value.toPrecision(4)));
    });
  };
  return { svg, data, stepAt, read };
}
