"use strict";
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const SVG = "http://www.w3.org/2000/svg";

  function element(name, attributes, parent) {
    const made = document.createElementNS(SVG, name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    if (parent) parent.append(made);
    return made;
  }

  function html(name, className, parent) {
    const made = document.createElement(name);
    made.className = className;
    parent.append(made);
    return made;
  }

  /* tables: a click on a heading sorts, a second one turns the order */

  function sortKey(cell) {
    const text = cell.textContent.trim();
    const number = text.replace(/−/g, "-").match(/^[^\d-]{0,4}(-?\d+(?:\.\d+)?)/);
    return number && !cell.classList.contains("left") ? Number(number[1]) : text;
  }

  function compare(a, b) {
    if (typeof a === "number" && typeof b === "number") return a - b;
    if (typeof a !== typeof b) return typeof a === "number" ? -1 : 1;
    return a.localeCompare(b, "en", { numeric: true });
  }

  function sortable(table) {
    const heads = [...table.tHead.rows[0].cells];
    heads.forEach((head, column) => {
      head.querySelector("button").addEventListener("click", () => {
        const down = head.getAttribute("aria-sort") === "ascending";
        for (const other of heads) other.removeAttribute("aria-sort");
        head.setAttribute("aria-sort", down ? "descending" : "ascending");
        const body = table.tBodies[0];
        const keyed = [...body.rows].map((row) => [sortKey(row.cells[column]), row]);
        keyed.sort((one, two) => (down ? -1 : 1) * compare(one[0], two[0]));
        body.append(...keyed.map(([, row]) => row));
      });
    });
  }

  /* charts */

  const MARKERS = [
    (x, y, r) => `M${x - r},${y}a${r},${r} 0 1,0 ${2 * r},0a${r},${r} 0 1,0 ${-2 * r},0`,
    (x, y, r) => `M${x - r},${y - r}h${2 * r}v${2 * r}h${-2 * r}Z`,
    (x, y, r) => `M${x},${y - r * 1.2}l${r * 1.2},${2.2 * r}h${-2.4 * r}Z`,
    (x, y, r) => `M${x},${y - r * 1.3}l${r * 1.3},${r * 1.3}l${-r * 1.3},${r * 1.3}l${-r * 1.3},${-r * 1.3}Z`,
    (x, y, r) => `M${x},${y + r * 1.2}l${r * 1.2},${-2.2 * r}h${-2.4 * r}Z`,
    (x, y, r) => `M${x - r / 2.5},${y - r * 1.2}h${r / 1.25}v${r * 0.8}h${r * 0.8}v${r / 1.25}h${-r * 0.8}v${r * 0.8}h${-r / 1.25}v${-r * 0.8}h${-r * 0.8}v${-r / 1.25}h${r * 0.8}Z`,
  ];

  function ticks(low, high, log) {
    const found = [];
    if (log) {
      for (let power = Math.floor(Math.log10(low)); power <= Math.ceil(Math.log10(high)); power++) {
        for (const digit of [1, 2, 5]) {
          const value = digit * 10 ** power;
          if (value >= low && value <= high) found.push(value);
        }
      }
      if (found.length > 2) return found;
      found.length = 0;
    }
    const rough = (high - low) / 6;
    const power = 10 ** Math.floor(Math.log10(rough));
    const step = [1, 2, 5, 10].map((digit) => digit * power).find((size) => size >= rough);
    for (let k = Math.ceil(low / step); k * step <= high; k++) found.push(k * step);
    return found;
  }

  const label = (value) => String(Number(value.toPrecision(4)));

  function range(values, log, margin) {
    let low = Math.min(...values), high = Math.max(...values);
    if (log) {
      const factor = Math.max(high / low, 1.05) ** margin;
      return [low / factor, high * factor];
    }
    const pad = (high - low || Math.abs(high) || 1) * margin;
    return [low - pad, high + pad];
  }

  function scaled([low, high], from, to, log) {
    const f = log ? Math.log : (value) => value;
    return (value) => from + ((f(value) - f(low)) / (f(high) - f(low))) * (to - from);
  }

  function drawAxes(svg, chart, xs, ys, box, x, y) {
    for (const value of ticks(...xs, chart.log_x)) {
      element("line", { class: "grid", x1: x(value), x2: x(value), y1: box.top, y2: box.bottom }, svg);
      element("text", { x: x(value), y: box.bottom + 18, "text-anchor": "middle" }, svg).textContent = label(value);
    }
    for (const value of ticks(...ys, false)) {
      element("line", { class: "grid", x1: box.left, x2: box.right, y1: y(value), y2: y(value) }, svg);
      element("text", { x: box.left - 7, y: y(value) + 4, "text-anchor": "end" }, svg).textContent = label(value);
    }
    element("path", { class: "axis", d: `M${box.left},${box.top}V${box.bottom}H${box.right}` }, svg);
    if (chart.y_zero) element("line", { class: "axis", x1: box.left, x2: box.right, y1: y(0), y2: y(0) }, svg);
    const middle = (box.left + box.right) / 2, height = (box.top + box.bottom) / 2;
    element("text", { x: middle, y: box.bottom + 38, "text-anchor": "middle" }, svg).textContent = chart.x_label;
    const upright = { x: 13, y: height, "text-anchor": "middle", transform: `rotate(-90 13 ${height})` };
    element("text", upright, svg).textContent = chart.y_label;
    element("text", { x: middle, y: 15, "text-anchor": "middle", "font-weight": 600 }, svg).textContent = chart.title;
  }

  function drawSeries(svg, series, x, y, spots) {
    const color = `var(--s${series.color})`;
    const group = element("g", { stroke: color, fill: color, opacity: series.faint ? 0.4 : 1 }, svg);
    const at = series.points.map((p) => [x(p[0]), y(p[1])]);
    if (series.joined) {
      const path = "M" + at.map(([px, py]) => `${px.toFixed(1)},${py.toFixed(1)}`).join("L");
      const style = { d: path, fill: "none", "stroke-width": series.faint ? 1 : 2.2, "stroke-dasharray": series.dash };
      element("path", style, group);
    }
    series.points.forEach((p, k) => {
      const [px, py] = at[k];
      if (p[3] > p[2] && !series.faint) {
        const top = y(p[3]), low = y(p[2]);
        element("path", { d: `M${px},${top}V${low}M${px - 4},${top}h8M${px - 4},${low}h8`, "stroke-width": 1.2, fill: "none" }, group);
      }
      if (series.ringed.includes(k)) element("circle", { class: "ring", cx: px, cy: py, r: 10 }, group);
      if (!series.faint || !series.joined) {
        element("path", { d: MARKERS[series.color](px, py, 4.5), stroke: "none" }, group);
        spots.push({ x: px, y: py, point: p, series });
      }
    });
  }

  function tipText(chart, { point, series }) {
    const number = (value) => String(Number(value.toPrecision(5)));
    const interval = point[3] > point[2] ? ` (95 %: ${number(point[2])} to ${number(point[3])})` : "";
    const note = point[4] ? `\n${point[4]}` : "";
    return `${series.name}${note}\n${chart.x_label}: ${number(point[0])}\n${chart.y_label}: ${number(point[1])}${interval}`;
  }

  function hover(place, svg, tip, chart, spots) {
    svg.addEventListener("pointermove", (event) => {
      const box = svg.getBoundingClientRect();
      const px = event.clientX - box.left, py = event.clientY - box.top;
      let best = null, least = 40;
      for (const spot of spots) {
        const distance = Math.hypot(spot.x - px, spot.y - py);
        if (distance < least) [best, least] = [spot, distance];
      }
      tip.style.visibility = best ? "visible" : "hidden";
      if (!best) return;
      tip.textContent = tipText(chart, best);
      const left = Math.min(best.x + 12, place.clientWidth - tip.offsetWidth - 4);
      tip.style.left = `${Math.max(0, left)}px`;
      tip.style.top = `${Math.max(0, best.y - tip.offsetHeight - 10)}px`;
    });
    svg.addEventListener("pointerleave", () => { tip.style.visibility = "hidden"; });
  }

  function drawChart(place, chart, hidden) {
    place.replaceChildren();
    const width = Math.max(280, place.clientWidth), height = Math.min(420, 240 + width * 0.22);
    const svg = element("svg", { viewBox: `0 0 ${width} ${height}`, height, role: "img", "aria-label": `${chart.title}: ${chart.y_label}` }, place);
    const shown = chart.series.filter((series) => !hidden.has(series.name));
    const points = shown.flatMap((series) => series.points);
    const tip = html("div", "tip", place);
    legend(place, chart, hidden);
    if (!points.length) return;
    const xs = range(points.map((p) => p[0]), chart.log_x, 0.05);
    const ys = range(points.flatMap((p) => [p[2], p[3]]).concat(chart.y_zero ? [0] : []), false, 0.06);
    const box = { left: 62, right: width - 12, top: 26, bottom: height - 48 };
    const ends = chart.reverse_x ? [box.right, box.left] : [box.left, box.right];
    const x = scaled(xs, ...ends, chart.log_x), y = scaled(ys, box.bottom, box.top, false);
    const spots = [];
    drawAxes(svg, chart, xs, ys, box, x, y);
    for (const series of shown) drawSeries(svg, series, x, y, spots);
    hover(place, svg, tip, chart, spots);
  }

  function legend(place, chart, hidden) {
    const list = html("div", "legend", place);
    const named = new Map(chart.series.filter((one) => !one.faint).map((one) => [one.name, one]));
    for (const [name, series] of named) {
      const button = html("button", "", list);
      button.type = "button";
      button.setAttribute("aria-pressed", String(!hidden.has(name)));
      const sample = element("svg", { viewBox: "0 0 46 16" }, button);
      const color = `var(--s${series.color})`;
      element("path", { d: "M1,8H45", stroke: color, "stroke-width": 2.2, "stroke-dasharray": series.dash }, sample);
      element("path", { d: MARKERS[series.color](23, 8, 4.5), fill: color }, sample);
      button.append(name);
      button.addEventListener("click", () => {
        if (!hidden.delete(name)) hidden.add(name);
        drawChart(place, chart, hidden);
      });
    }
  }

  function setUpChart(place) {
    const chart = data.charts[Number(place.dataset.chart)], hidden = new Set();
    let width = 0;
    new ResizeObserver(() => {
      if (place.clientWidth === width) return;
      width = place.clientWidth;
      requestAnimationFrame(() => drawChart(place, chart, hidden)); // not while sizes are observed
    }).observe(place);
  }

  /* viewer: a shot is [scene, method, seed, view, PSNR, truth, render, error] */

  function setUpViewer(viewer) {
    const selects = [...viewer.querySelectorAll("select")];
    const slider = viewer.querySelector("input");
    const [truth, render, error] = viewer.querySelectorAll(".stage img");
    const seam = viewer.querySelector(".seam");
    const wanted = new Map(); // what was chosen last, where it exists

    function refill() {
      let left = data.shots;
      for (const select of selects) {
        const key = Number(select.dataset.key);
        const values = [...new Set(left.map((shot) => shot[key]))];
        if (key === 2) values.sort((a, b) => a - b);
        const kept = values.includes(wanted.get(key)) ? wanted.get(key) : values[0];
        select.replaceChildren(...values.map((value) => new Option(String(value), String(value), false, value === kept)));
        left = left.filter((shot) => shot[key] === kept);
      }
      show(left[0]);
    }

    function show(shot) {
      truth.src = data.images[shot[5]];
      render.src = data.images[shot[6]];
      error.src = data.images[shot[7]];
      viewer.querySelector(".psnr").textContent = `(${shot[4]})`;
    }

    function wipe() {
      const value = Number(slider.value), share = value <= 1 ? value : value - 1;
      const cut = (part) => `inset(0 ${100 - 100 * part}% 0 0)`;
      render.style.clipPath = cut(Math.min(1, value));
      error.style.clipPath = cut(Math.max(0, value - 1));
      seam.style.left = `calc(${100 * share}% - 1px)`;
      seam.style.visibility = share > 0 && share < 1 ? "visible" : "hidden";
      slider.setAttribute("aria-valuetext", ["ground truth", "render", "error map"][Math.round(value)]);
    }

    for (const select of selects) {
      select.addEventListener("change", () => {
        const key = Number(select.dataset.key);
        wanted.set(key, key === 2 ? Number(select.value) : select.value);
        refill();
      });
    }
    for (const button of viewer.querySelectorAll(".marks button")) {
      button.addEventListener("click", () => { slider.value = button.dataset.to; wipe(); });
    }
    slider.addEventListener("input", wipe);
    refill();
    wipe();
  }

  document.querySelectorAll("table").forEach(sortable);
  document.querySelectorAll(".chart").forEach(setUpChart);
  document.querySelectorAll(".viewer").forEach(setUpViewer);
})();
