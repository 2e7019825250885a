/* Two one-dimensional pictures to play with, on the page "Why it works". Computes what LOIObjective computes for images
   of one row; tests/docs/test_play.py holds the two together. No library, no network. */
"use strict";
(() => {
  const SIZE = 128, HALF = 6, GOAL = 96, TAILS = 4;

  /* The pictures: a bar that covers pixels by exact area, on black or on a textured ground. */
  const TEXTURE = Float64Array.from({length: SIZE}, (_, i) => 0.3 + 0.08 * Math.sin(i * 0.9) + 0.05 * Math.sin(i * 0.37 + 1));
  function picture(place, brightness, textured) {
    return Float64Array.from({length: SIZE}, (_, i) => {
      const covered = Math.min(Math.max(Math.min(i + 1, place + HALF) - Math.max(i, place - HALF), 0), 1);
      return (textured ? TEXTURE[i] : 0) * (1 - covered) + brightness * covered;
    });
  }

  /* A Gaussian blur with mirrored ends, as a matrix. */
  function blurMatrix(scale) {
    if (scale === 0) return null;
    const radius = Math.ceil(8.6 * scale), rows = new Float64Array(SIZE * SIZE), period = 2 * SIZE;
    let total = 0;
    for (let d = -radius; d <= radius; d++) total += Math.exp(-0.5 * (d / scale) ** 2);
    for (let i = 0; i < SIZE; i++) {
      for (let d = -radius; d <= radius; d++) {
        let j = (((i + d) % period) + period) % period;
        if (j >= SIZE) j = period - 1 - j;
        rows[i * SIZE + j] += Math.exp(-0.5 * (d / scale) ** 2) / total;
      }
    }
    return rows;
  }
  function blur(matrix, values) {
    if (!matrix) return values;
    return Float64Array.from({length: SIZE}, (_, i) => {
      let sum = 0;
      for (let j = 0; j < SIZE; j++) sum += matrix[i * SIZE + j] * values[j];
      return sum;
    });
  }

  /* Equations 1, 3 and 4: the histogram around every pixel; one row for each level of intensity. */
  function levels(beta) {
    const count = Math.ceil(1 / beta + 2 * TAILS - 1e-9) + 1;
    return Array.from({length: count}, (_, k) => 0.5 + beta * (k - (count - 1) / 2));
  }
  function histograms(values, inner, beta, extent) {
    const seen = blur(inner, values), height = 1 / (Math.sqrt(2 * Math.PI) * beta);
    return levels(beta).map((level) => blur(extent, seen.map((v) => height * Math.exp(-0.5 * ((level - v) / beta) ** 2))));
  }
  /* Equation 5: what lies between the cumulative histograms of two pictures. */
  function localLoss(values, reference, inner, beta, extent) {
    const ours = inOrder(values, inner, beta), theirs = inOrder(reference, inner, beta);
    let loss = 0;
    ours.forEach((row, k) => {
      for (const difference of blur(extent, row.map((v, i) => v - theirs[k][i]))) loss += Math.abs(difference);
    });
    return loss * beta / SIZE;
  }
  function inOrder(values, inner, beta) {
    const sum = new Float64Array(SIZE);
    return histograms(values, inner, beta, null).map((row) => {
      for (let i = 0; i < SIZE; i++) sum[i] += row[i] * beta;
      return sum.slice();
    });
  }
  function pixelLoss(values, reference) {
    return values.reduce((sum, v, i) => sum + (v - reference[i]) ** 2, 0) / SIZE;
  }
  window.loiPlay = {picture, pixelLoss, goal: GOAL,
    localLoss: (values, reference, sigma, beta, alpha) =>
      localLoss(values, reference, blurMatrix(sigma), beta, blurMatrix(alpha))};

  /* What one can move. */
  const SLIDERS = [
    ["place", "Place of your bar", 8, 120, 1, 24, " px"],
    ["brightness", "Brightness of your bar", 0.2, 1, 0.05, 0.9, ""],
    ["sigma", "Inner scale sigma", 0, 12, 0.5, 1, " px"],
    ["beta", "Tonal scale beta", 0.05, 0.4, 0.025, 0.125, ""],
    ["alpha", "Extent scale alpha", 0, 60, 1, 45, " px"],
  ];
  const PLACES = Array.from({length: 57}, (_, i) => 8 + 2 * i);

  function start(root) {
    root.replaceChildren();
    const controls = add(root, "div", "loi-play-controls"), state = {textured: false};
    const inputs = {}, outputs = {};
    for (const [name, text, min, max, step, value, unit] of SLIDERS) {
      const label = add(controls, "label"), line = add(label, "span");
      add(line, "span").textContent = text;
      outputs[name] = add(line, "span");  // no <output>, which the label would take for what it names
      const input = inputs[name] = add(label, "input");
      Object.assign(input, {type: "range", min, max, step, value, name});
      state[name] = value;
      input.addEventListener("input", () => { stop(); put(name, Number(input.value)); });
      outputs[name].textContent = value + unit;
    }
    const label = add(controls, "label", "loi-play-check"), check = add(label, "input");
    check.type = "checkbox";
    label.append(" A textured ground");
    check.addEventListener("change", () => { stop(); put("textured", check.checked); });
    const buttons = add(controls, "div", "loi-play-buttons");
    for (const [key, text] of [["pixels", "Descend on pixels"], ["local", "Descend on histograms"]]) {
      const button = add(buttons, "button");
      button.type = "button";
      button.textContent = text;
      button.addEventListener("click", () => descend(key));
    }
    const views = add(root, "div", "loi-play-views");
    const canvas = {};
    for (const [name, title, height] of [["pictures", "The target (above) and your picture", 64],
      ["theirs", "Local histograms of the target: place across, intensity upwards", 110],
      ["ours", "Local histograms of your picture", 110],
      ["curves", "Loss against the place of the bar: local histograms (solid), pixels (dashed)", 150]]) {
      const figure = add(views, "figure");
      canvas[name] = add(figure, "canvas");
      canvas[name].height = height;
      canvas[name].setAttribute("role", "img");
      canvas[name].setAttribute("aria-label", title);
      add(figure, "figcaption").textContent = title;
    }
    const status = add(root, "p", "loi-play-status");
    status.setAttribute("aria-live", "polite");

    let pending = 0, running = 0, curves = null;
    function put(name, value) {
      state[name] = value;
      if (name in inputs) {
        inputs[name].value = value;
        outputs[name].textContent = Math.round(value * 1000) / 1000 + SLIDERS.find((one) => one[0] === name)[6];
      }
      if (name !== "place") curves = null;
      if (!pending) pending = requestAnimationFrame(() => { pending = 0; draw(); });
    }
    function stop() { cancelAnimationFrame(running); running = 0; }

    function losses() {
      const inner = blurMatrix(state.sigma), extent = blurMatrix(state.alpha);
      const reference = picture(GOAL, 0.9, state.textured);
      const at = (place) => picture(place, state.brightness, state.textured);
      return {
        reference, inner, extent,
        pixels: (place) => pixelLoss(at(place), reference),
        local: (place) => localLoss(at(place), reference, inner, state.beta, extent),
      };
    }
    function slope(loss, place) { return (loss(place + 0.5) - loss(place - 0.5)); }
    function way(slopeHere, size) {
      return Math.abs(slopeHere) < 1e-6 * size ? "is level" : slopeHere < 0 ? "falls to the right" : "falls to the left";
    }

    function descend(key) {
      stop();
      const now = losses(), loss = now[key], still = matchMedia("(prefers-reduced-motion: reduce)").matches;
      const most = Math.max(...PLACES.map((place) => loss(place))) || 1;
      let rate = 2, before = 0;
      function step() {
        const here = slope(loss, state.place);
        if (Math.abs(here) < 1e-6 * most || rate < 0.05) return false;
        if (before * here < 0) rate /= 2;
        before = here;
        put("place", Math.min(Math.max(state.place - rate * Math.sign(here), 8), 120));
        return true;
      }
      if (still) { for (let i = 0; i < 200 && step(); i++); return; }
      const go = () => { running = step() ? requestAnimationFrame(go) : 0; };
      go();
    }

    function draw() {
      const now = losses(), style = getComputedStyle(root);
      const ink = style.getPropertyValue("--color-foreground-primary").trim() || "#222";
      const soft = style.getPropertyValue("--color-foreground-muted").trim() || "#666";
      const accent = style.getPropertyValue("--color-brand-primary").trim() || "#9a3412";
      const mine = picture(state.place, state.brightness, state.textured);
      if (!curves) {
        curves = {pixels: PLACES.map(now.pixels), local: PLACES.map(now.local),
          theirs: histograms(now.reference, now.inner, state.beta, now.extent)};
      }
      const ratio = window.devicePixelRatio || 1, contexts = {};
      for (const [name, element] of Object.entries(canvas)) {
        const width = element.clientWidth, height = Number(element.dataset.height || element.height);
        element.dataset.height = height;
        element.width = width * ratio;
        element.height = height * ratio;
        element.style.height = height + "px";
        contexts[name] = element.getContext("2d");
        contexts[name].scale(ratio, ratio);
        contexts[name].w = width;
        contexts[name].h = height;
      }
      strip(contexts.pictures, now.reference, 0, 28);
      strip(contexts.pictures, mine, 36, 28);
      heat(contexts.theirs, curves.theirs, ink);
      heat(contexts.ours, histograms(mine, now.inner, state.beta, now.extent), ink);
      plot(contexts.curves, curves, state.place, {ink, soft, accent});
      const said = ["pixels", "local"].map((key) => way(slope(now[key], state.place), Math.max(...curves[key]) || 1));
      status.textContent = `The bar belongs at ${GOAL} px and is at ${Math.round(state.place * 10) / 10} px. ` +
        `Here the loss on pixels ${said[0]}, and the loss on local histograms ${said[1]}.`;
    }
    new MutationObserver(draw).observe(document.body, {attributes: true, attributeFilter: ["data-theme"]});
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
    new ResizeObserver(draw).observe(views);
    draw();
  }

  function add(parent, tag, name) {
    const element = document.createElement(tag);
    if (name) element.className = name;
    parent.append(element);
    return element;
  }
  /* Borders of equal cells on whole pixels of the screen, so that no seam shows between two. */
  function edges(context, length, count) {
    const fine = context.getTransform().a;
    return (i) => Math.round((i * length * fine) / count) / fine;
  }
  function strip(context, values, top, height) {
    const edge = edges(context, context.w, SIZE);
    values.forEach((v, i) => {
      const grey = Math.round(255 * v);
      context.fillStyle = `rgb(${grey} ${grey} ${grey})`;
      context.fillRect(edge(i), top, edge(i + 1) - edge(i), height);
    });
  }
  function heat(context, rows, ink) {
    const edge = edges(context, context.w, SIZE), level = edges(context, context.h, rows.length);
    const most = Math.max(...rows.map((row) => Math.max(...row)));
    context.fillStyle = ink;
    rows.forEach((row, k) => row.forEach((v, i) => {
      context.globalAlpha = Math.sqrt(v / most);
      context.fillRect(edge(i), context.h - level(k + 1), edge(i + 1) - edge(i), level(k + 1) - level(k));
    }));
    context.globalAlpha = 1;
  }
  function plot(context, curves, place, {ink, soft, accent}) {
    const x = (p) => (p / SIZE) * context.w, pad = 8;
    const y = (v, most) => context.h - pad - (v / most) * (context.h - 2 * pad);
    context.strokeStyle = soft;
    context.setLineDash([1, 3]);
    line(context, [[x(GOAL), 0], [x(GOAL), context.h]]);
    context.setLineDash([]);
    context.strokeStyle = ink;
    line(context, [[x(place), 0], [x(place), context.h]]);
    for (const [name, colour, dash] of [["pixels", soft, [6, 4]], ["local", accent, []]]) {
      const most = Math.max(...curves[name]) || 1;
      context.setLineDash(dash);
      context.strokeStyle = colour;
      context.lineWidth = 2;
      line(context, PLACES.map((p, i) => [x(p), y(curves[name][i], most)]));
    }
    context.setLineDash([]);
    context.lineWidth = 1;
  }
  function line(context, points) {
    context.beginPath();
    points.forEach(([a, b], i) => (i ? context.lineTo(a, b) : context.moveTo(a, b)));
    context.stroke();
  }

  const root = document.getElementById("loi-play");
  if (root) start(root);
})();
