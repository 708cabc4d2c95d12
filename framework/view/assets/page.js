/* The page: what is shown, beside what, and the buttons. `data` is what framework/view/page.py made. */

const data = JSON.parse(document.getElementById("data").textContent);
const find = (name) => document.getElementById(name);
const stage = find("stage"), canvas = find("splat"), photo = find("photo"), seam = find("seam"), slider = find("slider");
const cameras = data.cameras.map((c) => ({ ...c, pose: { R: c.rotation, c: c.center } }));
const eye = new Eye(data.up), frustums = new Frustums(find("frustums"), cameras);
const calm = matchMedia("(prefers-reduced-motion: reduce)");
const state = { mode: COLOUR, beside: data.runs.length > 1 ? "run" : "none", split: false, fly: false, frustums: true, hovered: null };
let renderer, models, keysFly, pending = false, movedAt = -Infinity, frameAt = null, pace = 16;
let quality = 1, still = 1; // shares of the full width that are drawn while it moves, and at rest

function say(text, bad = false) {
  find("status").textContent = text;
  find("status").classList.toggle("bad", bad);
}

const exposureOf = (index, run) => index === null ? [1, 1, 1] : cameras[index].exposure[run]; // of the photo there
const photoOf = (index) => index === null || cameras[index].photo === null ? null : data.photos[cameras[index].photo];
const besidePhoto = () => state.beside === "photo" && photoOf(eye.at) !== null;
const besideRun = () => state.beside === "run" && data.runs.length > 1;

/* The panes in CSS pixels: one, or two beside or above each other. */
function panes() {
  const [width, height] = [stage.clientWidth, stage.clientHeight];
  if (!state.split || !(besideRun() || besidePhoto())) return [{ left: 0, top: 0, width, height }];
  const wide = width >= height, w = wide ? Math.floor(width / 2) : width, h = wide ? height : Math.floor(height / 2);
  return [{ left: 0, top: 0, width: w, height: h }, { left: wide ? width - w : 0, top: wide ? 0 : height - h, width: w, height: h }];
}

const FIRST_PIXELS = 150000, SLOW_MS = 400, STILL_MS = 1500, MOVING_MS = 60;
const THUMB = 32; // pixels, as in page.css
const seamAt = () => THUMB / 2 + slider.value / 100 * (stage.clientWidth - THUMB);

function invalidate() {
  if (pending || !models) return;
  pending = true;
  requestAnimationFrame(frame);
}

function moved() {
  movedAt = performance.now();
  invalidate();
}

function frame(now) {
  pending = false;
  const flown = keysFly(now);
  if (flown) movedAt = now;
  if (eye.flight) {
    eye.flight(now);
    movedAt = now;
  }
  const moving = now - movedAt < 150;
  if (moving && frameAt !== null) pace = 0.7 * pace + 0.3 * Math.min(now - frameAt, 400);
  frameAt = moving ? now : null;
  if (pace > 45 && quality > 0.25) [quality, pace] = [Math.max(0.25, 0.75 * quality), 30];
  else if (pace < 20 && quality < 1) [quality, pace] = [Math.min(1, 1.2 * quality), 30];
  draw(moving ? Math.min(quality, still) : still);
  if (moving) invalidate();
}

/* The first picture, small enough to be there at once; it tells how fast this machine draws. */
function drawFirst() {
  const whole = stage.clientWidth * stage.clientHeight * Math.min(devicePixelRatio || 1, 2) ** 2;
  const share = Math.min(1, Math.sqrt(FIRST_PIXELS / Math.max(1, whole)));
  const timed = () => {
    const begun = performance.now();
    draw(share);
    renderer.read("run0", 0, 0); // waits for the picture
    return performance.now() - begun;
  };
  const first = timed(); // shaders are compiled in it
  document.documentElement.dataset.ready = Math.round(performance.now());
  if (first < SLOW_MS) return invalidate();
  requestAnimationFrame(() => { // the first picture is on the screen
    const full = timed() / share ** 2, most = (wanted, least) => clamp(Math.sqrt(wanted / full), least, 1);
    [still, quality] = [most(STILL_MS, share), most(MOVING_MS, 0.25)];
    invalidate();
  });
}

