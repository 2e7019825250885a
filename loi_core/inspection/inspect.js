// Shows the local histograms under a point of the image. All numbers are in this page.
"use strict";
{
  const SVG = "http://www.w3.org/2000/svg";
  const facts = JSON.parse(document.getElementById("facts").textContent);
  const find = (id) => document.getElementById(id);
  const stage = find("stage"), backdrop = find("backdrop"), overlay = find("overlay"), place = find("place");
  const view = find("view"), group = find("group"), charts = find("charts");
  const original = backdrop.src;
  const CHART = { width: 160, top: 4, base: 70, second: 80, bottom: 116 };
  const ANNOUNCE_MS = 250;
  const STEPS = { ArrowLeft: [0, -1], ArrowRight: [0, 1], ArrowUp: [-1, 0], ArrowDown: [1, 0] };

  let roots = null; // a byte for each fraction of a histogram: 255 times its square root
  let row = Math.floor(facts.rows.length / 2), column = Math.floor(facts.columns.length / 2);
  let fixed = false, cells = [], announcement = 0;

  function element(name, attributes, parent) {
    const node = document.createElementNS(SVG, name);
    for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
    parent.append(node);
    return node;
  }

  // --- the histograms -----------------------------------------------------------------------------------------------

  async function unpack(text) {
    const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
    const values = new Uint8Array(await new Response(stream).arrayBuffer());
    for (let index = 1; index < values.length; index++) values[index] += values[index - 1]; // differences, modulo 256
    return values;
  }

  // The bytes are ordered by group, image, extent, channel, level, row, column.
  function histogram(which, picture, extent, channel) {
    const points = facts.rows.length * facts.columns.length;
    let start = 0;
    const size = ({ alphas, levels }) => 2 * alphas.length * facts.channels.length * levels.length * points;
    for (const earlier of facts.groups.slice(0, which)) start += size(earlier);
    const { alphas, levels } = facts.groups[which];
    start += ((picture * alphas.length + extent) * facts.channels.length + channel) * levels.length * points;
    start += row * facts.columns.length + column;
    return levels.map((_, level) => (roots[start + level * points] / 255) ** 2);
  }

  function cumulated(values) {
    let sum = 0;
    return values.map((value) => (sum += value));
  }

  // --- the charts ---------------------------------------------------------------------------------------------------

  function chartName(channel, alpha) {
    return `${channel}, extent ${number(alpha)} px`;
  }

  function layOut() {
    const { alphas, sigma, beta } = facts.groups[group ? group.selectedIndex : 0];
    charts.replaceChildren();
    cells = alphas.map((alpha) => {
      const head = document.createElement("h3");
      const name = document.createElement("span"), distance = document.createElement("span");
      name.textContent = `extent ${number(alpha)} px`;
      name.title = `sigma ${number(sigma)} px, beta ${number(beta)}`;
      distance.className = "distance";
      head.append(name, distance);
      const line = document.createElement("div");
      line.className = "charts";
      charts.append(head, line);
      return { distance, charts: facts.channels.map((channel) => chart(channel, alpha, line)) };
    });
  }

  function chart(channel, alpha, parent) {
    const figure = document.createElement("div");
    figure.className = "chart";
    figure.dataset.channel = channel;
    const svg = element("svg", { viewBox: `0 0 ${CHART.width} 130`, role: "img" }, figure);
    svg.setAttribute("aria-label", chartName(channel, alpha)); // until the distance is announced
    element("path", { class: "axis", d: `M0 ${CHART.base}H${CHART.width}M0 ${CHART.bottom}H${CHART.width}` }, svg);
    const paths = { channel, svg };
    for (const name of ["ours", "theirs", "apart", "steps"]) paths[name] = element("path", { class: name }, svg);
    for (const [tick, value] of [["start", facts.bounds[0]], ["end", facts.bounds[1]]]) {
      const text = element("text", { x: across(value).toFixed(1), y: 128, "text-anchor": tick }, svg);
      text.textContent = number(value);
    }
    parent.append(figure);
    return paths;
  }

  function across(value) {
    const [low, high] = facts.shown;
    return (CHART.width * (value - low)) / (high - low);
  }

  function number(value) {
    return String(Number(value.toPrecision(3)));
  }

  function line(levels, heights) {
    return levels.map((level, index) => `${index ? "L" : "M"}${across(level).toFixed(1)} ${heights[index].toFixed(1)}`);
  }

  function draw() {
    place.textContent = `column ${facts.columns[column]}, row ${facts.rows[row]}`;
    move();
    if (!roots) return;
    const which = group ? group.selectedIndex : 0;
    const { levels, spacing } = facts.groups[which];
    cells.forEach((cell, extent) => {
      let total = 0;
      cell.charts.forEach((chart, channel) => {
        const [ours, theirs] = [0, 1].map((picture) => histogram(which, picture, extent, channel));
        const most = Math.max(0.05, ...ours, ...theirs);
        const up = (value) => CHART.base - ((CHART.base - CHART.top) * value) / most;
        const closed = `L${across(levels[levels.length - 1])} ${CHART.base}L${across(levels[0])} ${CHART.base}Z`;
        chart.ours.setAttribute("d", line(levels, ours.map(up)).join("") + closed);
        chart.theirs.setAttribute("d", line(levels, theirs.map(up)).join(""));
        const sums = [cumulated(ours), cumulated(theirs)];
        const rise = (value) => CHART.bottom - (CHART.bottom - CHART.second) * value;
        const [first, second] = sums.map((sum) => line(levels, sum.map(rise)));
        const back = second.slice().reverse().join("").replaceAll("M", "L");
        chart.apart.setAttribute("d", first.join("") + back + "Z");
        chart.steps.setAttribute("d", first.join("") + second.join(""));
        const distance = sums[0].reduce(
          (sum, value, level) => sum + Math.abs(value - sums[1][level]) ** (1 / facts.p) * spacing, 0);
        chart.distance = distance;
        total += distance / facts.channels.length;
      });
      cell.distance.textContent = `distance ${total.toFixed(3)}`;
    });
    clearTimeout(announcement);
    announcement = setTimeout(announce, ANNOUNCE_MS); // for screen readers, once the point rests
  }

  function announce() {
    const distances = cells.map((cell, extent) => {
      const alpha = facts.groups[group ? group.selectedIndex : 0].alphas[extent];
      for (const { channel, svg, distance } of cell.charts) {
        svg.setAttribute("aria-label", `${chartName(channel, alpha)}: histograms ${distance.toFixed(3)} apart`);
      }
      return `extent ${number(alpha)}: ${cell.distance.textContent}`;
    });
    find("announced").textContent = `${place.textContent}; ${distances.join(", ")}`;
  }

  // --- the picture --------------------------------------------------------------------------------------------------

  function mark() {
    overlay.setAttribute("viewBox", `0 0 ${facts.width} ${facts.height}`);
    overlay.replaceChildren();
    for (const alpha of facts.groups[group ? group.selectedIndex : 0].alphas) {
      for (const kind of ["under", "ring"]) element("circle", { class: kind, r: alpha }, overlay);
    }
    const arm = Math.max(facts.width, facts.height) / 60;
    for (const kind of ["under", "cross"]) element("path", { class: kind, d: `M${-arm} 0H${arm}M0 ${-arm}V${arm}` }, overlay);
  }

  function move() {
    const to = `translate(${facts.columns[column] + 0.5} ${facts.rows[row] + 0.5})`;
    for (const mark of overlay.children) mark.setAttribute("transform", to);
  }

  function nearest(positions, target) {
    let best = 0;
    positions.forEach((position, index) => {
      if (Math.abs(position - target) < Math.abs(positions[best] - target)) best = index;
    });
    return best;
  }

  function point(event) {
    const box = backdrop.getBoundingClientRect();
    column = nearest(facts.columns, ((event.clientX - box.left) / box.width) * facts.width - 0.5);
    row = nearest(facts.rows, ((event.clientY - box.top) / box.height) * facts.height - 0.5);
    draw();
  }

  stage.addEventListener("pointermove", (event) => {
    if (event.pointerType !== "mouse" || !fixed) point(event);
  });
  stage.addEventListener("pointerdown", (event) => {
    if (event.pointerType === "mouse") fixed = !fixed || event.button !== 0;
    stage.classList.toggle("held", fixed);
    point(event);
  });
  stage.addEventListener("keydown", (event) => {
    const step = STEPS[event.key];
    if (!step || event.ctrlKey || event.altKey || event.metaKey) return;
    event.preventDefault();
    fixed = true; // a mouse that rests on the image must not take the point back
    stage.classList.add("held");
    const far = event.shiftKey ? 5 : 1;
    row = Math.min(Math.max(row + far * step[0], 0), facts.rows.length - 1);
    column = Math.min(Math.max(column + far * step[1], 0), facts.columns.length - 1);
    draw();
  });
  view.addEventListener("change", () => {
    const shown = find(view.value);
    backdrop.src = shown ? shown.src : original;
    backdrop.alt = shown ? shown.alt : facts.names[0];
  });
  group?.addEventListener("change", () => {
    layOut();
    mark();
    draw();
  });

  document.documentElement.classList.add("live");
  layOut();
  mark();
  draw();
  if (typeof DecompressionStream === "undefined") {
    charts.textContent = "This browser is too old to unpack the histograms.";
  } else {
    unpack(facts.packed).then((values) => {
      roots = values;
      draw();
      stage.dataset.ready = "";
    });
  }
}
