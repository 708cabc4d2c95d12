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

function range(values, log, margin, span = 0) {
  let low = Math.min(...values), high = Math.max(...values);
  if (log) {
    const factor = Math.max(high / low, 1.05) ** margin;
    return [low / factor, high * factor];
  }
  const pad = Math.max((high - low || Math.abs(high) || 1) * margin, (span - (high - low)) / 2);
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
  const shown = at.filter((_, k) => isShownPoint(series.points[k][4]));
  if (series.joined && shown.length) {
    const path = "M" + shown.map(([px, py]) => `${px.toFixed(1)},${py.toFixed(1)}`).join("L");
    const style = { d: path, fill: "none", "stroke-width": series.faint ? 1 : 2.2, "stroke-dasharray": series.dash };
    element("path", style, group);
  }
  series.points.forEach((p, k) => {
    const [px, py] = at[k];
    if (!isShownPoint(p[4])) return;
    if (p[3] > p[2] && !series.faint) {
      const top = y(p[3]), low = y(p[2]);
      element("path", { d: `M${px},${top}V${low}M${px - 4},${top}h8M${px - 4},${low}h8`, "stroke-width": 1.2, fill: "none" }, group);
    }
    if (series.ringed.includes(k)) element("circle", { class: "ring", cx: px, cy: py, r: 10 }, group);
    if (!series.faint || !series.joined) {
      element("path", { d: MARKERS[series.marker](px, py, 4.5), stroke: "none" }, group);
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
  const shown = chart.series.filter((series) => !hidden.has(series.name) && isShown(series.name));
  const points = shown.flatMap((series) => series.points).filter((p) => isShownPoint(p[4]));
  const tip = html("div", "tip", place);
  legend(place, chart, hidden);
  if (!points.length) return;
  const xs = range(points.map((p) => p[0]), chart.log_x, 0.05);
  const band = chart.band ? [chart.band.low, chart.band.high] : [];
  const ys = range(points.flatMap((p) => [p[2], p[3]]).concat(chart.y_zero ? [0] : [], band), false, 0.06, chart.min_span);
  const box = { left: 62, right: width - 12, top: 26, bottom: height - 48 };
  const ends = chart.reverse_x ? [box.right, box.left] : [box.left, box.right];
  const x = scaled(xs, ...ends, chart.log_x), y = scaled(ys, box.bottom, box.top, false);
  const spots = [];
  if (chart.band) {
    element("rect", { class: "band", x: box.left, width: box.right - box.left, y: y(band[1]), height: y(band[0]) - y(band[1]) }, svg);
  }
  drawAxes(svg, chart, xs, ys, box, x, y);
  shown.forEach((series, k) => { // a little beside each other, where they share their x
    const shift = chart.dodge ? (k - (shown.length - 1) / 2) * 0.009 * (box.right - box.left) : 0;
    drawSeries(svg, series, (value) => x(value) + shift, y, spots);
  });
  hover(place, svg, tip, chart, spots);
}

function legend(place, chart, hidden) {
  const list = html("div", "legend", place);
  const known = chart.series.filter((one) => !one.faint && isShown(one.name));
  const named = new Map(known.map((one) => [one.name, one]));
  for (const [name, series] of named) {
    const button = html("button", "", list);
    button.type = "button";
    button.setAttribute("aria-pressed", String(!hidden.has(name)));
    const sample = element("svg", { viewBox: "0 0 46 16" }, button);
    const color = `var(--s${series.color})`;
    element("path", { d: "M1,8H45", stroke: color, "stroke-width": 2.2, "stroke-dasharray": series.dash }, sample);
    element("path", { d: MARKERS[series.marker](23, 8, 4.5), fill: color }, sample);
    button.append(name);
    button.addEventListener("click", () => {
      if (!hidden.delete(name)) hidden.add(name);
      drawChart(place, chart, hidden);
    });
  }
  if (chart.band) html("span", "banded", list).textContent = chart.band.name;
}

function setUpChart(place) {
  const chart = data.charts[Number(place.dataset.chart)], hidden = new Set();
  let width = 0;
  redraws.push(() => drawChart(place, chart, hidden));
  new ResizeObserver(() => {
    if (place.clientWidth === width) return;
    width = place.clientWidth;
    requestAnimationFrame(() => drawChart(place, chart, hidden)); // not while sizes are observed
  }).observe(place);
}