function draw(share) {
  const all = panes(), { gl } = renderer, whole = all.length === 1;
  let ratio = Math.min(devicePixelRatio || 1, 2);
  ratio *= Math.min(1, Math.sqrt(4e6 / Math.max(1, stage.clientWidth * stage.clientHeight * ratio * ratio)));
  const [width, height] = [stage.clientWidth, stage.clientHeight].map((side) => Math.max(1, Math.round(side * ratio)));
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
  const cut = besideRun() ? (whole ? seamAt() / stage.clientWidth : null) : 1; // a photo lies over the splat
  models.forEach((model, i) => {
    if (i && !besideRun()) return;
    const pane = all[whole ? 0 : i], [w, h] = [pane.width, pane.height].map((side) => Math.max(1, Math.round(side * ratio)));
    const view = eye.view(pane, Math.max(1, Math.round(w * share)), Math.max(1, Math.round(h * share)));
    const columns = (across, round) => cut === null ? [0, across] : i ? [round(cut * across), across] : [0, Math.ceil(cut * across)];
    const sums = renderer.sum(model, view, state.mode, `run${i}`, columns(view.width, Math.floor));
    const region = [Math.round(pane.left * ratio), height - Math.round(pane.top * ratio) - h, w, h];
    renderer.show(sums, model, state.mode, null, region, columns(w, Math.ceil), exposureOf(eye.at, i));
  });
  if (!whole && besidePhoto()) {
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.enable(gl.SCISSOR_TEST);
    gl.scissor(Math.round(all[1].left * ratio), height - Math.round((all[1].top + all[1].height) * ratio), Math.round(all[1].width * ratio), Math.round(all[1].height * ratio));
    gl.clearColor(...models[0].background, 1);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.disable(gl.SCISSOR_TEST);
  }
  frustums.draw(besidePhoto() ? all.slice(0, 1) : all, eye, devicePixelRatio || 1, state.frustums, state.hovered);
  place(all);
}

/* What lies over the splat: the photo, the seam, the names of both sides. */
function place(all) {
  const pane = all.at(-1), box = eye.rectangle(pane.width, pane.height), shown = besidePhoto(), whole = all.length === 1;
  const both = shown || besideRun(), x = seamAt();
  photo.hidden = !shown;
  if (shown) {
    if (photo.dataset.at !== String(eye.at)) {
      photo.src = photoOf(eye.at);
      photo.dataset.at = eye.at;
      photo.alt = `photo ${cameras[eye.at].name}`;
    }
    for (const side of ["width", "height"]) photo.style[side] = `${box[side]}px`;
    photo.style.left = `${pane.left + box.left}px`;
    photo.style.top = `${pane.top + box.top}px`;
    photo.style.clipPath = whole ? `inset(0 0 0 ${clamp(x - box.left, 0, box.width)}px)` : "none";
  }
  slider.hidden = seam.hidden = !(both && whole);
  seam.style.left = `${x}px`;
  const names = find("names");
  names.hidden = !both;
  names.classList.toggle("below", !whole && all[1].top > 0);
  names.children[0].textContent = data.runs[0].label;
  names.children[1].textContent = shown ? "photo" : data.runs.at(-1).label;
}

const bare = cameras.map((camera) => camera.name.split("/").pop());
const labelOf = (name) => new Set(bare).size === bare.length ? name.split("/").pop() : name;

function told() {
  const { at } = eye, camera = at === null ? null : cameras[at];
  const values = camera && camera.psnr.some((v) => v !== null) ? camera.psnr.map((v) => v === null ? "–" : `${v.toFixed(2)} dB`).join(" and ") : "";
  find("camera").value = at === null ? "" : String(at);
  if (!camera) return say(state.beside === "photo" ? "Jump to a camera to see its photo." : "");
  const lacks = state.beside === "photo" && camera.photo === null ? " · no photo kept" : "";
  say(`${camera.role === "test" ? "Test" : "Training"} camera ${camera.name}${values ? ` · PSNR ${values}` : ""}${lacks}`);
}

function distanceAt(camera) {
  const view = { ...camera, width: camera.w, height: camera.h };
  for (const reach of [0.1, 0.3, 2]) {
    const depths = depthsAround(models[0], view, camera.w / 2, camera.h / 2, reach);
    if (depths.length > 20 || (reach === 2 && depths.length)) return depths[depths.length >> 1];
  }
  return 1;
}

