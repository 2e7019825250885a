// Local histograms under a point of the picture. Everything shown was computed before and lies in this page.
"use strict";
{
  const SVG = "http://www.w3.org/2000/svg";
  const facts = JSON.parse(document.getElementById("facts").textContent);
  const find = (id) => document.getElementById(id);
  const stage = find("stage"), backdrop = find("backdrop"), overlay = find("overlay"), place = find("place");
  const view = find("view"), group = find("group"), charts = find("charts");
  const own = backdrop.src;
  const CHART = { width: 160, top: 4, base: 70, second: 80, bottom: 116 };
  const STEPS = { ArrowLeft: [0, -1], ArrowRight: [0, 1], ArrowUp: [-1, 0], ArrowDown: [1, 0] };

  let shares = null; // of every histogram, a byte each: 255 times the root
  let row = Math.floor(facts.rows.length / 2), column = Math.floor(facts.columns.length / 2);
  let held = false, cells = [], told = 0;

  function element(name, attributes, parent) {
    const made = document.createElementNS(SVG, name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    parent.append(made);
    return made;
  }

  // --- the histograms -----------------------------------------------------------------------------------------------

  async function unpack(text) {
    const bytes = Uint8Array.from(atob(text), (one) => one.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
    const values = new Uint8Array(await new Response(stream).arrayBuffer());
    for (let index = 1; index < values.length; index++) values[index] += values[index - 1]; // differences, modulo 256
    return values;
  }

  // Where the histograms of a group begin: groups, pictures, extents, channels, levels, rows, columns.
  function histogram(which, picture, extent, channel) {
    const points = facts.rows.length * facts.columns.length;
    let start = 0;
    const size = (one) => 2 * one.alphas.length * facts.channels.length * one.levels.length * points;
    for (let before = 0; before < which; before++) start += size(facts.groups[before]);
    const { alphas, levels } = facts.groups[which];
    start += ((picture * alphas.length + extent) * facts.channels.length + channel) * levels.length * points;
    start += row * facts.columns.length + column;
    return levels.map((_, level) => (shares[start + level * points] / 255) ** 2);
  }

  function cumulated(values) {
    let sum = 0;
    return values.map((value) => (sum += value));
  }

  // --- the charts ---------------------------------------------------------------------------------------------------

  function called(channel, alpha) {
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
    svg.setAttribute("aria-label", called(channel, alpha)); // until the point rests, and how far apart is told
    element("path", { class: "axis", d: `M0 ${CHART.base}H${CHART.width}M0 ${CHART.bottom}H${CHART.width}` }, svg);
    const found = { channel, svg };
    for (const name of ["ours", "theirs", "apart", "steps"]) found[name] = element("path", { class: name }, svg);
    for (const [tick, value] of [["start", facts.bounds[0]], ["end", facts.bounds[1]]]) {
      const text = element("text", { x: across(value).toFixed(1), y: 128, "text-anchor": tick }, svg);
      text.textContent = number(value);
    }
    parent.append(figure);
    return found;
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
    if (!shares) return;
    const which = group ? group.selectedIndex : 0;
    const { levels, spacing } = facts.groups[which];
    cells.forEach((cell, extent) => {
      let total = 0;
      cell.charts.forEach((one, channel) => {
        const [ours, theirs] = [0, 1].map((picture) => histogram(which, picture, extent, channel));
        const most = Math.max(0.05, ...ours, ...theirs);
        const up = (value) => CHART.base - ((CHART.base - CHART.top) * value) / most;
        const closed = `L${across(levels[levels.length - 1])} ${CHART.base}L${across(levels[0])} ${CHART.base}Z`;
        one.ours.setAttribute("d", line(levels, ours.map(up)).join("") + closed);
        one.theirs.setAttribute("d", line(levels, theirs.map(up)).join(""));
        const sums = [cumulated(ours), cumulated(theirs)];
        const rise = (value) => CHART.bottom - (CHART.bottom - CHART.second) * value;
        const [first, second] = sums.map((one) => line(levels, one.map(rise)));
        const back = second.slice().reverse().join("").replaceAll("M", "L");
        one.apart.setAttribute("d", first.join("") + back + "Z");
        one.steps.setAttribute("d", first.join("") + second.join(""));
        const far = sums[0].reduce(
          (sum, value, level) => sum + Math.abs(value - sums[1][level]) ** (1 / facts.p) * spacing, 0);
        one.far = far;
        total += far / facts.channels.length;
      });
      cell.distance.textContent = `distance ${total.toFixed(3)}`;
    });
    clearTimeout(told);
    told = setTimeout(tell, 250); // those who listen are told of the point where it comes to rest
  }

  function tell() {
    const said = cells.map((cell, extent) => {
      const alpha = facts.groups[group ? group.selectedIndex : 0].alphas[extent];
      for (const one of cell.charts) {
        one.svg.setAttribute("aria-label", `${called(one.channel, alpha)}: histograms ${one.far.toFixed(3)} apart`);
      }
      return `extent ${number(alpha)}: ${cell.distance.textContent}`;
    });
    find("told").textContent = `${place.textContent}; ${said.join(", ")}`;
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
    for (const one of overlay.children) one.setAttribute("transform", to);
  }

  function nearest(places, wanted) {
    let best = 0;
    places.forEach((one, index) => {
      if (Math.abs(one - wanted) < Math.abs(places[best] - wanted)) best = index;
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
    if (event.pointerType !== "mouse" || !held) point(event);
  });
  stage.addEventListener("pointerdown", (event) => {
    if (event.pointerType === "mouse") held = !held || event.button !== 0;
    stage.classList.toggle("held", held);
    point(event);
  });
  stage.addEventListener("keydown", (event) => {
    const step = STEPS[event.key];
    if (!step || event.ctrlKey || event.altKey || event.metaKey) return;
    event.preventDefault();
    held = true; // a mouse that rests on the picture is not to take the point back
    stage.classList.add("held");
    const far = event.shiftKey ? 5 : 1;
    row = Math.min(Math.max(row + far * step[0], 0), facts.rows.length - 1);
    column = Math.min(Math.max(column + far * step[1], 0), facts.columns.length - 1);
    draw();
  });
  view.addEventListener("change", () => {
    const shown = find(view.value);
    backdrop.src = shown ? shown.src : own;
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
      shares = values;
      draw();
      stage.dataset.ready = "";
    });
  }
}
