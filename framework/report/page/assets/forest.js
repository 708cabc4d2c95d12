/* forest plot: [method, label, color, marker, middle, low, high, joint, real] */

function drawForest(place, forest) {
  place.replaceChildren();
  const rows = forest.rows.filter((row) => isShown(row[0]) && !hiddenScenes.has(row[1].replace(/ °$/, "")));
  if (!rows.length) return;
  const width = Math.max(280, place.clientWidth), narrow = width < 620;
  const left = narrow ? 8 : Math.min(300, width * 0.34), right = width - 12;
  const lines = []; // [y, text, bold] of the words
  const at = [];
  let y = 8, last = null;
  for (const row of rows) {
    const own = row[0] !== row[1];
    if (own && row[0] !== last) lines.push([y += 20, row[0], true]);
    last = row[0];
    if (narrow || !own) lines.push([y += 18, row[1], !own]);
    else lines.push([y + 20, row[1], false]);
    at.push(narrow ? (y += 15) : own ? (y += 20) - 4 : y - 4);
    if (narrow) y += 5;
  }
  const bottom = y + 12, height = bottom + 42;
  const svg = element("svg", { viewBox: `0 0 ${width} ${height}`, height, role: "img", "aria-label": forest.x_label }, place);
  const x = scaled(forest.limits, left, right, false);
  for (const value of ticks(...forest.limits, false)) {
    element("line", { class: "grid", x1: x(value), x2: x(value), y1: 8, y2: bottom }, svg);
    element("text", { x: x(value), y: bottom + 16, "text-anchor": "middle" }, svg).textContent = label(value);
  }
  element("line", { class: "axis", x1: x(0), x2: x(0), y1: 8, y2: bottom }, svg);
  const title = element("text", { x: narrow ? width / 2 : (left + right) / 2, y: bottom + 35, "text-anchor": "middle" }, svg);
  title.textContent = forest.x_label;
  for (const [top, text, bold] of lines) {
    const most = Math.floor((narrow || bold ? width - 16 : left - 18) / 7);
    const words = element("text", { x: narrow || bold ? 4 : left - 8, y: top, "text-anchor": narrow || bold ? "start" : "end", "font-weight": bold ? 600 : 400 }, svg);
    words.textContent = text.length > most ? `${text.slice(0, most - 1)}…` : text;
    element("title", {}, words).textContent = text;
  }
  rows.forEach((row, k) => drawDifference(svg, row, at[k], x, [left, right]));
}

function drawDifference(svg, [method, text, color, marker, middle, low, high, joint, real], y, x, [left, right]) {
  const ink = `var(--s${color})`, cut = (value) => Math.min(right, Math.max(left, x(value)));
  const group = element("g", { class: "row", stroke: ink, fill: real ? ink : "var(--bg)" }, svg);
  if (low !== null) {
    element("path", { d: `M${cut(low)},${y}H${cut(high)}`, "stroke-width": joint ? 4 : 1.2 }, group);
  }
  element("path", { d: MARKERS[marker](cut(middle), y, joint ? 5.5 : 3.6), "stroke-width": 1.6 }, group);
  const inside = low === null ? "" : ` (${label(low)} to ${label(high)}${joint ? "" : ", this row alone"})`;
  element("title", {}, group).textContent = `${method}, ${text}: ${label(middle)} dB${inside}`;
}

function setUpForest(place) {
  const forest = data.forests[Number(place.dataset.forest)];
  let width = 0;
  redraws.push(() => drawForest(place, forest));
  new ResizeObserver(() => {
    if (place.clientWidth === width) return;
    width = place.clientWidth;
    requestAnimationFrame(() => drawForest(place, forest));
  }).observe(place);
}