function jump(index, flight = true) {
  const camera = cameras[index], view = { ...camera, width: camera.w, height: camera.h };
  const depths = depthsAround(models[0], view, camera.w / 2, camera.h / 2, 2);
  if (depths.length > 50) renderer.range = [depths[Math.floor(0.02 * depths.length)], depths[Math.floor(0.98 * depths.length)]];
  legend();
  const start = flight && !calm.matches ? performance.now() : null;
  eye.jump(index, camera, distanceAt(camera), start, () => { told(); invalidate(); });
  find("camera").value = String(index);
  moved();
}

function step(by) {
  if (!cameras.length) return;
  const at = eye.at ?? Number(find("camera").value || -1);
  jump((at + by + cameras.length) % cameras.length);
}

function home() {
  if (cameras.length) return jump(data.first);
  const { means, n } = models[0], middle = [0, 1, 2].map((k) => {
    const along = Float32Array.from({ length: n }, (_, i) => means[3 * i + k]).sort();
    return [along[n >> 1] ?? 0, (along[Math.floor(0.9 * n)] ?? 1) - (along[Math.floor(0.1 * n)] ?? 0)];
  });
  const size = Math.max(...middle.map(([, width]) => width), 1e-3), c = middle.map(([value]) => value);
  eye.lens = { fx: 1000, fy: 1000, cx: 500, cy: 400, w: 1000, h: 800 };
  eye.pose = { R: [1, 0, 0, 0, 1, 0, 0, 0, 1], c: [c[0], c[1], c[2] - 1.5 * size] };
  eye.distance = 1.5 * size;
  renderer.range = [size, 2.5 * size];
  legend();
  moved();
}

const short = (value) => Number(value.toPrecision(3)).toString();

function legend() {
  const box = find("legend"), ends = state.mode === COUNT ? ["0", "31", `${MOST_COUNT} Gaussians`] : [`${short(renderer.range[1])} far`, "", `${short(renderer.range[0])} near`];
  box.hidden = state.mode === COLOUR;
  box.querySelectorAll("span").forEach((span, i) => { span.textContent = ends[i]; });
}

function hovered(x, y) {
  const under = state.frustums ? frustums.under(x, y, 14) : null;
  if (under !== state.hovered) {
    state.hovered = under;
    stage.style.cursor = under === null ? "" : "pointer";
    if (under !== null) say(`${cameras[under].role === "test" ? "Test" : "Training"} camera ${cameras[under].name}: click to jump`);
    else told();
    invalidate();
  } else if (state.mode !== COLOUR && under === null && performance.now() - movedAt > 200) {
    const all = panes(), i = all.length > 1 && !(x < all[0].width && y < all[0].height) ? 1 : besideRun() && all.length === 1 && x > seamAt() ? 1 : 0;
    const pane = all[Math.min(i, all.length - 1)];
    if (i && !besideRun()) return;
    const sum = renderer.read(`run${i}`, clamp((x - pane.left) / pane.width, 0, 0.9999), clamp((y - pane.top) / pane.height, 0, 0.9999));
    say(state.mode === COUNT ? `${Math.round(sum[0])} Gaussians at this pixel` : sum[3] > 0.01 ? `depth ${short(sum[0] / sum[3])}` : "nothing here");
  }
}

function tapped(x, y, double, reach) {
  const under = state.frustums ? frustums.under(x, y, reach) : null;
  if (under !== null) return jump(under);
  if (!double) return;
  const pane = panes()[0], view = eye.view(pane, pane.width, pane.height);
  const depths = depthsAround(models[0], view, x % pane.width, y % pane.height, 0.03);
  if (!depths.length) return;
  eye.distance = depths[depths.length >> 1];
  say("Turning about this depth.");
}

function choose(group, value) {
  state[group] = value;
  for (const button of document.querySelectorAll(`[data-group="${group}"]`)) {
    button.setAttribute("aria-pressed", String(JSON.parse(button.dataset.value) === value));
  }
  document.documentElement.dataset.beside = state.beside;
  stage.classList.toggle("fly", state.fly);
  if (renderer) {
    legend();
    told();
    invalidate();
  }
}

function save() {
  const camera = eye.at === null ? null : cameras[eye.at], scale = window.devicePixelRatio || 1;
  const view = camera ? { ...camera, width: camera.w, height: camera.h, detail: 1 } : eye.view(stage.getBoundingClientRect(), Math.round(stage.clientWidth * scale), Math.round(stage.clientHeight * scale));
  const picture = renderer.picture(models[0], { ...view, pose: eye.pose }, state.mode, exposureOf(eye.at, 0)), page = document.createElement("canvas");
  Object.assign(page, { width: picture.width, height: picture.height });
  page.getContext("2d").putImageData(picture, 0, 0);
  page.toBlob((blob) => {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(blob);
    link.download = `${(camera ? camera.name : "view").replace(/[^\w.-]+/g, "_")}.png`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  });
  invalidate();
}

const ACTIONS = {
  previous: () => step(-1), next: () => step(1), home, save, help: () => find("help").showModal(),
  close: () => find("help").close(),
};
const SHORTCUTS = {
  Digit1: () => choose("mode", COLOUR), Digit2: () => choose("mode", DEPTH), Digit3: () => choose("mode", COUNT),
  Comma: () => step(-1), Period: () => step(1), KeyF: () => choose("fly", !state.fly), KeyC: () => choose("frustums", !state.frustums),
  KeyP: () => choose("beside", state.beside === "photo" ? "none" : "photo"), KeyH: home,
  KeyB: () => choose("split", !state.split),
  KeyR: () => { if (data.runs.length > 1) choose("beside", state.beside === "run" ? "none" : "run"); },
};

function setUp() {
  for (const button of document.querySelectorAll("button[data-do]")) button.addEventListener("click", ACTIONS[button.dataset.do]);
  for (const button of document.querySelectorAll("button[data-group]")) {
    const value = JSON.parse(button.dataset.value), { group, toggle } = button.dataset;
    button.addEventListener("click", () => choose(group, toggle ? !state[group] : value));
  }
  for (const group of ["mode", "beside", "split", "fly", "frustums"]) choose(group, state[group]);
  const select = find("camera");
  for (const role of ["test", "train"]) {
    const group = document.createElement("optgroup");
    group.label = role === "test" ? "Test" : "Training";
    cameras.forEach((camera, i) => { if (camera.role === role) group.append(new Option(labelOf(camera.name), String(i))); });
    if (group.children.length) select.append(group);
  }
  select.addEventListener("change", () => { if (select.value) jump(Number(select.value)); });
  slider.addEventListener("input", () => { slider.setAttribute("aria-valuetext", `${slider.value} %`); moved(); });
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.closest("input, select, dialog")) return;
    if (event.key === "?") ACTIONS.help();
    else if (event.code in SHORTCUTS) SHORTCUTS[event.code]();
  });
  new ResizeObserver(invalidate).observe(stage);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", invalidate);
  canvas.addEventListener("webglcontextlost", (event) => {
    event.preventDefault();
    say("The graphics card was reset: load the page again.", true);
  });
  document.documentElement.classList.toggle("bare", !cameras.length);
  document.documentElement.classList.toggle("photoless", !data.photos.length);
  document.documentElement.classList.toggle("single", data.runs.length === 1);
}

async function start() {
  setUp();
  try {
    if (!("DecompressionStream" in window)) throw new Error("This browser is too old for the page: it cannot unpack gzip.");
    renderer = new Renderer(canvas);
    const texts = data.runs.map((_, i) => find(`splats${i}`).textContent);
    const read = await Promise.all(data.runs.map((run, i) => readModel(run, texts[i])));
    models = read.map((model) => renderer.load(model));
  } catch (error) {
    return say(error.message, true);
  }
  keysFly = listen(stage, eye, { moved: () => { told(); moved(); }, tapped, hovered, flying: () => state.fly, scale: () => eye.rectangle(panes()[0].width, panes()[0].height).scale });
  pending = true; // no frame before the first picture
  if (cameras.length) jump(data.first, false);
  else home();
  pending = false;
  movedAt = -Infinity;
  drawFirst();
  /* for the console and tests: pixels of a camera's picture, row by row from the top, RGBA */
  window.fishersplat = {
    cameras: cameras.map((camera) => camera.name),
    picture: (index, run = 0, mode = COLOUR) => renderer.picture(models[run], { ...cameras[index], width: cameras[index].w, height: cameras[index].h, detail: 1 }, mode, exposureOf(index, run)),
    eye, state, shares: () => [still, quality],
  };
}

start();
